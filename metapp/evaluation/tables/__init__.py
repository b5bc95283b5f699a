"""The tables of `metapp evaluate`; one is a module here that defines TABLE, a further one needs its name here.

NAMES are those of fits by checkpoints that are there, STUDIES those that train for themselves.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metapp.evaluation.rows import Table

NAMES = ("results", "quickft", "image", "ablation", "storage", "samples", "convergence", "baselines")
STUDIES = ("rules",)  # hours: no part of "all", nor of the report


def load_table(name: str) -> Table:
    """The table of that name, one of NAMES or STUDIES."""
    result: Table = importlib.import_module(f"metapp.evaluation.tables.{name}").TABLE
    return result
