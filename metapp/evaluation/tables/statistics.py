"""What is said of many tasks at once: mean, median, worst task, bootstrap interval, and who is ahead of whom."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from metapp.evaluation.tables.rows import Column, Row

if TYPE_CHECKING:
    import numpy as np

FEWEST = 5  # groups of tasks: the bootstrap of fewer says nothing
DRAWS = 4000


def resample(columns: Sequence[Sequence[float]], groups: Sequence[str]) -> np.ndarray:
    """Bootstrap sums over tasks, by resampling groups of tasks that show the same, with a fixed seed.

    Args:
        columns: values of the tasks, [C][N].
        groups: of the tasks, [N].

    Returns:
        [C + 1, DRAWS]: the sums of each column, and how many tasks were drawn.
    """
    import numpy as np

    order = {group: index for index, group in enumerate(dict.fromkeys(groups))}
    rows = [order[group] for group in groups]
    drawn = np.random.default_rng(0).integers(len(order), size=(DRAWS, len(order)))
    totals = [*(np.bincount(rows, each) for each in columns), np.bincount(rows)]
    return np.stack([total[drawn].sum(1) for total in totals])


def interval_of(values: np.ndarray) -> tuple[float, float]:
    """What 95 % of the values lie between."""
    import numpy as np

    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def bootstrap(errors: list[float], groups: list[str]) -> tuple[float, float]:
    """95 % interval of the mean over tasks, by resampling groups of tasks that show the same."""
    total, count = resample([errors], groups)
    return interval_of(total / count)


def statistics_of(errors: Sequence[float], groups: list[str]) -> dict[str, Any]:
    """Mean `error`, `median`, `worst`, and the interval `low` .. `high` of the mean; None where there is none."""
    if not errors:
        return dict.fromkeys(("error", "median", "worst", "low", "high"))
    low, high = bootstrap(list(errors), groups)
    return {
        "error": statistics.fmean(errors),
        "median": statistics.median(errors),
        "worst": max(errors),
        "low": low,
        "high": high,
    }


class Paired(NamedTuple):
    """Two paradigms on the same tasks.

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
        """The value of two paradigms that are equally good."""
        return 1.0 if self.kind == "ratio" else 0.0


def paired(
    one: Mapping[str, float], other: Mapping[str, float], groups: Mapping[str, str], *, logarithmic: bool
) -> Paired | None:
    """Compare two paradigms by their errors of the same tasks.

    What makes tasks easy or hard is common to both, so that this tells paradigms apart whose own intervals overlap.

    Args:
        one: errors by the task's name.
        other: those that it is compared with.
        groups: what a task shows, by its name.
        logarithmic: compare by the difference: a ratio of logarithms means nothing.

    Returns:
        None where they have no task in common, or where there is no ratio, as the other's errors are 0.
    """
    names = [name for name in one if name in other]
    if not names:
        return None
    first, second = [one[name] for name in names], [other[name] for name in names]
    of = [groups[name] for name in names]
    ours, theirs, count = resample([first, second], of)
    if logarithmic:
        value, values = statistics.fmean(first) - statistics.fmean(second), (ours - theirs) / count
    elif min(second) < 0 or not theirs.all():
        return None
    else:
        value, values = sum(first) / sum(second), ours / theirs
    ahead = sum(a < b for a, b in zip(first, second, strict=True))
    kind = "difference" if logarithmic else "ratio"
    return Paired(value, *interval_of(values), ahead, len(names), len(set(of)), kind)


def paired_entries(other: str, found: Paired | None) -> Row:
    """A comparison as entries of a row: `vs_<other>` and so on, None where there is none."""
    values = found._asdict() if found else dict.fromkeys(Paired._fields)
    named = {f"vs_{other}_{key}": value for key, value in values.items() if key != "value"}
    return {f"vs_{other}": values["value"], **named}


