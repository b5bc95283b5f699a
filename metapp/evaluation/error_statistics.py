"""Errors of many tasks: mean, median, worst task, bootstrap intervals, and paired comparisons."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

ErrorsByTask = Mapping[str, float]  # by the task's name
MIN_TASK_GROUPS = 5  # groups of tasks: the bootstrap of fewer says nothing
BOOTSTRAP_DRAWS = 4000


def bootstrap_sums(columns: Sequence[Sequence[float]], groups: Sequence[str]) -> np.ndarray:
    """Sums [K, DRAWS] of K columns of values of the same tasks, [K, N], over tasks drawn with replacement.

    Draws are of groups, from a fixed seed: tasks that show the same are drawn together.

    Args:
        columns: values of tasks.
        groups: the subject that each task shows, [N].
    """
    numbers = {group: index for index, group in enumerate(dict.fromkeys(groups))}
    rows = [numbers[group] for group in groups]
    drawn = np.random.default_rng(0).integers(len(numbers), size=(BOOTSTRAP_DRAWS, len(numbers)))
    return np.stack([np.bincount(rows, values)[drawn].sum(1) for values in columns])


def central_interval(values: np.ndarray) -> tuple[float, float]:
    """The two values between which 95 % of them lie.

    >>> interval_of(np.arange(101.0))
    (2.5, 97.5)
    """
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def summarise_errors(errors: ErrorsByTask, groups: Mapping[str, str]) -> dict[str, float | None]:
    """Mean `error`, `median`, `worst`, and the 95 % interval `low` to `high` of the mean over tasks; None without any.

    Args:
        errors: of tasks.
        groups: the subject that a task shows, by the task's name.

    >>> statistics_of({"gold": 1.0, "chalk": 3.0}, {"gold": "gold", "chalk": "chalk"})
    {'error': 2.0, 'median': 2.0, 'worst': 3.0, 'low': 1.0, 'high': 3.0}
    """
    if not errors:
        return dict.fromkeys(("error", "median", "worst", "low", "high"))
    values = list(errors.values())
    sums, counts = bootstrap_sums([values, [1.0] * len(values)], [groups[name] for name in errors])
    low, high = central_interval(sums / counts)
    return {
        "error": statistics.fmean(values),
        "median": statistics.median(values),
        "worst": max(values),
        "low": low,
        "high": high,
    }


class PairedComparison(NamedTuple):
    """Two methods compared on the same tasks.

    Attributes:
        value: the ratio of their mean errors, or the difference of these if errors are logarithms.
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


def compare_errors(
    one: ErrorsByTask, other: ErrorsByTask, groups: Mapping[str, str], *, logarithmic: bool
) -> PairedComparison | None:
    """Compare two methods by their errors of the same tasks.

    The difficulty of tasks is common to both, so that methods differ significantly whose own intervals overlap.

    Args:
        one: errors of the first method.
        other: errors of the second.
        groups: the subject that a task shows, by the task's name.
        logarithmic: compare by the difference: a ratio of logarithms means nothing.

    Returns:
        None if they have no task in common, or if there is no ratio, as the other's errors are 0.

    >>> groups = {name: name for name in "abcdef"}
    >>> paired(dict.fromkeys("abcdef", 1.0), dict.fromkeys("abcdef", 2.0), groups, logarithmic=False).value
    0.5
    """
    names = [name for name in one if name in other]
    if not names:
        return None
    first, second, of_tasks = [one[name] for name in names], [other[name] for name in names], [groups[n] for n in names]
    sums, base, counts = bootstrap_sums([first, second, [1.0] * len(names)], of_tasks)
    if logarithmic:
        value, values = statistics.fmean(first) - statistics.fmean(second), (sums - base) / counts
    elif min(second) < 0 or not base.all():
        return None
    else:
        value, values = sum(first) / sum(second), sums / base
    ahead = sum(a < b for a, b in zip(first, second, strict=True))
    kind = "difference" if logarithmic else "ratio"
    return PairedComparison(value, *central_interval(values), ahead, len(names), len(set(of_tasks)), kind)


def is_significant(pair: PairedComparison | None) -> bool | None:
    """True if two methods differ by more than chance; None if that is not known, or on too few tasks to tell."""
    if pair is None or pair.groups < MIN_TASK_GROUPS:
        return None
    return not pair.low <= pair.level <= pair.high
