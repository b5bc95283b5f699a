"""Goniometer tables: what is read is what was measured, and whatever is no such table is refused in one line."""

import math
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from data_tools.readers import brdf_task, gonio, measured_pairs
from data_tools.readers.brdf_objects import task_of_object
from data_tools.readers.measured_pairs import MeasuredPairs
from data_tools.synthetic.examples import write_example
from metapp.appearance.colorimetry import import_colour_science, spectrum_to_rgb_matrix
from metapp.appearance.geometry import directions_to_full_rusinkiewicz, is_above_horizon, rusinkiewicz_to_directions
from metapp.registry import registry
from metapp.runs import api

pytestmark = pytest.mark.usefixtures("small_spheres")
HEAD = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"
ROW = "30,0,30,180,0.1,0.2,0.3"


def material(angles: Tensor) -> Tensor:
    """Smooth, coloured, and not reciprocal: phi_d counts over the full circle."""
    theta_h, _, phi_d = angles.unbind(-1)
    return (torch.exp(-4 * theta_h) + 0.05 * phi_d)[..., None] * torch.tensor([1.0, 0.6, 0.3], dtype=angles.dtype)


def read_measurements(file: Path) -> tuple[Tensor, Tensor]:
    """Angles [N, 3] and reflectance of a file."""
    pairs = gonio.read_pairs(file)
    return directions_to_full_rusinkiewicz(pairs.wi, pairs.wo), pairs.reflectance


def spherical(directions: Tensor) -> tuple[Tensor, Tensor]:
    return directions[:, 2].clamp(-1, 1).acos(), torch.atan2(directions[:, 1], directions[:, 0])


