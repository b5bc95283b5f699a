"""The tables of `metapp evaluate`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metapp.registry import registry

if TYPE_CHECKING:
    from metapp.evaluation.rows import Table

ALL = "all"  # tables


def table_names() -> list[str]:
    """The names of all tables."""
    return list(registry().tables)


def load_table(name: str) -> Table:
    """The table of that name, one of `table_names`."""
    result: Table = registry().tables[name].load()
    return result
