"""Measures of the pictures that fits make: by name in the registry, and an application's own.

Extensions add measures by the registry; no table and no application names any of them.
"""

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
        value: returns the measure of a comparison; NaN if there is none.
        source: returns the package and version that compute it, and raises ValueError if the package is missing. None
            if metapp computes it.
        more_is_better: whether a higher value is better.
    """

    value: Callable[[PictureComparison], float]
    source: Callable[[], str] | None = None
    more_is_better: bool = False


def mean_ssim(compared: PictureComparison) -> float:
    """Return the mean SSIM over the pixels that count."""
    values = ssim(compared.pictures, compared.references)
    return float((values if compared.mask is None else values[..., compared.mask]).mean())


SSIM = PictureMeasure(mean_ssim, more_is_better=True)


def describe_picture_measures(app: str) -> tuple[dict[str, str], list[str]]:
    """Describe the registered measures of an application's pictures.

    Args:
        app: name of the application.

    Returns:
        Notes on measures, by name, and a line for each measure whose package is missing.
    """
    notes, missing = {}, []
    for name, entry in registry().measures.items():
        if app in entry.apps:
            measure: PictureMeasure = entry.load()
            try:
                notes[name] = ", ".join([entry.note, *([measure.source()] if measure.source else [])])
            except ValueError as error:
                missing.append(f"{name}: {error}")
    return notes, missing


def registered_picture_errors(app: str, compared: PictureComparison) -> dict[str, float]:
    """Return registered measures of an application's pictures, by name; missing and infinite ones are left out.

    Args:
        app: name of the application.
        compared: the pictures and their references.
    """
    values = {name: registry().measures[name].load().value(compared) for name in describe_picture_measures(app)[0]}
    return {name: value for name, value in values.items() if math.isfinite(value)}


def measure_pictures(
    presenter: Presenter[Any], fits: Mapping[str, TimedFit], task: Task
) -> dict[str, dict[str, float]]:
    """Measure the pictures that fits of a task make: by the application's own measures, then by registered ones."""
    errors = presenter.picture_errors(fits, task)
    for name, fit in fits.items():
        compared = presenter.comparison(fit.theta, task)
        if compared and (registered_errors := registered_picture_errors(presenter.app.name, compared)):
            errors[name] = errors.get(name, {}) | registered_errors
    return errors
