"""`metapp plan`: what to measure, filled in and fitted; nothing that was filled in is lost."""

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Generator
from torch.nn.functional import normalize

from data_tools.readers.gonio import read_pairs, write_pairs
from data_tools.readers.measured_pairs import MeasuredPairs, task_of_pairs
from metapp.appearance.geometry import angle_cosines, directions_to_full_rusinkiewicz
from metapp.appearance.reflection import microfacet_lobe
from metapp.extensions.plan.planned_pairs import MAX_PLANNED_FROM
from metapp.runs.stored_fits import read_fits

pytestmark = pytest.mark.usefixtures("small_spheres")


def fill_in(file: Path) -> None:
    """Measure a rough red plastic where a plan asks for it."""
    rows = list(csv.reader(file.read_text().splitlines()))
    for row in rows[3:]:
        theta_i, phi_i, theta_o, phi_o = (math.radians(float(word)) for word in row[:4])
        wi, wo = (
            torch.tensor([[math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)]]).double()
            for t, p in ((theta_i, phi_i), (theta_o, phi_o))
        )
        at = angle_cosines(directions_to_full_rusinkiewicz(wi, wo))
        gloss = float(microfacet_lobe(at, 0.3, lambda cos: 0.04 + 0.96 * (1 - cos) ** 5)[0])
        row[4:] = [f"{albedo / math.pi + gloss:.6g}" for albedo in (0.4, 0.1, 0.05)]
    file.write_text("\n".join(",".join(row) for row in rows) + "\n")


def test_plan_measure_fit_and_plan_again(metapp: Callable, tmp_path: Path) -> None:
    file = tmp_path / "paint.csv"
    planned = metapp("plan", "brdf", "--samples", 12, "--out", file, "--json").json_document
    expected = planned["expected_error"]
    assert 0 < expected["after"] < 0.2 * expected["before"]
    assert Path(planned["picture"]).is_file()
    assert "line 4: r nan" in metapp("meta", "brdf", file).error
    fill_in(file)
    again = metapp("plan", "brdf", "--samples", 12, "--out", file)
    assert "is there already, expected a new file; add --overwrite" in again.misuse
    fitted = metapp("meta", "brdf", file, "--json")
    assert "recipe few, as the input has 200 samples or fewer" in fitted.err
    assert "all 12 samples are fitted, none is held out" in fitted.err
    run = Path(fitted.json_document["out"])
    assert fitted.json_document["error"] < 0.5
    (fit,) = read_fits(run)
    assert 0 < (fit.further_errors["expected"] or 0) < expected["before"]
    more = tmp_path / "more.csv"  # its first rows are those that were measured
    then = metapp("plan", "brdf", "--samples", 3, "--after", file, "--out", more, "--json", "-q").json_document
    assert then["expected_error"]["after"] < then["expected_error"]["before"]
    rows = list(csv.reader(more.read_text().splitlines()))[3:]
    assert [row[4] != "" for row in rows] == [True] * 12 + [False] * 3
    fill_in(more)
    np.testing.assert_allclose(read_pairs(more).reflectance[:12], read_pairs(file).reflectance, rtol=1e-5)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("texture",), "'texture': expected brdf"),
        (("brdf", "--samples", 0), "samples"),
        (("brdf", "--seed", 10**22), "--seed"),
        (("brdf", "--detector", 85, "--out", "a.csv"), "0 of 4096 pairs of directions within the limits"),
        (("brdf", "--after", "gone.csv", "--out", "a.csv"), "gone.csv"),
    ],
)
def test_impossible_plans_are_refused(metapp: Callable, words: tuple[object, ...], found: str) -> None:
    result = metapp("plan", *words)
    assert result.code in (1, 2)
    assert found in result.err
    assert "Traceback" not in result.err
    assert not Path("a.csv").exists()


def test_as_few_rows_as_a_file_may_have_are_fitted(metapp: Callable, tmp_path: Path) -> None:
    file = tmp_path / "paint.csv"
    assert metapp("plan", "brdf", "--samples", 4, "--out", file).code == 0
    fill_in(file)
    pairs = read_pairs(file)
    fitted = metapp("meta", "brdf", file)
    assert float(fitted.out.partition("error x100 ")[2].split()[0]) < 1
    assert "over samples that are held out, or all if none is" in fitted.out
    (fitted,) = metapp("baseline", "brdf", file, "--method", "ggx_2", "--json").json_document["tasks"]
    assert fitted["error"] < 1
    assert len(task_of_pairs("arrays", pairs).data["angles"].unique(dim=0)) == 4


@pytest.mark.parametrize(
    ("limits", "reached"), [((), True), (("--apart", 40), True), (("--detector", 5, "--apart", 40), False)]
)
def test_a_plan_without_mirror_directions_says_so(
    metapp: Callable, tmp_path: Path, limits: tuple[str | float, ...], reached: bool
) -> None:
    """With a camera near the normal, and the light at some distance from it, no half vector is near the normal."""
    planned = metapp("plan", "brdf", "--samples", 5, "--out", tmp_path / "paint.csv", *limits)
    assert planned.code == 0
    assert ("highlight: no sample within 5 degrees of mirror directions" in planned.err) != reached


def test_a_plan_after_many_measurements_reads_some_of_them_and_says_so(
    metapp: Callable, tmp_path: Path, rng: Generator
) -> None:
    """All of them are in the new table."""
    file, more, count = tmp_path / "paint.csv", tmp_path / "more.csv", MAX_PLANNED_FROM + 1
    wi, wo = normalize(torch.rand(2, count, 3, generator=rng, dtype=torch.float64) + 0.1, dim=-1)
    write_pairs(file, wi[:0], wo[:0], MeasuredPairs(wi, wo, torch.full_like(wi, 0.1)))
    planned = metapp("plan", "brdf", "--samples", 1, "--after", file, "--out", more)
    assert f"{file}: {count:,} measurements, planned from {MAX_PLANNED_FROM:,} of them" in planned.err
    assert len(more.read_text().splitlines()) == 3 + count + 1
    again = metapp("plan", "brdf", "--samples", 1, "--after", file, "--out", more, "--overwrite", "--quiet")
    assert again.err == ""
