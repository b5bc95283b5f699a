"""`metapp ... illumination` and `metapp ... svbrdf_nonstationary` end to end, on references and on photographs."""

import re
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from data_tools.readers.environment_maps import read_map
from data_tools.readers.svbrdf_task import render_flash_photo
from metapp.appearance.colour import tone_map
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.latlong import mean_luminance, texel_directions
from metapp.appearance.photograph import photograph_spheres
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from metapp.apps.illumination import recipes as illumination_recipes
from metapp.apps.svbrdf_nonstationary import recipes as material_recipes
from metapp.apps.svbrdf_nonstationary.encoder import PhotoEncoder
from metapp.apps.svbrdf_nonstationary.field_maps import field_of
from metapp.cli.evaluation_options import EvaluateOptions
from metapp.cli.evaluation_output import evaluation_runs_of
from metapp.cli.fit_output import VISIBLE_TILT_DEGREES
from metapp.cli.progress import Terminal
from metapp.evaluation.tables.results import describe_gap
from metapp.networks.field import LocalField
from metapp.registry import registry
from metapp.runs.fitting import make_fitters
from metapp.runs.inputs.finding import find
from metapp.runs.keeping import fit_and_keep
from metapp.runs.reporter import Bar, use_reporter
from metapp.runs.resolve import resolve
from metapp.runs.spec import parse_fit_options
from metapp.runs.stored_fits import read_fits
from metapp.storage.checkpoint_files import read_entry, read_headers
from metapp.storage.fit_folders import PARAMS, RECORD
from tests.cli.messages import says
from tests.marked import long
from tests.pictures import write_planes
from tests.recipe_apps import app_by_recipe, exports_of

SVBRDF = "svbrdf_nonstationary"
RECIPES = {
    "illumination": (illumination_recipes.REFERENCE_RECIPES, illumination_recipes.PHOTO_RECIPES),
    SVBRDF: (material_recipes.REFERENCE_RECIPES, material_recipes.PHOTO_RECIPES),
}


class Inputs(NamedTuple):
    """What an application is given, and what it says and makes."""

    reference: Callable[[Path], Path]  # a file of an HDR map, or a strip
    photo: Callable[[Path], Path]  # of a sphere, or under a flash
    files: set[str]  # that a fit makes
    refusal: tuple[str, ...]  # facts in the line that refuses the photo where fits see references


def lamp() -> Tensor:
    """A map [3, 32, 64] of mean luminance 5 with one lamp."""
    light = 0.2 + (20 * (texel_directions(32, 64)[1] - 0.9)).exp() * torch.tensor([1.0, 0.8, 0.6])[:, None, None]
    return 5 * light / mean_luminance(light)


def ball(folder: Path) -> Path:
    (photo,) = photograph_spheres(lamp()[None], torch.Generator().manual_seed(0))
    return write_planes(folder / "photo.png", photo)


def material(size: int = 64) -> Tensor:
    coarse = torch.rand(1, 8, 4, 4, generator=torch.Generator().manual_seed(0))
    smooth = interpolate(coarse, (size, size), mode="bilinear")[0]
    return pack_maps(
        Maps(0.7 * smooth[1:4], 0.3 * smooth[4:7], 0.3 + 0.5 * smooth[7:], normal_from_height(4 * smooth[:1]))
    )


def flash(folder: Path) -> Path:
    return write_planes(folder / "photo.png", render_flash_photo(material(80)) / 255)


def strip(folder: Path) -> Path:
    maps = unpack_maps(material())
    photo = render_flash_photo(material()).float() / 255
    tiles = [photo, maps.normal / 2 + 0.5, maps.diffuse, maps.roughness.expand(3, -1, -1), maps.specular]
    return write_planes(folder / "reference.png", torch.cat(tiles, 2).clamp(0, 1))