def paired_of(row: Row, other: str) -> Paired | None:
    """The inverse of `paired_entries`."""
    if row.get(f"vs_{other}") is None:
        return None
    return Paired(row[f"vs_{other}"], *(row[f"vs_{other}_{key}"] for key in Paired._fields[1:]))


def apart(found: Paired | None) -> bool | None:
    """Whether two paradigms differ by more than chance; None where that is not known, or on too few tasks to tell."""
    if found is None or found.groups < FEWEST:
        return None
    return not found.low <= found.level <= found.high


def paired_text(found: Paired | None) -> str:
    """A ratio or difference with its interval: 0.962 [0.952, 0.972]."""
    if found is None:
        return "-"
    form = ".3f" if found.kind == "ratio" else "+.3f"
    return f"{found.value:{form}} [{found.low:{form}}, {found.high:{form}}]"


def paired_columns(other: str) -> tuple[Column, Column]:
    """The columns that compare rows with another paradigm."""

    def ahead(row: Row) -> str:
        found = paired_of(row, other)
        return f"{found.ahead}/{found.tasks}" if found else "-"

    return Column(f"vs {other}", lambda row: paired_text(paired_of(row, other))), Column("ahead", ahead)


def paired_note(rows: Sequence[Row], other: str = "quickft") -> list[str]:
    """What the columns that compare show."""
    kinds = {found.kind for row in rows if (found := paired_of(row, other))}
    lower = {"ratio": "below 1: lower error", "difference": "below 0: lower error"}
    return [
        f"vs {other}: {kind} of mean errors, 95 % interval (paired bootstrap over tasks; {lower[kind]}); ahead: tasks "
        "with the lower error"
        for kind in sorted(kinds)
    ]


def change(one: Row, other: Row) -> str:
    """How far a row's error is from another's, in percent of that: "12 % below"; "" where one is not known."""
    if one["error"] is None or not other["error"]:
        return ""
    percent = 100 * (one["error"] - other["error"]) / abs(other["error"])
    return f"{abs(percent):.0f} % {'above' if percent > 0 else 'below'}"


def verdict(row: Row, other: str = "quickft") -> str:
    """Whether a row's paradigm wins over another: where the interval of the two on the same tasks says so."""
    found, one = paired_of(row, other), row["paradigm"]
    if found is None:
        return ""
    said = f"{one} vs {other}: error {found.kind} {paired_text(found)}, ahead on {found.ahead} of {found.tasks} tasks"
    won = apart(found)
    if won is None:
        return f"{said}; {found.groups} different tasks, fewer than {FEWEST}, are too few to call a win"
    if not won:
        return f"{said}; no win"
    return f"{said}; {one if found.value < found.level else other} wins"


def warned(rows: Sequence[Row]) -> list[str]:
    """Fits that are no better than where they began, and how many the guard of a learned rule kept from that."""
    remarks = (
        ("warnings", "{} of {} fits ended above their initialisation's loss"),
        ("guarded", "the guard acted on {} of {} tasks, which took twice the steps"),
    )
    return [
        f"{row['paradigm']}: {remark.format(row[key], row['tasks'])}"
        for key, remark in remarks
        for row in rows
        if row.get(key)
    ]


def carried(rows: list[Row], error: str, seconds: str) -> tuple[float | None, float | None]:
    """The two figures that carry across data sets and machines: Meta's gap closed, and its speed-up over Overfit.

    There is no gap to close where Overfit is no better than General.
    """
    by = {row["paradigm"]: row for row in rows}
    general, overfit, meta = (by[name] for name in ("general", "overfit", "meta"))
    gap = speed = None
    if None not in (general[error], overfit[error], meta[error]) and overfit[error] < general[error]:
        gap = (general[error] - meta[error]) / (general[error] - overfit[error])
    if None not in (overfit[seconds], meta[seconds]):
        speed = overfit[seconds] / meta[seconds]
    return gap, speed
