"""The tables of `metapp evaluate`: functions of a `Subject`."""

from __future__ import annotations

from metapp.registry import registry

ALL = "all"  # tables


def table_names() -> list[str]:
    """The names of all tables."""
    return list(registry().tables)
