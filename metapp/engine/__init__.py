"""Engines: how steps of a descent are taken, faster than by torch alone.

`learning` says what a step and its vector-Jacobian product are; here both are computed in C where a loss and a rule are
known (`in_c`, `packing`), else by torch, compiled where that pays. No other part knows of it.
"""

from metapp.engine.compiler import compiler, load
from metapp.engine.fastest import FASTEST, Fastest
from metapp.engine.in_c import LossInC, register

__all__ = ["FASTEST", "Fastest", "LossInC", "compiler", "load", "register"]
