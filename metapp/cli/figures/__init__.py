"""The paper's figures, of any application; a figure is a function in a module here that FIGURES names."""

from __future__ import annotations


def write_figures(): ...
