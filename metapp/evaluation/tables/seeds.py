"""What is said of several seeds of training: intervals by resampling seeds and tasks, each by itself."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from metapp.evaluation.tables.statistics import DRAWS, Paired, interval_of

if TYPE_CHECKING:
    import numpy as np

Errors = Mapping[str, float]  # by the task's name


def mean_of(seeds: Sequence[Errors]) -> dict[str, float]:
    """The mean over seeds of each task that all of them have."""
    return {name: statistics.fmean(each[name] for each in seeds) for name in seeds[0] if all(name in s for s in seeds)}


class Resampled:
    """Draws of tasks, in groups that show the same, and of seeds.

    With one seed the draws are those of `statistics.resample`.
    """

    def __init__(self, groups: Sequence[str]) -> None:
        """Draw the tasks.

        Args:
            groups: of the tasks, [N].
        """
        import numpy as np

        order = {group: index for index, group in enumerate(dict.fromkeys(groups))}
        self.rows = np.array([order[group] for group in groups])
        self.rng = np.random.default_rng(0)
        self.drawn = self.rng.integers(len(order), size=(DRAWS, len(order)))
        self.count = np.bincount(self.rows)[self.drawn].sum(1)

    def means(self, values: Sequence[Sequence[float]]) -> np.ndarray:
        """Means [DRAWS] of values [seeds][N], with seeds drawn anew."""
        import numpy as np

        totals = np.stack([np.bincount(self.rows, each) for each in values])
        picked = self.rng.integers(len(totals), size=(DRAWS, len(totals)))
        share = np.stack([(picked == seed).mean(1) for seed in range(len(totals))], 1)
        result: np.ndarray = np.take_along_axis(share @ totals, self.drawn, 1).sum(1) / self.count
        return result


def statistics_of_seeds(seeds: Sequence[Errors], groups: Mapping[str, str]) -> dict[str, Any]:
    """As `statistics_of`, of tasks' means over seeds, with an interval over tasks and seeds.

    Args:
        seeds: the errors of each seed, at least one.
        groups: what a task shows, by its name.
    """
    means = mean_of(seeds)
    names = list(means)
    low, high = interval_of(Resampled([groups[name] for name in names]).means(_values(seeds, names)))
    return {
        "error": statistics.fmean(means.values()),
        "median": statistics.median(means.values()),
        "worst": max(means.values()),
        "low": low,
        "high": high,
    }


def paired_over_seeds(
    one: Sequence[Errors], other: Sequence[Errors], groups: Mapping[str, str], *, logarithmic: bool
) -> Paired | None:
    """As `paired`, of means over seeds; its interval is over tasks, drawn together, and over each one's own seeds.

    Returns:
        None where they have no task in common, or there is no ratio.
    """
    ours, theirs = mean_of(one), mean_of(other)
    names = [name for name in ours if name in theirs]
    if not names or (not logarithmic and min(theirs[name] for name in names) <= 0):
        return None
    drawn = Resampled([groups[name] for name in names])
    first, second = drawn.means(_values(one, names)), drawn.means(_values(other, names))
    mean, base = (statistics.fmean(each[name] for name in names) for each in (ours, theirs))
    value, values = (mean - base, first - second) if logarithmic else (mean / base, first / second)
    ahead = sum(ours[name] < theirs[name] for name in names)
    different = len({groups[name] for name in names})
    kind = "difference" if logarithmic else "ratio"
    return Paired(value, *interval_of(values), ahead, len(names), different, kind)


def _values(seeds: Sequence[Errors], names: Sequence[str]) -> list[list[float]]:
    return [[each[name] for name in names] for each in seeds]
