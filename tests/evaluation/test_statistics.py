"""Statistics over many tasks: intervals against known distributions, paired comparisons."""

from collections.abc import Sequence

import numpy as np
import pytest

from metapp.evaluation.error_statistics import (
    PairedComparison,
    bootstrap_interval,
    compare_errors,
    is_significant,
    summarise_errors,
)

HARD = [0.1 * 1.6**i for i in range(12)]  # errors of tasks that differ by a factor of 170


def by_name(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    return {f"t{i}": float(value) for i, value in enumerate(values)}


def interval(values: Sequence[float]) -> tuple[float, float, float]:
    errors = by_name(values)
    found = summarise_errors(errors, {name: name for name in errors})
    assert found["low"] is not None
    assert found["error"] is not None
    assert found["high"] is not None
    return found["low"], found["error"], found["high"]


def compared(
    one: Sequence[float], other: Sequence[float], groups: str | None = None, *, logarithmic: bool = False
) -> PairedComparison | None:
    names = by_name(one)
    return compare_errors(
        names, by_name(other), dict(zip(names, groups or names, strict=True)), logarithmic=logarithmic
    )


def some(found: PairedComparison | None) -> PairedComparison:
    assert found
    return found


def test_statistics_of_tasks_agree_with_worked_values() -> None:
    found = summarise_errors({"a": 1.0, "b": 2.0, "c": 6.0}, {name: name for name in "abc"})
    assert (found["error"], found["median"], found["worst"]) == (3.0, 2.0, 6.0)
    low, mean, high = interval([1.0, 2.0, 6.0])
    assert 1.0 <= low < mean < high <= 6.0
    assert set(summarise_errors({}, {}).values()) == {None}


def test_an_interval_is_that_of_a_mean_of_normal_values() -> None:
    values = np.random.default_rng(0).normal(size=400)
    low, high = bootstrap_interval(lambda sums, counts: sums / counts, [values, np.ones(400)], [*map(str, range(400))])
    half = 1.96 * values.std() / 20
    assert (low, high) == (pytest.approx(values.mean() - half, abs=0.01), pytest.approx(values.mean() + half, abs=0.01))


def test_a_little_better_on_every_task_is_significant() -> None:
    ours = [0.95 * error * (1 + 0.02 * (-1) ** i) for i, error in enumerate(HARD)]
    assert interval(HARD)[0] < interval(ours)[2]  # each one's own intervals overlap by far
    found = some(compared(ours, HARD))
    assert (found.kind, found.ahead, found.tasks, found.groups) == ("ratio", 12, 12, 12)
    assert found.value == pytest.approx(sum(ours) / sum(HARD))
    assert 0.93 < found.low < found.value < found.high < 0.97
    assert is_significant(found) is True
    assert found == compared(ours, HARD)  # the same draws each time
    assert some(compared(HARD, ours)).low == pytest.approx(1 / found.high)


def test_better_on_some_tasks_and_worse_on_others_is_not() -> None:
    found = some(compared([error * (1.5 if i % 2 else 0.6) for i, error in enumerate(HARD)], HARD))
    assert found.low < 1 < found.high
    assert is_significant(found) is False
    same = some(compared(HARD, HARD))
    assert (same.value, same.low, same.high, same.ahead, is_significant(same)) == (1.0, 1.0, 1.0, 0, False)


def test_tasks_that_show_the_same_are_drawn_together() -> None:
    ours = [error * (0.9 if i < 6 else 1.02) for i, error in enumerate([1.0] * 12)]
    alone, together = (some(compared(ours, [1.0] * 12, groups)) for groups in (None, "aaabbbcccddd"))
    assert alone.value == together.value
    assert together.high - together.low > 1.5 * (alone.high - alone.low)
    assert together.groups == 4
    assert is_significant(together) is None


def test_errors_that_are_logarithms_are_compared_by_differences() -> None:
    found = some(compared([-2.5 - 0.1 * i for i in range(8)], [-2.4 - 0.1 * i for i in range(8)], logarithmic=True))
    assert found.kind == "difference"
    assert (found.value, found.low, found.high) == (pytest.approx(-0.1),) * 3
    assert is_significant(found) is True
    assert str(found) == "-0.100 [-0.100, -0.100]"


def test_no_ratio_is_given_to_zero_or_without_common_tasks() -> None:
    assert compared([1.0] * 6, [0.0] * 6) is None
    assert compared([1.0] * 6, [-1.0] * 6) is None
    assert some(compared([1.0] * 12, [0.0, *[1.0] * 11])).value == pytest.approx(12 / 11)
    assert compare_errors({"a": 1.0}, {"b": 1.0}, {"a": "a", "b": "b"}, logarithmic=False) is None
    assert is_significant(None) is None


def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(100):
        hard = rng.lognormal(0, 1, 40)
        found = some(compared(list(0.9 * hard * rng.lognormal(-0.02, 0.2, 40)), list(hard)))
        hits += found.low <= 0.9 <= found.high
    assert 82 <= hits <= 100
