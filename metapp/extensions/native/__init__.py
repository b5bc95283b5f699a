"""Steps of learning in C, and by torch, compiled: the same results as the loop by torch, to rounding, but sooner."""

from __future__ import annotations

from metapp.door import Engine

OFFERS = (Engine("native", "metapp.extensions.native.fastest:Fastest"),)
