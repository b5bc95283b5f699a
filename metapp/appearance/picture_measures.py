"""Measures of the pictures that fits make: those of an application and those that extensions offer."""

from __future__ import annotations

import math
from collections.abc import Mapping

from metapp.door import PictureMeasure, load, offers
from metapp.learning.app import App
from metapp.learning.pictures import Compared, Fitted
from metapp.learning.task import Task


def picture_measures(app: str) -> tuple[dict[PictureMeasure, str], list[str]]:
    """The measures of an application's pictures with notes on them, and a line for each that lacks something."""
    notes, missing = {}, []
    for offer in (offer for offer in offers(PictureMeasure) if app in offer.apps):
        try:
            notes[offer] = ", ".join([offer.note, *([load(offer.source)()] if offer.source else [])])
        except ValueError as error:
            missing.append(f"{offer.name}: {error}")
    return notes, missing


def further_errors(app: str, compared: Compared) -> dict[str, float]:
    """What extensions measure of an application's pictures, by name; what lacks something, or is not finite, not."""
    values = {offer.name: load(offer.measure)(compared) for offer in picture_measures(app)[0]}
    return {name: value for name, value in values.items() if math.isfinite(value)}


def image_errors(app: App, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
    """All measures of the pictures that fits of a task make: those of `App.image_errors`, then extensions'."""
    errors = app.image_errors(fits, task)
    for name, fit in fits.items():
        if (compared := app.compared(fit.theta, task)) and (further := further_errors(app.name, compared)):
            errors[name] = errors.get(name, {}) | further
    return errors
