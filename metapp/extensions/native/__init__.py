"""Steps of learning in C, and by torch, compiled: the same results as the loop by torch, to rounding, but sooner."""

from __future__ import annotations

from metapp.registry import Entry, Registry


def register(registry: Registry) -> None:
    """Take the steps."""
    registry.steps = Entry("metapp.extensions.native.fastest:steps")
