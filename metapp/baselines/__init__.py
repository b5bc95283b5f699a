"""Baselines: what a reader would use instead of a network, fitted to what fits see and judged by the same errors.

A module here with the name of an application defines `baselines(app)`.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metapp.baselines.baseline import Baseline
    from metapp.learning.app import App


def baselines_of(app: App) -> tuple[Baseline, ...]:
    """The baselines of an application under its protocol; none where nobody wrote any."""
    if app.name not in {module.name for module in pkgutil.iter_modules(__path__)}:
        return ()
    baselines: tuple[Baseline, ...] = importlib.import_module(f"metapp.baselines.{app.name}").baselines(app)
    return baselines
