"""Notes below tables: verdicts, the gap closed, figures of the paper, and steps after which Meta is near Overfit."""

from typing import Any

import pytest

from metapp.evaluation.error_statistics import PairedComparison
from metapp.evaluation.rows import describe_winner, paired_columns_note, paper_figures, scale_free_figures
from metapp.evaluation.table import flatten_row
from metapp.evaluation.tables.convergence import FURTHER_STEPS, further_steps_needed, is_near
from metapp.evaluation.tables.results import describe_error_change
from tests.kept_fits import fit_of


def row(paradigm: str, error: float | None, seconds: float = 1.0) -> dict[str, Any]:
    return {"app": "brdf", "paradigm": paradigm, "error": error, "seconds": seconds, "tasks": 8}


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (PairedComparison(0.95, 0.94, 0.96, 12, 12, 12, "ratio"), "lower on 12 of 12 tasks; meta wins"),
        (PairedComparison(1.05, 1.04, 1.06, 0, 12, 12, "ratio"), "lower on 0 of 12 tasks; quickft wins"),
        (PairedComparison(1.0, 0.9, 1.1, 6, 12, 12, "ratio"), "; no win"),
        (PairedComparison(-0.1, -0.2, -0.05, 9, 9, 5, "difference"), "meta wins"),
        (
            PairedComparison(0.9, 0.8, 0.95, 9, 12, 4, "ratio"),
            "4 different tasks, fewer than 5, are too few to call a win",
        ),
        (None, ""),
    ],
)
def test_verdicts_name_the_method_with_the_lower_error(found: PairedComparison | None, said: str) -> None:
    compared = row("meta", 1.0) | {"vs_quickft": found}
    lines = describe_winner(compared)
    assert len(lines) == bool(found)
    assert all(line.endswith(said) for line in lines)
    notes = paired_columns_note([compared])
    assert notes == [] if found is None else f"below {found.kind == 'ratio':d}: a lower error" in notes[0]
    written = flatten_row(compared)
    assert set(written) == {*compared, *(f"vs_quickft_{field}" for field in PairedComparison._fields[1:])}
    assert [written[key] for key in ("vs_quickft", "vs_quickft_low")] == ([*found[:2]] if found else [None, None])


def test_changes_are_of_the_size_of_the_other_error() -> None:
    assert describe_error_change(row("meta", 0.75), row("quickft", 1.0)) == "25 % below"
    assert describe_error_change(row("meta", -5.0), row("quickft", -4.0)) == "25 % below"  # likelihoods are negative
    assert describe_error_change(row("meta", 5.0), row("quickft", 4.0)) == "25 % above"
    assert describe_error_change(row("meta", None), row("quickft", 4.0)) == ""


def test_no_gap_is_reported_where_overfit_is_no_better() -> None:
    rows = [row("general", 2.0), row("overfit", 1.0, 30.0), row("meta", 1.25, 2.0)]
    assert scale_free_figures(rows, "error", "seconds") == (0.75, 15.0)
    rows[1] |= {"error": 2.5}
    assert scale_free_figures(rows, "error", "seconds") == (None, 15.0)


def test_the_papers_figures_have_sources_and_agree_with_each_other() -> None:
    known = paper_figures()
    assert set(known["sources"]) == set(known) - {"source", "sources", "titles"}
    for kind in ("error", "seconds"):
        assert set(known[kind]) == set(known["titles"])
    gaps = {}
    for app in known["titles"]:
        names = ("general", "overfit", "meta")
        rows = [{"paradigm": name, **{key: known[key][app][name] for key in ("error", "seconds")}} for name in names]
        gaps[app], _ = scale_free_figures(rows, "error", "seconds")
    # as the design brief prints them
    expected = (0.80, 0.93, 0.60, 0.78, 0.97, 0.77)
    assert [round(gap, 2) for gap in gaps.values()] == list(expected)
    assert known["storage"]["factor"] == known["storage"]["meta_networks"] / known["storage"]["exemplars"]
    for sample_source in known["samples"].values():
        assert 1 - sample_source["seen"] / sample_source["all"] == pytest.approx(sample_source["saved"], abs=1e-3)


def test_further_steps_are_counted_until_one_is_near() -> None:
    for overfit, further, expected in (
        (1.0, [(0, 1.005)], 0),
        (1.0, [(0, 2.0), (8, 1.2), (16, 1.009)], 16),
        (1.0, [(0, 2.0), (FURTHER_STEPS[-1], 1.02)], None),
    ):
        figures = {"curves": {"overfit": [[0, 9.0], [40, overfit]]}, "further": further}
        assert further_steps_needed(fit_of(name="a", error=None, figures=figures)) == expected
    # lower is better, also below 0
    assert [is_near(error, -4.0) for error in (-3.97, -3.95, -4.5)] == [True, False, True]
