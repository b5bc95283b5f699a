"""The tables of `metapp evaluate`; one is a module here that defines TABLE, a further one needs its name in NAMES."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metapp.experiments.tables.table import Table

NAMES = ("results", "quickft", "image", "ablation", "storage", "samples", "convergence", "peers")


def load_table(name: str) -> Table:
    """The table of that name, one of NAMES."""
    result: Table = importlib.import_module(f"metapp.experiments.tables.{name}").TABLE
    return result
