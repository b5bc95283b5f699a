"""Measures of the pictures that fits make: by name in the registry, and an application's own."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from metapp.appearance.metrics import ssim
from metapp.appearance.pictures import PictureComparison, TimedFit
from metapp.appearance.presenter import Presenter
from metapp.learning.task import Task
from metapp.registry import registry


class PictureMeasure(NamedTuple):
    """A measure of pictures of fits against their references, a row of the table `image`.

    Attributes:
        value: of such pictures; NaN if there is none.
        source: by which package and version; ValueError if that is missing. None if metapp does.
        more_is_better: whether a higher value is better.
    """

    value: Callable[[PictureComparison], float]
    source: Callable[[], str] | None = None
    more_is_better: bool = False


def mean_ssim(compared: PictureComparison) -> float:
    """Mean SSIM over the pixels that count."""
    values = ssim(compared.pictures, compared.references)
    return float((values if compared.mask is None else values[..., compared.mask]).mean())


SSIM = PictureMeasure(mean_ssim, more_is_better=True)


def describe_picture_measures(app: str) -> tuple[dict[str, str], list[str]]:
    """Notes on the measures of an application's pictures, by name, and a line for each that lacks something."""
    notes, missing = {}, []
    for name, entry in registry().measures.items():
        if app in entry.apps:
            measure: PictureMeasure = entry.load()
            try:
                notes[name] = ", ".join([entry.help, *([measure.source()] if measure.source else [])])
            except ValueError as error:
                missing.append(f"{name}: {error}")
    return notes, missing


def registered_picture_errors(app: str, compared: PictureComparison) -> dict[str, float]:
    """Registered measures of an application's pictures, by name; missing and infinite ones are left out."""
    values = {name: registry().measures[name].load().value(compared) for name in describe_picture_measures(app)[0]}
    return {name: value for name, value in values.items() if math.isfinite(value)}


def measure_pictures(
    presenter: Presenter[Any], fits: Mapping[str, TimedFit], task: Task
) -> dict[str, dict[str, float]]:
    """Measure the pictures that fits of a task make: by the application's own measures, then by registered ones."""
    errors = presenter.picture_errors(fits, task)
    for name, fit in fits.items():
        compared = presenter.comparison(fit.theta, task)
        if compared and (further := registered_picture_errors(presenter.app.name, compared)):
            errors[name] = errors.get(name, {}) | further
    return errors
