"""Means over fits, as tables and objects of commands state them."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from metapp.runs.fit import Fit


def mean_error(fits: Sequence[Fit]) -> float | None:
    """Return the mean error of fits in the unit of tables, without fits that have none; None if no fit has one."""
    errors = [fit.error for fit in fits if fit.error is not None]
    return statistics.fmean(errors) if errors else None


def summarise(fits: Sequence[Fit]) -> dict[str, float | None]:
    """Return the mean error of fits in the unit of tables, and the median inference time of a task in seconds.

    Fits without an error or a time are left out. Fits of photos without a reference have the mean of `photo_error`,
    too.

    >>> from metapp.runs.spec import Spec
    >>> fits = [Fit(name=name, spec=Spec(app="brdf"), error=error, seconds=0.5) for name, error in (("a", 1), ("b", 3))]
    >>> summarise(fits)
    {'error': 2.0, 'seconds': 0.5}
    """
    photo_errors = [fit.photo_error for fit in fits if fit.photo_error is not None]
    seconds = [fit.seconds for fit in fits if fit.seconds is not None]
    return {
        "error": mean_error(fits),
        **({"photo_error": statistics.fmean(photo_errors)} if photo_errors else {}),
        "seconds": statistics.median(seconds) if seconds else None,
    }


def count_guarded(fits: Sequence[Fit]) -> int | None:
    """Count the fits on which the guard of a learned rule acted; None if no fit had a guard."""
    flags = [fit.guarded for fit in fits if fit.guarded is not None]
    return sum(flags) if flags else None
