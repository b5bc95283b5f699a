"""metapp: reproduce visual appearance by machine learning, and compare how training decides speed and quality.

This module holds the Python API alone, and imports it at its first use:

    import metapp

    fit = metapp.fit("brdf", "gold.binary")
    fit.error, fit.seconds, fit.parameters
    fit.save("gold.safetensors")

The packages in order of reading: `learning` has fits and update rules, `paradigms` the five ways of training;
`appearance`, `networks` and `rendering` have what applications are made of, `apps` the applications; `storage` has
files, `runs` what one command does, `evaluation` tables and figures, `cli` the commands. `checkpoints` holds the
checkpoints that ship, `extensions` packages that the core never imports.

Of the modules, `application` has what metapp knows of an application before it imports it, `registry` all applications
and further tables by name, `entries` the references that they are made of, and `contents` the core's entries.
`learned_rules` finds rules by name, `options` makes options of dataclasses, `mitsuba` registers plugins for Mitsuba 3,
and `__main__` runs the command `metapp`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metapp.runs.api import fit, fit_all, load
    from metapp.runs.fit import Fit

__all__ = ["Fit", "__version__", "fit", "fit_all", "load"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import the API at its first use, as torch takes a second or more to load."""
    if name in ("Fit", "fit", "fit_all", "load"):
        return getattr(importlib.import_module("metapp.runs.api"), name)
    raise AttributeError(f"module 'metapp' has no attribute '{name}'")


def __dir__() -> list[str]:
    """List the names of the API for `dir` and completion, whether they are imported yet or not."""
    return sorted(__all__)
