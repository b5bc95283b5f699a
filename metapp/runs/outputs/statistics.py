"""Errors of many tasks and seeds: mean, median, worst task, bootstrap intervals, and paired comparisons."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

Errors = Mapping[str, float]  # by the task's name
FEWEST = 5  # groups of tasks: the bootstrap of fewer says nothing
DRAWS = 4000


class Bootstrap:
    """Resampling with replacement from a fixed seed: of groups of tasks that show the same, and of seeds.

    Attributes:
        count: [DRAWS], the number of tasks in each draw.
    """

    def __init__(self, groups: Sequence[str]) -> None:
        """Draw the groups; `groups` are those of the tasks, [N]."""
        numbers = {group: index for index, group in enumerate(dict.fromkeys(groups))}
        self._rows = np.array([numbers[group] for group in groups])
        self._rng = np.random.default_rng(0)
        self._drawn = self._rng.integers(len(numbers), size=(DRAWS, len(numbers)))
        self.count = np.bincount(self._rows)[self._drawn].sum(1)

    def sums(self, seeds: Sequence[Sequence[float]]) -> np.ndarray:
        """Sums [DRAWS] over the drawn tasks of values [seeds][N], averaged over seeds that each call draws anew."""
        totals = np.stack([np.bincount(self._rows, values) for values in seeds])
        picked = self._rng.integers(len(totals), size=(DRAWS, len(totals)))
        share = np.stack([(picked == seed).mean(1) for seed in range(len(totals))], 1)
        result: np.ndarray = np.take_along_axis(share @ totals, self._drawn, 1).sum(1)
        return result


def interval_of(values: np.ndarray) -> tuple[float, float]:
    """The two values between which 95 % of them lie."""
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def mean_of(seeds: Sequence[Errors]) -> dict[str, float]:
    """The mean over seeds of each task that all of them have."""
    return {name: statistics.fmean(seed[name] for seed in seeds) for name in seeds[0] if all(name in s for s in seeds)}


def statistics_of(seeds: Sequence[Errors], groups: Mapping[str, str]) -> dict[str, float | None]:
    """Mean `error`, `median`, `worst`, and the 95 % interval `low` to `high` of the mean over tasks; None without any.

    Args:
        seeds: the errors of each seed of training, at least one seed; the interval is over tasks and seeds.
        groups: what a task shows, by its name.
    """
    means = mean_of(seeds)
    if not means:
        return dict.fromkeys(("error", "median", "worst", "low", "high"))
    draws = Bootstrap([groups[name] for name in means])
    low, high = interval_of(draws.sums(_values(seeds, list(means))) / draws.count)
    return {
        "error": statistics.fmean(means.values()),
        "median": statistics.median(means.values()),
        "worst": max(means.values()),
        "low": low,
        "high": high,
    }


class Paired(NamedTuple):
    """Two methods compared on the same tasks.

    Attributes:
        value: the ratio of their mean errors, or the difference of these where errors are logarithms.
        low: end of its 95 % interval, by resampling tasks: both errors of a task are drawn together.
        high: the other end.
        ahead: tasks on which the first has the lower error.
        tasks: that both have errors of.
        groups: of these that show different things.
        kind: "ratio" or "difference".
    """

    value: float
    low: float
    high: float
    ahead: int
    tasks: int
    groups: int
    kind: str

    @property
    def level(self) -> float:
        """The value of two methods that are equally good."""
        return 1.0 if self.kind == "ratio" else 0.0

    def __str__(self) -> str:
        """The value with its interval: 0.962 [0.952, 0.972]."""
        form = ".3f" if self.kind == "ratio" else "+.3f"
        return f"{self.value:{form}} [{self.low:{form}}, {self.high:{form}}]"


def paired(
    one: Sequence[Errors], other: Sequence[Errors], groups: Mapping[str, str], *, logarithmic: bool
) -> Paired | None:
    """Compare two methods by their errors of the same tasks.

    What makes tasks easy or hard is common to both, so that this tells methods apart whose own intervals overlap. Where
    there are several seeds of training, means over them are compared; each method's own seeds are resampled, too.

    Args:
        one: errors of each seed, at least one seed.
        other: those that they are compared with.
        groups: what a task shows, by its name.
        logarithmic: compare by the difference: a ratio of logarithms means nothing.

    Returns:
        None where they have no task in common, or where there is no ratio, as the other's errors are 0.
    """
    ours, theirs = mean_of(one), mean_of(other)
    names = [name for name in ours if name in theirs]
    if not names:
        return None
    first, second = [ours[name] for name in names], [theirs[name] for name in names]
    draws = Bootstrap([groups[name] for name in names])
    sums, base = draws.sums(_values(one, names)), draws.sums(_values(other, names))
    if logarithmic:
        value, values = statistics.fmean(first) - statistics.fmean(second), (sums - base) / draws.count
    elif min(second) < 0 or not base.all():
        return None
    else:
        value, values = sum(first) / sum(second), sums / base
    ahead = sum(a < b for a, b in zip(first, second, strict=True))
    kind = "difference" if logarithmic else "ratio"
    return Paired(value, *interval_of(values), ahead, len(names), len({groups[name] for name in names}), kind)


def apart(pair: Paired | None) -> bool | None:
    """True if two methods differ by more than chance; None where that is not known, or on too few tasks to tell."""
    if pair is None or pair.groups < FEWEST:
        return None
    return not pair.low <= pair.level <= pair.high


def _values(seeds: Sequence[Errors], names: Sequence[str]) -> list[list[float]]:
    return [[seed[name] for name in names] for seed in seeds]
