"""The tables of `metapp evaluate`, by the modules here that define them, in capitals.

NAMES are those of fits by checkpoints that are there, STUDIES those that train for themselves.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metapp.evaluation.rows import Table

MODULES = {
    "results": "results",
    "quickft": "results",
    "image": "image",
    "ablation": "ablation",
    "storage": "storage",
    "samples": "storage",
    "convergence": "convergence",
    "baselines": "baselines",
    "rules": "rules",
}
STUDIES = ("rules",)  # hours: no part of "all", nor of the report
NAMES = tuple(name for name in MODULES if name not in STUDIES)


def load_table(name: str) -> Table:
    """The table of that name, one of NAMES or STUDIES."""
    module = importlib.import_module(f"metapp.evaluation.tables.{MODULES[name]}")
    result: Table = getattr(module, name.upper())
    return result