MADE = {f"{name}.png" for name in ("normal", "diffuse", "roughness", "specular")}
MADE |= {f"lit_from_{side}.png" for side in ("left", "above", "aside")}
APPS = {
    "illumination": Inputs(
        lambda folder: write_planes(folder / "reference.exr", lamp(), "float"), ball,
        {"map.exr", "map.png", "relit.png"},
        ("photo: ", "HDR", ".exr", "--observe reference"),
    ),
    SVBRDF: Inputs(
        strip, flash, MADE,
        ("photo: ", "maps", "strip", "--observe reference"),
    ),
}  # fmt: skip


@pytest.fixture(params=APPS)
def app(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def small(second_scene: Path, shorten_recipes: Callable) -> None:
    """Other sizes and a few steps."""
    local = LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2)
    shorten_recipes(RECIPES["illumination"], local, local._replace(height=16, width=32))
    fields = (field_of(side, hidden=8)._replace(code=3) for side in (16, 24))
    shorten_recipes(RECIPES[SVBRDF], *fields, encoder=PhotoEncoder(2))


@pytest.fixture
def reference(app: str, small: None) -> Path:
    return APPS[app].reference(Path("in"))


@pytest.fixture
def photo(app: str, small: None) -> Path:
    return APPS[app].photo(Path("in"))


def luminance_of(path: Path) -> float:
    """Mean luminance of a map, of four times the rows: readers refuse maps of so few."""
    pixels = np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)).repeat(4, 0).repeat(4, 1)
    large = write_planes(path.with_name("large.exr"), torch.from_numpy(pixels).permute(2, 0, 1), "float")
    return float(mean_luminance(read_map(large, 8)))


def test_a_reference_is_fitted_and_written(app: str, metapp: Callable, reference: Path) -> None:
    document = metapp("overfit", app, reference, "--json").json_result
    assert (document["observe"], document["tasks"][0]["name"]) == ("reference", "reference")
    assert document["out"] == f"runs/{app}/overfit"  # of the full recipe, the usual one
    assert 0 < document["error"] < (100 if app == "illumination" else 2)
    output_folder = Path(document["out"]) / "reference"
    assert {path.name for path in output_folder.iterdir()} == APPS[app].files | {PARAMS, RECORD}
    if app == "illumination":
        assert luminance_of(output_folder / "map.exr") == pytest.approx(
            float(mean_luminance(read_map(reference, 8))), rel=0.5
        )
        pixels = torch.from_numpy(oiio.ImageBuf(str(output_folder / "map.exr")).get_pixels(oiio.FLOAT))
        shown = oiio.ImageBuf(str(output_folder / "map.png")).get_pixels(oiio.UINT8)
        assert np.abs(shown - 255 * tone_map(pixels / pixels.mean()).numpy()).max() <= 1
    else:
        specs = [oiio.ImageBuf(str(path)).spec() for path in output_folder.glob("*.png")]
        assert {(spec.width, spec.height) for spec in specs} == {(256, 256)}  # readers scale to it


@pytest.mark.parametrize("app", [long("illumination"), SVBRDF], indirect=True)
def test_a_photo_is_fitted_without_a_reference(app: str, metapp: Callable, photo: Path, reference: Path) -> None:
    """Alone, and in a folder with references."""
    fit = ("overfit", app, "--observe", "photo", "--json")
    document = metapp(*fit, photo).json_result
    assert (document["observe"], document["error"], document["tasks"][0]["error"]) == ("photo", None, None)
    assert 0 < document["photo_error"] == document["tasks"][0]["photo_error"] < 30
    assert document["out"].endswith("-photo")
    assert read_fits(Path(document["out"]))[0].spec.observe == "photo"
    output_folder = Path(document["out"]) / "photo"
    assert {path.name for path in output_folder.iterdir()} == APPS[app].files | {PARAMS, RECORD}
    assert Path(document["out"], "pictures.png").is_file()
    if app == "illumination":
        assert luminance_of(output_folder / "map.exr") == pytest.approx(1, rel=0.01)
    document = metapp(*fit, photo.parent).json_result
    errors = {task["name"]: task["error"] for task in document["tasks"]}
    assert errors["photo"] is None
    assert [task["name"] for task in document["tasks"] if "photo_error" in task] == ["photo"]
    assert document["error"] == pytest.approx(errors["reference"])


