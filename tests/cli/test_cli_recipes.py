"""Every recipe: what a command fits by it is opened again by `load`, `view`, `compare`, `export` and `--resume`.

The cases are the registry's recipes, so that a recipe that is added later is tested, too.
"""

import importlib.util
import math
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache as cache_results
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch
from safetensors.torch import save_file

import metapp as api
from data_tools.readers import gonio
from data_tools.readers.square_photos import CAMERA_TEXT, LIGHT_TEXT, SIZE_TEXT
from data_tools.synthetic.examples import write_example
from metapp.appearance.features import IMAGENET_DIGESTS
from metapp.apps.transport import scene_renderer
from metapp.apps.transport.guide import make_guide_table
from metapp.apps.transport.recipes import RECIPES as TRANSPORT_RECIPES
from metapp.apps.transport.scene_renderer import renderer_of
from metapp.extensions.scene_files import scene_reader
from metapp.extensions.viewer.pages import transport as page
from metapp.learning.app import stack_tasks
from metapp.registry import registry
from metapp.runs.fitting import Fitter
from metapp.runs.resolve import complete
from metapp.runs.spec import Spec
from metapp.runs.stored_fits import read_fits
from metapp.storage.fit_folders import PARAMS, read_params
from tests.anisotropic import measure_with_noise
from tests.appearance.test_features import random_weights
from tests.cli.messages import says
from tests.cli.test_cli_protocols import ball, flash, strip
from tests.kept_fits import resolve_inputs
from tests.marked import long
from tests.needs_mitsuba import skip_without_mitsuba
from tests.pictures import write_noise_map, write_noise_photo
from tests.recipe_apps import exports_of

NAMES = ("first", "second")  # of the two inputs of each fit
Writer = Callable[[Path, str], Path]  # a function that writes an input of a name into a folder


def table(count: int, *, anisotropic: bool = False) -> Writer:
    """Return a writer of goniometer tables of so many measurements."""

    def write(folder: Path, name: str) -> Path:
        pairs = measure_with_noise(count, anisotropic=anisotropic)
        gonio.write_pairs(folder / f"{name}.csv", pairs.wi[:0], pairs.wo[:0], pairs)
        return folder / f"{name}.csv"

    return write


def renamed(write: Callable[[Path], Path]) -> Writer:
    """Return a writer of inputs of any name, given a function whose files have one name."""

    def write_renamed(folder: Path, name: str) -> Path:
        path = write(folder / name)
        return path.rename(folder / f"{name}{path.suffix}")

    return write_renamed


def noise_photo(folder: Path, name: str) -> Path:
    return write_noise_photo(folder / f"{name}.png", NAMES.index(name))


def noise_map(folder: Path, name: str) -> Path:
    return write_noise_map(folder / f"{name}.exr", NAMES.index(name))


def placed_photos(folder: Path, name: str) -> Path:
    """A folder of photographs with places: of two photographs, or of three."""
    count = 2 + NAMES.index(name)
    for number in range(count):
        write_noise_photo(folder / name / f"{number}.png", number)
    places = "".join(f"{number},0,16\n" for number in range(count))
    for file_name, text in ((CAMERA_TEXT, places), (LIGHT_TEXT, places), (SIZE_TEXT, "8\n")):
        (folder / name / file_name).write_text(text)
    return folder / name


def lit_photos(folder: Path, name: str) -> Path:
    """A folder of photographs under four lamps, or under five, with a text of directions to them."""
    count = 4 + NAMES.index(name)
    for number in range(count):
        write_noise_photo(folder / name / f"{number}.png", number)
    rows = [f"{number}.png {math.cos(number)} {math.sin(number)} 1\n" for number in range(count)]
    (folder / name / "lamps.lp").write_text(f"{count}\n" + "".join(rows))
    return folder / name


# A recipe is fitted to the first of these inputs of its application that choose it, else to the first of its protocol.
INPUTS: dict[str, tuple[Writer, ...]] = {
    "brdf": (table(500), table(100), table(4000, anisotropic=True)),
    "texture": (noise_photo,),
    "svbrdf_stationary": (noise_photo,),
    "svbrdf_nonstationary": (renamed(strip), renamed(flash), placed_photos, lit_photos),
    "illumination": (noise_map, renamed(ball)),
    "transport": (renamed(lambda folder: write_example("transport", folder)[0]),),
}


class Case(NamedTuple):
    """A recipe of an application, and what its fits see."""

    app: str
    observes: str
    recipe: str

    def __str__(self) -> str:
        return "-".join(filter(None, self))


CASES = [
    Case(app, observes, name)
    for app, application in registry().applications.items()
    for observes in application.observations or ("",)
    for name in application.recipes_observing(observes)
]
QUICK_CASES = [Case(app, entry.default_observation, "quick") for app, entry in registry().applications.items()]


def mark(case: Case) -> Any:
    """Mark a case by its time: recipes of the paper, which no inputs choose, take up to minutes."""
    return pytest.param(case, marks=pytest.mark.slow) if case.recipe.startswith("paper") else long(case)


def ships_checkpoint(spec: Spec) -> bool:
    """Return whether a checkpoint ships by which a specification fits; one that does not belong to it raises."""
    try:
        Fitter.of(complete(spec))
    except ValueError as error:
        if "no checkpoint ships" not in str(error):
            raise
        return False
    return True


