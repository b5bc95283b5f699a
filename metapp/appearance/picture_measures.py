"""Measures of the pictures that fits make: those of an application and those that extensions offer."""

from __future__ import annotations

import math
from collections.abc import Mapping

from metapp.learning.app import App
from metapp.learning.pictures import Compared, Fitted
from metapp.learning.task import Task
from metapp.registry import load, registry


def picture_measures(app: str) -> tuple[dict[str, str], list[str]]:
    """Notes on the measures of an application's pictures, by name, and a line for each that lacks something."""
    notes, missing = {}, []
    for name, entry in registry().measures.items():
        if app in entry.apps:
            try:
                notes[name] = ", ".join([entry.help, *([load(entry.source)()] if entry.source else [])])
            except ValueError as error:
                missing.append(f"{name}: {error}")
    return notes, missing


def further_errors(app: str, compared: Compared) -> dict[str, float]:
    """What extensions measure of an application's pictures, by name; what lacks something, or is not finite, not."""
    values = {name: registry().measures[name].load()(compared) for name in picture_measures(app)[0]}
    return {name: value for name, value in values.items() if math.isfinite(value)}


def image_errors(app: App, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
    """All measures of the pictures that fits of a task make: those of `App.image_errors`, then extensions'."""
    errors = app.image_errors(fits, task)
    for name, fit in fits.items():
        if (compared := app.compared(fit.theta, task)) and (further := further_errors(app.name, compared)):
            errors[name] = errors.get(name, {}) | further
    return errors