def test_each_input_has_the_protocol_that_it_holds(app: str, photo: Path, reference: Path) -> None:
    """What lies beside an input says nothing about it."""

    def chosen(*inputs: Path, **more: Any) -> list[str]:
        spec, _ = parse_fit_options(app, "general", recipe="quick", **more)
        specs, lines = resolve(spec, find(spec, inputs))
        assert lines == []
        return [spec.observe for spec in specs]

    assert chosen(photo) == ["photo"]
    assert chosen(reference) == ["reference"]
    assert chosen(reference, photo) == ["reference", "photo"]
    assert chosen(photo.parent) == ["photo", "reference"]
    assert chosen(photo, reference, observe="photo") == ["photo", "photo"]
    assert chosen(photo, observe="reference") == ["reference"]


def test_a_photo_is_refused_where_fits_see_references(app: str, metapp: Callable, photo: Path, reference: Path) -> None:
    """Alone, and among references, which are fitted."""
    result = metapp("overfit", app, photo, "--observe", "reference")
    assert says(result.error, *APPS[app].refusal)
    assert len(result.err.strip().splitlines()) <= 2
    assert not list(Path("runs").rglob(RECORD))
    both = metapp("overfit", app, reference, photo, "--quiet", "--observe", "reference")
    assert both.code == 1
    assert says(both.err, *APPS[app].refusal)


def test_data_sets_choose_the_protocol(on_data: Callable) -> None:
    result = on_data("overfit", "--steps", "1")
    assert says(result.err, "reference", "overfit")
    assert not says(result.err, "fits see")


# Materials alone


@pytest.fixture
def shot(small: None) -> Path:
    return flash(Path("in"))