@pytest.fixture
def angles() -> Tensor:
    draws = torch.rand(3000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    draws = 0.02 + draws * torch.tensor([1.5, 1.5, 6.2])
    return draws[is_above_horizon(draws)]


@pytest.fixture
def write(tmp_path: Path, angles: Tensor) -> Callable[..., Path]:
    """Writes what a goniometer would measure of the material, from a random side."""

    def table(unit: str = "deg") -> Path:
        wi, wo = rusinkiewicz_to_directions(angles)
        turn = torch.rand(len(angles), dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 6
        scale = 180 / math.pi if unit == "deg" else 1.0
        parts = [part for vectors in (wi, wo) for part in spherical(vectors)]
        places = [(part + turn * (i % 2)) * scale for i, part in enumerate(parts)]
        rows = torch.cat([torch.stack(places, 1), material(angles)], 1)
        lines = [",".join(f"{value:.12g}" for value in row) for row in rows.tolist()]
        file = tmp_path / f"paint-{unit}.csv"
        file.write_text("\n".join(["# measured", HEAD.replace("deg", unit), *lines]))
        return file

    return table


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_measurements_read_back_as_written(write: Callable[..., Path], angles: Tensor, unit: str) -> None:
    found, reflectance = read_measurements(write(unit))
    torch.testing.assert_close(found, angles, rtol=0, atol=1e-6)
    torch.testing.assert_close(reflectance, material(angles), rtol=1e-6, atol=1e-8)


def test_a_task_holds_each_measurement_once_and_its_picture(write: Callable[..., Path], angles: Tensor) -> None:
    file = write()
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines, *lines[2:102]]))  # a hundred measured twice
    task = gonio.read_task(file)
    assert task.name == "paint-deg"
    assert task.data["angles"].shape == (len(angles), 3)
    torch.testing.assert_close(task.data["reflectance"], material(task.data["angles"]), rtol=1e-4, atol=1e-5)
    assert torch.equal(task.data["angles"], gonio.read_task(file).data["angles"])
    first = task.data["angles"][: len(angles) // 2, 0]
    assert abs(float(first.mean() - angles[:, 0].mean())) < 0.05  # in random order
    assert set(task.data) == {"angles", "reflectance"}  # no picture: it would be interpolated


def test_columns_in_any_order_and_comments_and_more_columns(tmp_path: Path) -> None:
    text = "# made by hand\n b , g, r,theta_o_deg,phi_o_deg,theta_i_deg,phi_i_deg,temperature\n\n# no row\n"
    (tmp_path / "a.csv").write_text(text + "0.3,0.2,0.1,20,180,40,0,\n")
    angles, reflectance = read_measurements(tmp_path / "a.csv")
    torch.testing.assert_close(reflectance, torch.tensor([[0.1, 0.2, 0.3]], dtype=torch.float64))
    assert angles[0].tolist() == pytest.approx([math.radians(10), math.radians(30), 0], abs=1e-9)


DIALECTS: dict[str, Callable[[str], str]] = {
    "semicolons and decimal commas": lambda text: text.replace(",", ";").replace(".", ","),
    "tabs and decimal commas": lambda text: text.replace(",", "\t").replace(".", ","),
    "quotes": lambda text: re.sub(r"[^,\n]+", r'"\g<0>"', text),
    "quotes and decimal commas": lambda text: re.sub(r"[^,\n]+", r'"\g<0>"', text).replace(".", ","),
    "a separator that is told": lambda text: "sep=;\n" + text.replace(",", ";"),
    "bars and lines of Windows": lambda text: text.replace(",", "|").replace("\n", "\r\n"),
    "a row of units": lambda text: text.replace("_deg", "").replace(
        "\n", "\ndeg,[deg],degrees,(deg),1/sr,1/sr,1/sr\n", 1
    ),
    "units in brackets": lambda text: text.replace("_deg", " [deg]"),
    "rows without values": lambda text: text + "\n,,,,,,\n",
    "a negative theta": lambda text: text.replace("40,180", "-40,0").replace("-10.5,20", "10.5,-160"),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("dialect", DIALECTS)
def test_tables_as_spreadsheets_write_them(tmp_path: Path, dialect: str, encoding: str) -> None:
    text = f"{HEAD}\n30.25,0,40,180,0.125,0.25,0.5\n30,0,-10.5,20,0.1,1e-3,0.3"
    (tmp_path / "plain.csv").write_text(text)
    (tmp_path / "other.csv").write_text(DIALECTS[dialect](text), encoding, newline="")
    plain, other = (gonio.read_pairs(tmp_path / f"{name}.csv") for name in ("plain", "other"))
    assert len(plain.wi) == 2
    for expected, found in zip(plain, other, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)
    assert [source.facts["samples"] for source in gonio.find(tmp_path)[0]] == [2, 2]


def test_noise_below_zero_is_cut_with_one_warning(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("\n".join([HEAD, ROW, ROW.replace("0.2", "-1e-5").replace("30,180", "35,180")]))
    with pytest.warns(UserWarning, match=r"a\.csv: 1 of 6 values below 0, down to -1e-05 /sr, expected 0") as caught:
        (source,) = gonio.find(file)[0]
    with pytest.raises(ValueError, match="2 of 2, expected 4 or more"):
        gonio.read_task(file, source.content)
    assert source.content.reflectance[1].tolist() == [0.1, 0, 0.3]
    assert len(caught) == 1


@pytest.mark.parametrize("deviation", [4e-3, 0.02])
def test_noise_of_a_dark_reading_is_cut(tmp_path: Path, angles: Tensor, deviation: float) -> None:
    """Whatever its size, as long as it is small beside the largest value; the sample becomes an input of fits."""
    rng = torch.Generator().manual_seed(0)
    values = material(angles) - material(angles).min()
    values = values + deviation * torch.randn(values.shape, generator=rng, dtype=torch.float64)
    pairs = MeasuredPairs(*rusinkiewicz_to_directions(angles), values)
    gonio.write_pairs(tmp_path / "a.csv", pairs.wi[:0], pairs.wo[:0], pairs)
    count = f"{int((values < 0).sum()):,} of {values.numel():,} values below 0"
    for read in (
        lambda: gonio.read_task(tmp_path / "a.csv"),
        lambda: task_of_object(tuple(pairs), "paint"),
    ):
        with pytest.warns(UserWarning, match=count):
            assert read().data["reflectance"].min() == 0


@pytest.mark.parametrize(("mark", "facts"), [("-1", "-1"), ("-999", "-999"), ("-5.5", "noise down to")])
def test_marks_of_missing_values_are_no_noise(tmp_path: Path, mark: str, facts: str) -> None:
    rows = [ROW, ROW.replace("0.2", "20").replace("30,180", "35,180"), ROW.replace("0.2", mark)]
    (tmp_path / "a.csv").write_text("\n".join([HEAD, *rows]))
    with pytest.raises(ValueError, match=rf"line 4: g {mark}, .*leave out rows that were not measured") as caught:
        gonio.read_pairs(tmp_path / "a.csv")
    assert facts in str(caught.value)


def test_azimuths_beside_a_full_circle_are_those_at_0() -> None:
    """Measured at 0 and at 2 pi less a rounding error, it is one sample; single precision does not leave the circle."""
    angles = torch.tensor([[0.3, 0.4, 0.0, 0.0], [0.3, 0.4, math.tau - 1e-9, math.tau - 1e-9]], dtype=torch.float64)
    pairs = MeasuredPairs(*rusinkiewicz_to_directions(angles), torch.ones(2, 3, dtype=torch.float64))
    assert len(measured_pairs.merge_repeats(pairs)[0]) == 1
    tensors = brdf_task.angle_tensors(angles)
    assert all(float(values.double().max()) < math.tau for values in tensors.values())


def test_a_table_is_parsed_once(write: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    file = write()
    (source,), _ = gonio.find(file)
    expected = gonio.read_task(file).data
    monkeypatch.setattr(gonio, "read_pairs", lambda path: pytest.fail(f"{path} is parsed again"))
    found = gonio.read_task(source.path, source.content).data
    assert all(torch.equal(found[key], value) for key, value in expected.items())


def test_tables_of_a_large_folder_are_not_kept(write: Callable[..., Path]) -> None:
    (source,), _ = gonio.find(write(), max_kept_bytes=100)
    assert source.content is None
    assert source.facts["samples"] > 0


def test_a_damaged_table_has_no_facts(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("theta_i_deg,r\n1,x\n")
    (source,), _ = gonio.find(tmp_path)
    assert source.facts == {"damaged": True}


def test_fits_see_all_of_few_measurements(write: Callable[..., Path]) -> None:
    file = write()
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:22]))
    (source,), _ = gonio.find(file)
    assert source.facts["samples"] == 20
    angles = gonio.read_task(file).data["angles"]
    assert torch.equal(angles[:20], angles[20:])
    assert len(angles.unique(dim=0)) == 20


def test_filled_in_plans_are_read(tmp_path: Path, angles: Tensor) -> None:
    wi, wo = rusinkiewicz_to_directions(angles[:30])
    file = tmp_path / "plan.csv"
    nothing = torch.zeros(0, 3).double()
    gonio.write_pairs(file, wi, wo, MeasuredPairs(nothing, nothing, nothing))
    with pytest.raises(ValueError, match=r"line 4: r nan, expected .* fill in what a plan asks for"):
        gonio.read_pairs(file)
    colours = material(angles[:30])
    rows = [",".join(f"{value:.9g}" for value in row) for row in colours.tolist()]
    lines = file.read_text().splitlines()
    filled = [line.removesuffix(",,") + row for line, row in zip(lines[3:], rows, strict=True)]
    file.write_text("\n".join([*lines[:3], *filled]))
    pairs = gonio.read_pairs(file)
    torch.testing.assert_close(pairs.wi, wi, rtol=0, atol=2e-4)  # a hundredth of a degree
    torch.testing.assert_close(pairs.wo, wo, rtol=0, atol=2e-4)
    torch.testing.assert_close(pairs.reflectance, colours, rtol=1e-6, atol=1e-8)
    gonio.write_pairs(tmp_path / "more.csv", wi[:2], wo[:2], pairs)
    lines = (tmp_path / "more.csv").read_text().splitlines()
    assert len(lines) == 3 + 32
    assert sum(line.endswith(",,") for line in lines) == 2


def test_spectra_become_colours(tmp_path: Path) -> None:
    """White is white, steps of wavelength do not matter, and a long-wave reflector is red."""
    for step in (5, 10, 20):
        nanometres = np.arange(380.0, 741, step)
        matrix = spectrum_to_rgb_matrix(nanometres)
        np.testing.assert_allclose(matrix.sum(0), 1, atol=1e-12)
        red = 1 / (1 + np.exp(-(nanometres - 600) / 15))
        assert (red @ matrix) == pytest.approx([0.82, 0.06, 0.0], abs=0.08)
    names = ",".join(f"{wavelength}nm" for wavelength in range(400, 701, 100))
    (tmp_path / "a.csv").write_text(f"{HEAD[:-6]},{names}\n30,0,30,180,0.2,0.2,0.2,0.2\n")
    _, reflectance = read_measurements(tmp_path / "a.csv")
    torch.testing.assert_close(reflectance, torch.full((1, 3), 0.2, dtype=torch.float64))
    colour, nanometres = import_colour_science(), np.arange(360.0, 781, 5)
    values = 0.2 + 0.5 * np.exp(-(((nanometres - 530) / 60) ** 2))
    spectrum = colour.SpectralDistribution(dict(zip(nanometres, values, strict=True)))
    tables = (colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"], colour.SDS_ILLUMINANTS["D65"])
    xyz = colour.sd_to_XYZ(spectrum, *(table.copy().align(colour.SpectralShape(360, 780, 5)) for table in tables)) / 100
    expected = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB @ xyz
    np.testing.assert_allclose(values @ spectrum_to_rgb_matrix(nanometres), expected, atol=2e-3)


def test_a_file_that_is_too_large_says_how_many_rows_to_keep(tmp_path: Path) -> None:
    file = tmp_path / "large.csv"
    file.touch()
    os.truncate(file, 5 * gonio.MAX_TABLE_BYTES // 2)
    with pytest.raises(ValueError, match=r"large\.csv: 671,088,640 bytes, .* 6 million rows; keep one row in 3\.$"):
        gonio.read_pairs(file)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no rows"),
        (HEAD.replace("theta_i_deg", "theta_i") + "\n" + ROW, "theta_i: no unit, expected the column theta_i_deg or"),
        (HEAD.replace(",phi_o_deg", "") + "\n" + ROW[:-4], "phi_o: no such column"),
        (HEAD.replace(",b", "") + "\n" + ROW[:-4], "no column b, expected r, g, b, or wavelengths"),
        (HEAD + "\n" + ROW + ",7", "line 2: 8 numbers, expected 7"),
        (HEAD + "\n" + ROW.replace("0.2", "much"), "line 2: 'much', expected a number"),
        (HEAD + "\n# c\n" + ROW.replace("0.2", "-0.2"), "line 3: g -0.2, expected 0 to"),
        (HEAD + "\n" + ROW.replace("0.2", ""), "line 2: g nan"),
        (HEAD + "\n" + ROW.replace("30,180", "130,180"), "line 2: theta_o 130 deg, expected -90 to 90"),
        (HEAD.replace("deg", "rad") + "\n" + ROW, "line 2: theta_i 30 rad, expected -1.5708 to 1.5708"),
        (HEAD + ",r\n" + ROW + ",1", "two columns 'r'"),
        (HEAD + "\n" + ROW + "\n" + "1," * (2**19 + 1), "line 3: more than 1,048,576 characters, expected a row"),
        (HEAD + "\n" + "1" * 2**18, "line 2: 1 numbers, expected 7"),
        (HEAD[:-6] + ",500nm,600nm\n" + ROW[:-4], "2 wavelengths from 500 to 600 nm, expected 4"),
        (HEAD + "\n" + "\n".join([ROW] * 200), "different pairs of directions: 1 of 200, expected 4 or more"),
        (b"\xff\xfe\x00", "no text in UTF-8 or UTF-16"),
        ((HEAD + " \u00b0").encode("latin-1"), "save it as CSV in UTF-8"),
        ("30,0,30,180,.1,.1,.1\n" + ROW, "the first line holds numbers, such as '30', expected column names"),
        ("wi_x,wi_y,r,g,b\n1,0,1,1,1", "theta_i: no such column among 'wi_x', 'wi_y', 'r', 'g', 'b', expected"),
    ],
)
def test_files_that_are_no_goniometer_table_are_refused_in_one_line(
    tmp_path: Path, text: str | bytes, words: str
) -> None:
    file = tmp_path / "bad.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=words.replace("(", r"\(")) as caught:
        gonio.read_task(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


def test_metapp_fits_and_converts_tables(metapp: Callable, write: Callable[..., Path], tmp_path: Path) -> None:
    file = write()
    fitted = metapp("meta", "brdf", file, "--out", tmp_path / "runs", "--json", "--quiet")
    assert fitted.code == 0
    assert fitted.json_document["tasks"][0]["name"] == "paint-deg"
    assert fitted.json_document["error"] < 3
    assert metapp("data", "gonio", file, "--out", tmp_path / "set", "--split", "test").code == 0
    assert "no problems" in metapp("data", "check", tmp_path / "set").out
    again = metapp("meta", "brdf", "--recipe", "full", "--data", tmp_path / "set", "--out", tmp_path / "runs", "--json")
    assert again.json_document["error"] == pytest.approx(fitted.json_document["error"])


def test_repeated_measurements_are_averaged_whatever_their_number_and_order() -> None:
    """Against unique rows of torch, which sort in the same way but take ten times as long."""
    rng = torch.Generator().manual_seed(3)
    angles = torch.rand(500, 4, generator=rng, dtype=torch.float64) * 3 - 1
    rows = torch.randint(500, (2000,), generator=rng)
    values = torch.rand(2000, 3, generator=rng, dtype=torch.float64)
    for columns in (3, 4):
        distinct, means = measured_pairs._average_duplicates(angles[rows, :columns], values)
        expected, inverse = torch.unique((angles[rows, :columns] * 1e5).round(), dim=0, return_inverse=True)
        torch.testing.assert_close((distinct * 1e5).round(), expected)
        torch.testing.assert_close(means[7], values[inverse == 7].mean(0))


@pytest.mark.parametrize("spread", [0.05, 0.6])
def test_repeats_that_contradict_each_other_are_said(spread: float, recwarn: pytest.WarningsRecorder) -> None:
    rng = torch.Generator().manual_seed(3)
    wi, wo = (torch.nn.functional.normalize(torch.rand(50, 3, generator=rng).double() + 0.1, dim=1) for _ in range(2))
    values = (1 + spread * torch.randn(200, 1, generator=rng).double()).abs().expand(-1, 3)
    pairs = measured_pairs.MeasuredPairs(wi.repeat(4, 1), wo.repeat(4, 1), values)
    measured_pairs.task_of_pairs("paint", pairs)
    lines = [str(warning.message) for warning in recwarn]
    assert [line.startswith("paint: repeated measurements differ by") for line in lines] == [True] * (spread > 0.2)


def test_pairs_below_the_surface_are_counted(recwarn: pytest.WarningsRecorder) -> None:
    wi = torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]).double()
    pairs = measured_pairs.MeasuredPairs(wi, wi, torch.ones(2, 3).double())
    assert len(pairs.above("paint").wi) == 2
    assert not recwarn
    assert len(pairs._replace(wo=wi * torch.tensor([[1.0, 1, 1], [1, 1, -1]])).above("paint").wi) == 1
    assert str(recwarn[0].message).startswith("paint: 1 of 2 pairs of directions are left out: light or detector is")


def test_a_material_of_samples_alone_is_shown_as_samples(metapp: Callable, tmp_path: Path) -> None:
    """No reference sphere, and no differences from one, in pictures, comparisons and pages."""
    (file,) = write_example("brdf", tmp_path)
    runs = [metapp(paradigm, "brdf", file, "--json").json_result["out"] for paradigm in ("meta", "quickft")]
    fit = api.fit("brdf", file)
    pictures = fit.preview()
    assert list(pictures) == ["samples", "predicted", "fit"]
    for name in ("samples", "predicted"):
        coverage = pictures[name][..., 3]
        assert set(coverage.unique().tolist()) == {0.0, 1.0}
        assert torch.equal(coverage, pictures["samples"][..., 3])
    samples, predicted = (pictures[name][..., :3].log1p() for name in ("samples", "predicted"))
    assert float((samples - predicted).abs().mean()) < 0.05 * float(samples.mean())
    compared = metapp("compare", *runs, "--json").json_result
    assert all(run["measures"] == {} for run in compared["runs"])
    assert compared["picture"]
    view = registry().pages["reflectance"].load()(fit)
    assert "residual" not in view.arrays
    assert "samples" in view.arrays
