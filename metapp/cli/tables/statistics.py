"""What is said of many tasks at once: mean, median, worst task, bootstrap interval, and who is ahead of whom."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from metapp.cli.tables import Row


def bootstrap(errors: list[float], groups: list[str], draws: int = 4000) -> tuple[float, float]:
    """95 % interval of the mean over tasks, by resampling groups of tasks that show the same, with a fixed seed."""
    import numpy as np

    order = {group: index for index, group in enumerate(dict.fromkeys(groups))}
    rows = [order[group] for group in groups]
    total, count = np.bincount(rows, errors), np.bincount(rows)
    drawn = np.random.default_rng(0).integers(len(order), size=(draws, len(order)))
    low, high = np.quantile(total[drawn].sum(1) / count[drawn].sum(1), (0.025, 0.975))
    return float(low), float(high)


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


FEWEST = 5  # tasks: the bootstrap of fewer says nothing


def overlap(one: Row, other: Row) -> bool | None:
    """Whether the intervals of two rows overlap; None where one is not known, or is of too few tasks to tell."""
    if None in (one["low"], other["low"]) or min(one["tasks"], other["tasks"]) < FEWEST:
        return None
    return one["low"] <= other["high"] and other["low"] <= one["high"]


def change(one: Row, other: Row) -> str:
    """How far a row's error is from another's, in percent of that: "12 % below"; "" where one is not known."""
    if one["error"] is None or not other["error"]:
        return ""
    percent = 100 * (one["error"] - other["error"]) / abs(other["error"])
    return f"{abs(percent):.0f} % {'above' if percent > 0 else 'below'}"


def verdict(rows: list[Row], one: str = "meta", other: str = "quickft") -> str:
    """Who of two paradigms has the lower error; nobody, where their intervals overlap. "" where one is not known."""
    by = {row["paradigm"]: row for row in rows}
    if None in (by[one]["low"], by[other]["low"]):
        return ""
    tied = overlap(by[one], by[other])
    if tied is None:
        return f"{one} and {other}: fewer than {FEWEST} tasks, too few to call a win"
    if tied:
        return f"{one} and {other}: 95 % intervals overlap, no win"
    ahead = one if by[one]["error"] < by[other]["error"] else other
    return f"{one} and {other}: {ahead} wins, 95 % intervals are apart"


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