def test_a_missing_library_is_named_before_anything_is_fitted(
    metapp: Callable, shot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    form = replace(exports_of(SVBRDF)["asset"], needs=("no_such_module", "no-such-package"))
    monkeypatch.setitem(registry().exports, ("surface", "asset"), form)
    misuse = metapp("overfit", SVBRDF, shot, "--export", "asset").misuse
    assert says(misuse, "--export asset", "no-such-package", 'pip install "metapp[export]"')
    assert not Path("runs").exists()


def test_cropping_is_reported_and_progress_shown(shot: Path, capsys: Any) -> None:
    """Cropping of the first inputs is reported; the bar names reading, fit, pictures and exports of each input."""
    for number in range(5):
        write_planes(shot.with_name(f"wide{number}.png"), torch.rand(3, 64, 96))
    shown: list[tuple[float, str]] = []

    class Shown(Terminal):
        def bar(self, title: str, total: int | None, done: int, long: bool) -> AbstractContextManager[Bar]:
            bar = Bar()
            bar.set_label = lambda note, share=0.0: shown.append((share, note))  # type: ignore[method-assign]
            return nullcontext(bar)

    with use_reporter(Shown()):
        spec, options = parse_fit_options(SVBRDF, "overfit", recipe="quick", steps=1, export="png16")
        inputs = find(spec, [shot.parent])
        fitters = make_fitters(resolve(spec, inputs)[0])
        assert len(list(fit_and_keep(fitters, inputs, Path("runs/overfit"), options))) == len(inputs)
    lines = capsys.readouterr().err.splitlines()
    notes = [line for line in lines if "px" in line][1:]
    for number, note in enumerate(notes):
        assert says(note, f"wide{number}.png", "96 x 64 px", "64 x 64 px", "256 x 256")
    assert len(notes) == 2  # then one line for all others
    assert sum("further inputs" in line for line in lines) == 1
    shares = {note.partition(": ")[2]: share for share, note in shown if note.startswith("wide1")}
    assert list(shares) == ["fitting", "pictures", "png16"]
    assert 0 < shares["fitting"] < shares["pictures"] < shares["png16"] < 1


def test_maps_have_the_size_asked_for(metapp: Callable, shot: Path) -> None:
    """Finer and coarser than the photo; first the rows."""
    for size, side in (("512x512", 512), ("32", 32)):
        result = metapp(
            "overfit", SVBRDF, shot, "--steps", "1", "--size", size, "--export", "png16", "--out", f"size-{side}"
        )
        assert f"; files of {side} rows, {side} columns" in result.err
        specs = [oiio.ImageBuf(str(path)).spec() for path in Path(f"size-{side}").rglob("*/photo/**/*.png")]
        assert len(specs) > 7
        assert {(spec.width, spec.height) for spec in specs} == {(side, side)}


def test_each_run_prints_the_mean_tilt_once(metapp: Callable, shot: Path) -> None:
    few = "metapp data rectify"  # what tells dents from bumps
    result = metapp("overfit", SVBRDF, shot, "--json")
    tilt = result.json_document["tasks"][0]["mean_tilt_degrees"]
    assert tilt > 0
    (line,) = re.findall("relief: .*", result.err)
    assert f"{tilt:.1f} degrees" in line
    assert (few in line) == (tilt >= VISIBLE_TILT_DEGREES)
    assert "relief" not in metapp("overfit", SVBRDF, shot, "--quiet").err
    shutil.copy(shot, shot.with_stem("other"))
    (line,) = re.findall("relief: .*", metapp("overfit", SVBRDF, shot.parent).err)
    assert re.search(r"\d\.\d degrees, median of 2, up to \d+\.\d", line)


def test_exported_slopes_are_scaled_by_the_relief_factor(metapp: Callable, shot: Path) -> None:
    """The factor is that of the export command, or else the fit's; errors are measured without it."""

    def normals(run: str, *words: str) -> np.ndarray:
        assert metapp("export", run, "exr", shot, "--out", "made", *words).code == 0
        (file,) = Path("made").rglob("*_normal_gl.exr")
        pixels: np.ndarray = 2 * oiio.ImageBuf(str(file)).get_pixels(oiio.FLOAT) - 1
        return pixels

    common = ("overfit", SVBRDF, shot, "--json")
    result = metapp(*common, "--relief", "2")
    one, two = metapp(*common).json_document, result.json_document
    assert says(result.err, f"{two['tasks'][0]['mean_tilt_degrees']:.1f} degrees", "--relief")
    same = ("name", "photo_error", "mean_tilt_degrees")
    assert [one["tasks"][0][key] for key in same] == [two["tasks"][0][key] for key in same]
    plain, twice = normals(one["out"]), normals(two["out"])
    np.testing.assert_array_equal(normals(one["out"], "--relief", "1"), plain)
    np.testing.assert_array_equal(normals(two["out"], "--relief", "1"), plain)
    np.testing.assert_array_equal(normals(one["out"], "--relief", "2"), twice)
    np.testing.assert_allclose(twice[..., :2] / twice[..., 2:], 2 * plain[..., :2] / plain[..., 2:], atol=1e-4)
    assert (normals(two["out"], "--relief", "0") == (0, 0, 1)).all()
    shown = oiio.ImageBuf(str(Path(two["out"], "photo", "normal.png"))).get_pixels(oiio.FLOAT)
    np.testing.assert_allclose(2 * shown - 1, twice, atol=1.01 / 255)
    for factor in ("-1", "nan"):
        assert says(metapp("export", one["out"], "exr", "--relief", factor).misuse, f"--relief {factor}", "0 to 10")


def test_exposure_option_scales_the_photo(metapp: Callable, shot: Path) -> None:
    common = ("overfit", SVBRDF, shot, "--steps", "1", "--json")
    fits = {stops: metapp(*common, "--stops", stops).json_document for stops in ("0", "-1")}
    assert fits["0"]["out"] != fits["-1"]["out"]  # read otherwise, the same files are other data
    runs = [read_fits(Path(fit["out"])) for fit in fits.values()]
    assert [run[0].app.observes for run in runs] == ["photo", "photo"]
    (one,), (other,) = runs
    assert not torch.equal(one.task.data["photo"], other.task.data["photo"])  # each is read again as it was read then


# What --observe picks is part of every figure and start, but of General, which all protocols share


STEPS = ("--train", "--train-steps", "2", "--quiet")


@pytest.fixture
def on_data(metapp: Callable, shorten_recipes: Callable) -> Callable:
    """A command on ten small materials, eight of them for training, with small networks and a few steps."""
    field = field_of(16, hidden=8)._replace(code=3)
    shorten_recipes(RECIPES[SVBRDF], field, field, encoder=PhotoEncoder(2))
    assert metapp("data", "synth", SVBRDF, "--count", "10", "--size", "32", "--out", "set", "--quiet").code == 0
    return lambda command, *more: metapp(command, SVBRDF, *more, "--recipe", "quick", "--data", "set")


def test_protocols_share_generals_checkpoint_alone(on_data: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    quick = material_recipes.PHOTO_RECIPES["quick"]
    monkeypatch.setitem(material_recipes.PHOTO_RECIPES, "quick", replace(quick, search=([{"rate": 0.5}],)))
    rule = material_recipes.PHOTO_RECIPES["quick"].rule
    for paradigm in ("meta", "quickft"):
        assert on_data(paradigm, "--observe", "photo", *STEPS).code == 0
    (path,) = Path("runs", SVBRDF, "checkpoints").iterdir()
    assert set(read_headers(path)) == {"general", f"{rule}-photo", "quickft-photo"}
    assert read_headers(path)[f"{rule}-photo"]["observe"] == "photo"
    assert "observe" not in read_headers(path)["general"]
    before = read_entry(path, "general")[0].encoder
    assert on_data("general", *STEPS).code == 0
    assert all(torch.equal(value, before[key]) for key, value in read_entry(path, "general")[0].encoder.items())
    refused = on_data("meta", "--rule", rule, "--checkpoint", path).error
    assert says(refused, str(path), "--observe photo", "reference")
    assert "no Adam" not in on_data("quickft", "--observe", "photo", "--checkpoint", path).err
    other = on_data("quickft", "--checkpoint", path).err
    assert f"metapp quickft {SVBRDF} --train --observe reference" in other


def test_observe_option_selects_protocols_in_evaluations() -> None:
    """The first protocol is the default, where fits see what the paper's do; the whole evaluation has all."""
    both = [(SVBRDF, "reference"), (SVBRDF, "photo")]
    for more, expected in (({"observe": "photo"}, both[1:]), ({}, both[:1]), ({"whole": True}, both)):
        subjects = evaluation_runs_of(EvaluateOptions(recipe="quick", no_run=True, **more), ["texture", SVBRDF])
        found = [(subject.app.name, subject.app.observes) for subject in subjects]
        assert found == [("texture", ""), *expected]


def test_meta_is_compared_with_general_where_overfit_sees_less() -> None:
    errors = {"general": 1.0, "overfit": 0.5, "quickft": 0.978, "meta": 0.88}
    rows = [
        {"paradigm": name, "error": error, "shared_error": error, "few": False, "seconds": 1.0}
        | {"rule": "meta-encoder", "paper_error": None, "paper_seconds": None}
        for name, error in errors.items()
    ]

    def evaluation_of(observes: str) -> Any:
        app = app_by_recipe(SVBRDF, observes=observes)
        return SimpleNamespace(app=app, observes_default=observes == "reference")

    assert "gap closed 0.24" in describe_gap(evaluation_of("reference"), rows)
    output = describe_gap(evaluation_of("photo"), rows)
    assert says(output, "12 % below General's", "10 % below QuickFT's", "Overfit")
    assert "gap" not in output