def command_of(case: Case, folder: Path) -> list[str | Path]:
    """Return the words of a command that fits two inputs by a recipe in two steps, without training.

    The recipe is named only where inputs cannot choose it.
    """
    entry = registry().applications[case.app].recipes_observing(case.observes)[case.recipe]
    paradigm = "meta" if "meta" in (entry.paradigms or ("meta",)) else entry.paradigms[0]
    choices = []
    for number, write in enumerate(INPUTS[case.app]):
        (folder / str(number)).mkdir(parents=True)
        inputs = [write(folder / str(number), name) for name in NAMES]
        specs, _ = resolve_inputs(case.app, *inputs, paradigm=paradigm)
        choices.append((specs, inputs))
    of_protocol = [
        ({spec.recipe for spec in specs}, inputs)
        for specs, inputs in choices
        if {spec.observe for spec in specs} == {case.observes}
    ]
    chosen = next((inputs for recipes, inputs in of_protocol if recipes == {case.recipe}), None)
    assert chosen or not entry.suits, f"INPUTS has no inputs of {entry.inputs}: add some that choose {case}"
    if chosen:
        return [paradigm, case.app, *chosen, "--steps", "2"]
    inputs = of_protocol[0][1]
    spec = Spec(app=case.app, paradigm=paradigm, recipe=case.recipe, observe=case.observes)
    paradigm = paradigm if ships_checkpoint(spec) else "overfit"
    return [paradigm, case.app, *inputs, "--recipe", case.recipe, "--steps", "2"]


@pytest.fixture(scope="session")
def vgg_double(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of random weights that states the origin of ImageNet's, which checkpoints of encoders expect."""
    path = tmp_path_factory.mktemp("vgg") / "vgg16.safetensors"
    save_file(random_weights(), path, {"sha256": IMAGENET_DIGESTS[0]})
    return path


@pytest.fixture
def _doubles(case: Case, cache: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Provide what fits of an application need, and have pictures take little time: small spheres, few light paths."""
    if case.app == "brdf":
        request.getfixturevalue("small_spheres")
    elif case.app == "illumination":
        request.getfixturevalue("second_scene")
    elif case.app == "transport":
        skip_without_mitsuba()
        for name, recipe in TRANSPORT_RECIPES.items():
            few = replace(recipe.app, spp=4, reference_spp=4, shown_spp=4, overview_spp=1)
            monkeypatch.setitem(TRANSPORT_RECIPES, name, replace(recipe, app=few))
        monkeypatch.setattr(scene_renderer, "make_guide_table", partial(make_guide_table, places=8, cells=8))
        monkeypatch.setattr(scene_renderer, "renderer_of", partial(renderer_of, size=16))
        effort = page.Effort(side_px=16, seconds=0.1, reference_seconds=0.1)
        monkeypatch.setattr(page, "make_scene_view", partial(page.make_scene_view, effort=effort))
        request.getfixturevalue("few_paths")
        monkeypatch.setattr(scene_reader, "read_task", cache_results(scene_reader.read_task))
    else:
        vgg_file = request.getfixturevalue("vgg_double")
        os.link(vgg_file, cache / vgg_file.name)


@pytest.fixture
def command(_doubles: None, case: Case, tmp_path: Path) -> list[str | Path]:
    return command_of(case, tmp_path / "inputs")


@pytest.fixture
def run(metapp: Callable, command: list[str | Path]) -> Path:
    """The folder of a run of two fits."""
    return Path(metapp(*command, "--json", "--quiet").json_result["out"])


@pytest.mark.parametrize("case", [case if case in QUICK_CASES else mark(case) for case in CASES], ids=str)
def test_fits_are_opened_again(case: Case, metapp: Callable, command: list[str | Path], run: Path) -> None:
    kept = read_fits(run)
    assert [fit.name for fit in kept] == list(NAMES)
    for record in kept:
        spec, fit = record.spec, api.load(record.folder)
        assert (spec.app, spec.observe, spec.recipe) == case
        assert fit == record
        stored = read_params(record.folder)
        assert all(torch.equal(fit.parameters[key], value) for key, value in stored.items())
        theta = {key: value[None] for key, value in fit.parameters.items()}
        errors = fit.app.errors(theta, stack_tasks(fit.app, [fit.task]))
        assert ("error" in errors) == (record.error is not None)
        if "error" in errors:
            assert float(errors["error"]) * fit.app.error_measure.scale == pytest.approx(record.error, rel=1e-3)
    assert metapp("view", run, "--out", "page.html", "--no-open").code == 0
    assert all(name in Path("page.html").read_text() for name in NAMES)
    other = shutil.copytree(run, run.with_name("other"))
    compared = metapp("compare", run, other, "--json").json_result
    assert [task["name"] for task in compared["tasks"]] == list(NAMES)
    assert Path(compared["picture"]).is_file()
    written = {path: path.stat().st_mtime_ns for path in run.glob(f"*/{PARAMS}")}
    again = metapp(*command, "--resume")
    assert again.code == 0, again.err
    assert says(again.err, "2 of 2 inputs", "skipped")
    assert {path: path.stat().st_mtime_ns for path in run.glob(f"*/{PARAMS}")} == written


@pytest.mark.parametrize("case", [mark(case) for case in CASES], ids=str)
def test_fits_are_exported(case: Case, metapp: Callable, run: Path) -> None:
    for kind, export in exports_of(case.app).items():
        if not export.needs or importlib.util.find_spec(export.needs[0]):
            result = metapp("export", run / NAMES[0], kind, "--json")
            if result.code:  # a form that cannot hold such a fit says in a line which forms can
                assert re.fullmatch(r"error: first: an? .*, expected .*; export \w+.*\.\n", result.err), kind
                continue
            assert result.json_result["tasks"] == [NAMES[0]], kind
            assert [*Path(result.json_result["out"]).iterdir()], kind
