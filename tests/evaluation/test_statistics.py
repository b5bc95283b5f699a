"""What is said of many tasks at once: intervals against known distributions, and who wins over whom."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from metapp.evaluation.tables.rows import blank
from metapp.evaluation.tables.statistics import (
    Paired,
    apart,
    bootstrap,
    carried,
    change,
    interval_of,
    paired,
    paired_entries,
    paired_note,
    paired_of,
    paired_text,
    statistics_of,
    verdict,
)


def row(paradigm: str, error: float | None, seconds: float = 1.0) -> dict[str, Any]:
    return blank("brdf", paradigm) | {"error": error, "seconds": seconds, "tasks": 8}


def test_statistics_of_tasks() -> None:
    said = statistics_of([1.0, 2.0, 6.0], ["a", "b", "c"])
    assert (said["error"], said["median"], said["worst"]) == (3.0, 2.0, 6.0)
    assert 1.0 <= said["low"] < 3.0 < said["high"] <= 6.0
    assert set(statistics_of([], []).values()) == {None}


def test_an_interval_holds_95_percent_of_the_values() -> None:
    values = np.random.default_rng(0).permutation(np.linspace(0, 1, 2001))
    assert interval_of(values) == (pytest.approx(0.025), pytest.approx(0.975))


def test_the_bootstrap_of_many_tasks_is_normal() -> None:
    """Half the errors 0 and half 2: their mean has a standard error of 1 / sqrt(N), by the central limit theorem."""
    count = 400
    low, high = bootstrap([0.0, 2.0] * (count // 2), [str(i) for i in range(count)])
    # 4,000 draws place a quantile to 0.04 standard errors, and means come in steps of 0.1
    assert (low - 1) * count**0.5 == pytest.approx(-1.96, abs=0.15)
    assert (high - 1) * count**0.5 == pytest.approx(1.96, abs=0.15)


def compared(
    one: list[float], other: list[float], groups: str | None = None, *, logarithmic: bool = False
) -> Paired | None:
    names = [f"t{i}" for i in range(len(one))]
    of = dict(zip(names, groups or names, strict=True))
    return paired(dict(zip(names, one, strict=True)), dict(zip(names, other, strict=True)), of, logarithmic=logarithmic)


HARD = [0.1 * 1.6**i for i in range(12)]  # errors of tasks that differ by a factor of 170


def test_what_is_a_little_better_on_every_task_wins_though_intervals_overlap() -> None:
    ours = [0.95 * error * (1 + 0.02 * (-1) ** i) for i, error in enumerate(HARD)]
    (low, _), (_, high) = (bootstrap(errors, list(map(str, range(12)))) for errors in (HARD, ours))
    assert low < high  # each one's own intervals overlap by far
    found = compared(ours, HARD)
    assert found
    assert (found.kind, found.ahead, found.tasks, found.groups) == ("ratio", 12, 12, 12)
    assert found.value == pytest.approx(sum(ours) / sum(HARD))
    assert 0.93 < found.low < found.value < found.high < 0.97
    assert apart(found) is True
    assert found == compared(ours, HARD)  # the same draws each time
    assert "ahead on 12 of 12 tasks; meta wins" in verdict(row("meta", 1.0) | paired_entries("quickft", found))
    turned = compared(HARD, ours)
    assert turned
    assert turned.low == pytest.approx(1 / found.high)
    assert "quickft wins" in verdict(row("meta", 1.0) | paired_entries("quickft", turned))


def test_what_is_better_on_some_tasks_and_worse_on_others_does_not_win() -> None:
    found = compared([error * (1.5 if i % 2 else 0.6) for i, error in enumerate(HARD)], HARD)
    assert found
    assert found.low < 1 < found.high
    assert apart(found) is False
    assert "no win" in verdict(row("meta", 1.0) | paired_entries("quickft", found))
    same = compared(HARD, HARD)
    assert same
    assert (same.value, same.low, same.high, same.ahead, apart(same)) == (1.0, 1.0, 1.0, 0, False)
    assert verdict(row("meta", 1.0) | paired_entries("quickft", None)) == ""


def test_tasks_that_show_the_same_are_drawn_together() -> None:
    ours = [error * (0.9 if i < 6 else 1.02) for i, error in enumerate([1.0] * 12)]
    alone, together = compared(ours, [1.0] * 12), compared(ours, [1.0] * 12, "aaabbbcccddd")
    assert alone
    assert together
    assert alone.value == together.value
    assert together.high - together.low > 1.5 * (alone.high - alone.low)
    assert together.groups == 4
    assert apart(together) is None
    assert "4 different tasks, fewer than 5, are too few" in verdict(
        row("meta", 1.0) | paired_entries("quickft", together)
    )


def test_errors_that_are_logarithms_are_compared_by_differences() -> None:
    found = compared([-2.5 - 0.1 * i for i in range(8)], [-2.4 - 0.1 * i for i in range(8)], logarithmic=True)
    assert found
    assert found.kind == "difference"
    assert (found.value, found.low, found.high) == (pytest.approx(-0.1),) * 3
    assert apart(found) is True
    assert paired_text(found) == "-0.100 [-0.100, -0.100]"
    assert "below 0" in paired_note([row("meta", -2.5) | paired_entries("quickft", found)])[0]


def test_there_is_no_ratio_to_errors_of_zero_and_none_without_common_tasks() -> None:
    assert compared([1.0] * 6, [0.0] * 6) is None
    assert compared([1.0] * 6, [-1.0] * 6) is None
    one_is_exact = compared([1.0] * 12, [0.0, *[1.0] * 11])
    assert one_is_exact
    assert one_is_exact.value == pytest.approx(12 / 11)
    assert paired({"a": 1.0}, {"b": 1.0}, {"a": "a", "b": "b"}, logarithmic=False) is None
    entries = paired_entries("quickft", None)
    assert entries["vs_quickft"] is None
    assert entries.keys() == paired_entries("quickft", compared(HARD, HARD)).keys()
    assert paired_of(entries, "quickft") is None
    assert paired_of(paired_entries("quickft", compared(HARD, HARD)), "quickft") == compared(HARD, HARD)


def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(100):
        hard = rng.lognormal(0, 1, 40)
        found = compared(list(0.9 * hard * rng.lognormal(-0.02, 0.2, 40)), list(hard))
        assert found
        hits += found.low <= 0.9 <= found.high
    assert 82 <= hits <= 100


def test_changes_are_of_the_size_of_the_other_error() -> None:
    assert change(row("meta", 0.75), row("quickft", 1.0)) == "25 % below"
    assert change(row("meta", -5.0), row("quickft", -4.0)) == "25 % below"  # likelihoods are negative


def test_there_is_no_gap_to_close_where_overfit_is_no_better() -> None:
    rows = [row("general", 2.0), row("overfit", 1.0, 30.0), row("meta", 1.25, 2.0)]
    assert carried(rows, "error", "seconds") == (0.75, 15.0)
    rows[1] |= {"error": 2.5}
    assert carried(rows, "error", "seconds") == (None, 15.0)
