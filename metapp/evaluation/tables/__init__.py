"""The tables of `metapp evaluate`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metapp.registry import Entry, Registry, registry

if TYPE_CHECKING:
    from metapp.evaluation.rows import Table

ALL = "all"  # tables
_HERE = "metapp.evaluation.tables"


def register(registry: Registry) -> None:
    """Add the tables that ship."""
    registry.tables["results"] = Entry(f"{_HERE}.results:RESULTS")
    registry.tables["quickft"] = Entry(f"{_HERE}.results:QUICKFT")
    registry.tables["image"] = Entry(f"{_HERE}.image:IMAGE")
    registry.tables["ablation"] = Entry(f"{_HERE}.ablation:ABLATION")
    registry.tables["storage"] = Entry(f"{_HERE}.storage:STORAGE")
    registry.tables["samples"] = Entry(f"{_HERE}.storage:SAMPLES")
    registry.tables["convergence"] = Entry(f"{_HERE}.convergence:CONVERGENCE")


def table_names() -> list[str]:
    """The names of all tables."""
    return list(registry().tables)


def load_table(name: str) -> Table:
    """The table of that name, one of `table_names`."""
    result: Table = registry().tables[name].load()
    return result
