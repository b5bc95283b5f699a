"""Statistics of errors over many tasks: mean, median, worst task, bootstrap intervals, and paired comparisons.

Tasks that show the same thing form a group, and the bootstrap draws groups: otherwise, photographs of one material
would count as independent. The module knows errors by task name alone, neither records nor tables.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap
from typing_extensions import override

ErrorsByTask = Mapping[str, float]  # errors by the task's name
MIN_TASK_GROUPS = 5  # groups of tasks; a bootstrap over fewer groups says nothing
BOOTSTRAP_DRAWS = 4000  # sets of groups, each drawn with replacement


def bootstrap_interval(
    statistic: Callable[..., np.ndarray], columns: Sequence[Sequence[float]], groups: Sequence[str]
) -> tuple[float, float]:
    """Return the 95 % interval of a statistic of sums over tasks, which are drawn with replacement from a fixed seed.

    Groups are drawn, not tasks: tasks of one group are drawn together. It is the percentile interval.

    Args:
        statistic: returns the statistic, [...], given the sums of each column, K arrays [...].
        columns: K columns of values of the same N tasks, [K, N].
        groups: the group of each task, [N].

    >>> bootstrap_interval(lambda sums, counts: sums / counts, [[1.0, 3.0], [1.0, 1.0]], ["a", "b"])
    (1.0, 3.0)
    """
    group_numbers = {group: index for index, group in enumerate(dict.fromkeys(groups))}
    task_groups = [group_numbers[group] for group in groups]
    sums_by_group = [np.bincount(task_groups, values) for values in columns]
    if len(sums_by_group[0]) < 2:  # every draw is the one group
        value = float(statistic(*(sums[0] for sums in sums_by_group)))
        return value, value
    low, high = bootstrap(
        sums_by_group,
        lambda *drawn, axis: statistic(*(sums.sum(axis) for sums in drawn)),
        n_resamples=BOOTSTRAP_DRAWS,
        vectorized=True,
        paired=True,
        method="percentile",
        rng=0,
    ).confidence_interval
    return float(low), float(high)


def summarise_errors(errors: ErrorsByTask, groups: Mapping[str, str]) -> dict[str, float | None]:
    """Return mean, median and worst error of tasks, and the 95 % interval of the mean over tasks.

    Args:
        errors: errors by the task's name.
        groups: the group of each task, by the task's name.

    Returns:
        The mean `error`, `median`, `worst`, and the ends of the interval, `low` and `high`; None each if there is no
        error.

    >>> summarise_errors({"gold": 1.0, "chalk": 3.0}, {"gold": "gold", "chalk": "chalk"})
    {'error': 2.0, 'median': 2.0, 'worst': 3.0, 'low': 1.0, 'high': 3.0}
    """
    if not errors:
        return dict.fromkeys(("error", "median", "worst", "low", "high"))
    values = list(errors.values())
    columns = [values, [1.0] * len(values)]
    low, high = bootstrap_interval(lambda sums, counts: sums / counts, columns, [groups[name] for name in errors])
    return {
        "error": statistics.fmean(values),
        "median": statistics.median(values),
        "worst": max(values),
        "low": low,
        "high": high,
    }


class PairedComparison(NamedTuple):
    """The comparison of two methods on the tasks that both have errors of.

    Attributes:
        value: the ratio of their mean errors, first over second, or the difference of these if errors are logarithms.
        low: the lower end of the value's 95 % interval, by resampling tasks with both errors of a task drawn together.
        high: the upper end of this interval.
        ahead: the number of tasks on which the first method has the lower error.
        tasks: the number of tasks that both methods have errors of.
        groups: the number of groups among these tasks.
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
    def equal_value(self) -> float:
        """The value for two methods that are equally good."""
        return 1.0 if self.kind == "ratio" else 0.0

    @override
    def __str__(self) -> str:
        """Return the value with its interval, such as 0.962 [0.952, 0.972]."""
        form = ".3f" if self.kind == "ratio" else "+.3f"
        return f"{self.value:{form}} [{self.low:{form}}, {self.high:{form}}]"


def compare_errors(
    one: ErrorsByTask, other: ErrorsByTask, groups: Mapping[str, str], *, logarithmic: bool
) -> PairedComparison | None:
    """Compare two methods by their errors of the same tasks.

    How hard a task is affects both methods alike. So methods can differ significantly whose own intervals overlap.

    Args:
        one: the first method's errors by task.
        other: the second method's errors by task.
        groups: the group of each task, by the task's name.
        logarithmic: whether errors are logarithms, whose difference is taken since their ratio means nothing.

    Returns:
        The comparison; None if the methods have no task in common, or if there is no ratio, as the second method's
        errors are 0.

    >>> groups = {name: name for name in "abcdef"}
    >>> compare_errors(dict.fromkeys("abcdef", 1.0), dict.fromkeys("abcdef", 2.0), groups, logarithmic=False).value
    0.5
    """
    names = [name for name in one if name in other]
    if not names:
        return None
    first, second = [one[name] for name in names], [other[name] for name in names]
    task_groups = [groups[name] for name in names]
    columns = [first, second, [1.0] * len(names)]
    if logarithmic:
        value = statistics.fmean(first) - statistics.fmean(second)
        interval = bootstrap_interval(lambda sums, others, counts: (sums - others) / counts, columns, task_groups)
    elif min(second) < 0 or not sum(second):
        return None
    else:
        value = sum(first) / sum(second)
        with np.errstate(divide="ignore", invalid="ignore"):  # draws of groups whose errors are 0
            interval = bootstrap_interval(lambda sums, others, counts: sums / others, columns, task_groups)
        if not np.isfinite(interval).all():
            return None
    ahead = sum(a < b for a, b in zip(first, second, strict=True))
    kind = "difference" if logarithmic else "ratio"
    return PairedComparison(value, *interval, ahead, len(names), len(set(task_groups)), kind)


def is_significant(comparison: PairedComparison | None) -> bool | None:
    """Return whether two methods differ by more than chance; None if there are too few tasks to tell."""
    if comparison is None or comparison.groups < MIN_TASK_GROUPS:
        return None
    return not comparison.low <= comparison.equal_value <= comparison.high
