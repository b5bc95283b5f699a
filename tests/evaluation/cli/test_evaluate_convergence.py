"""What convergence and figures are computed by, and the paper's figures."""

from typing import Any

import pytest

from metapp.evaluation.rows import carried, paper
from metapp.evaluation.tables.convergence import FURTHER, near, steps_needed


def test_the_papers_figures_have_sources_and_agree_with_each_other() -> None:
    known = paper()
    assert set(known["sources"]) == set(known) - {"source", "sources", "titles"}
    for kind in ("error", "seconds"):
        assert set(known[kind]) == set(known["titles"])
    gaps = {}
    for app in known["titles"]:
        names = ("general", "overfit", "meta")
        rows = [{"paradigm": name, **{key: known[key][app][name] for key in ("error", "seconds")}} for name in names]
        gaps[app], _ = carried(rows, "error", "seconds")
    # as the design brief prints them
    expected = (0.80, 0.93, 0.60, 0.78, 0.97, 0.77)
    assert [round(gap, 2) for gap in gaps.values()] == list(expected)
    assert known["storage"]["factor"] == known["storage"]["meta_networks"] / known["storage"]["exemplars"]
    for each in known["samples"].values():
        assert 1 - each["seen"] / each["all"] == pytest.approx(each["saved"], abs=1e-3)


def record(overfit: float, further: list[tuple[int, float]]) -> dict[str, Any]:
    return {"curves": {"overfit": [[0, 9.0], [40, overfit]]}, "further": further}


def test_further_steps_are_counted_until_one_is_near() -> None:
    assert steps_needed(record(1.0, [(0, 1.005)])) == 0
    assert steps_needed(record(1.0, [(0, 2.0), (8, 1.2), (16, 1.009)])) == 16
    assert steps_needed(record(1.0, [(0, 2.0), (FURTHER[-1], 1.02)])) is None
    assert near(-3.97, -4.0)  # lower is better, also below 0
    assert not near(-3.95, -4.0)
    assert near(-4.5, -4.0)
