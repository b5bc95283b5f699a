"""The checkpoints that ship: they load, belong together, and fit tasks that they have not seen."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from torch import Generator, Tensor

from data_tools.readers.brdf_task import brdf_task
from data_tools.synthetic.brdf import synthetic_materials
from metapp.apps import app_of, recipes_of
from metapp.apps.brdf import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.learning.app import App, stack
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.learning.task import Task, Tasks
from metapp.paradigms import Job, paradigms
from metapp.runs.checkpoints import checkpoint_name
from metapp.runs.shipped import shipped_path
from metapp.storage.records import load_checkpoint, tensor_digest
from tests.quick import app_by
from tests.small_spheres import shrink_spheres

APP = Brdf()

SHIPPED = sorted(shipped_path("brdf", "general").parent.glob("*.safetensors"))


@pytest.fixture(scope="module")
def unseen() -> Tasks:
    materials = synthetic_materials("test")[:8]
    with pytest.MonkeyPatch.context() as patch:
        shrink_spheres(patch)
        return stack(APP, [brdf_task(each.name, each.evaluate, samples=8192) for each in materials])


def error_of(paradigm: str, rule: str, prepared: MetaParameters, tasks: Tasks) -> float:
    recipe = RECIPES[""]["quick"]
    app = app_of("brdf", recipe, rule=rule if paradigm == "meta" else "")
    theta = paradigms()[paradigm].fit(Job(app, recipe, rule), prepared, tasks, Generator().manual_seed(0))
    return app.traits.scale * float(app.errors(theta, tasks)["error"].mean())


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_says_what_it_is(path: Path) -> None:
    _, info = load_checkpoint(path)
    assert (info["app"], info["start"]) == ("brdf", path.stem)
    assert info["validation_error"] > 0
    assert path.stat().st_size < 2e6
    quick = RECIPES[""]["quick"]
    if path.stem == "quickft" or (path.stem in quick.meta and quick.meta[path.stem].from_general):
        encoder, _ = load_checkpoint(shipped_path("brdf", "general"))
        assert info["encoder"] == tensor_digest(encoder.encoder)


def test_every_rule_of_the_quick_recipe_ships() -> None:
    assert {path.stem for path in SHIPPED} == {"general", "quickft", *RECIPES[""]["quick"].meta}


def test_ten_steps_of_the_default_rule_beat_the_other_quick_ways_on_unseen_materials(unseen: Tasks) -> None:
    starts = {path.stem: load_checkpoint(path)[0] for path in SHIPPED}
    tuned = starts["general"]._replace(alpha=starts["quickft"].alpha)
    rule = RECIPES[""]["quick"].rule
    meta = error_of("meta", rule, starts[rule], unseen)
    assert meta < 0.8
    assert meta < error_of("quickft", rule, tuned, unseen)
    assert meta < error_of("general", rule, starts["general"], unseen)
    assert error_of("meta", "ridge", starts["ridge"], unseen) < 0.2 * meta


@pytest.mark.usefixtures("small_spheres")
def test_the_command_finds_them(metapp: Callable, tmp_path: Path) -> None:
    data = tmp_path / "few"
    assert metapp("data", "synth", "brdf", "--count", "5", "--out", data).code == 0
    result = metapp("meta", "brdf", "--data", data, "--out", tmp_path, "--json")
    assert "the checkpoint that ships, trained on other data" in result.err
    assert result.document["error"] < 2


# Textures and svBRDFs

PICTURES = ("texture", "svbrdf_stationary")


@pytest.mark.parametrize("name", PICTURES)
def test_starts_of_pictures_say_what_they_are(name: str) -> None:
    files = sorted(shipped_path(name, "general").parent.glob("*.safetensors"))
    recipe = recipes_of(name)["quick"]
    assert {path.stem for path in files} == {"general", "quickft", recipe.rule}
    encoder = tensor_digest(load_checkpoint(shipped_path(name, "general"))[0].encoder)
    for path in files:
        _, info = load_checkpoint(path)
        assert (info["app"], info["start"], info["recipe"]) == (name, path.stem, "quick")
        assert info["features"] == "VGG-16 features (ImageNet)"
        assert info["data"].startswith(name)  # the embedded set alone
        assert path.stem == "general" or info["encoder"] == encoder
        assert path.stat().st_size < 4e6


def errors_of_pictures(name: str, count: int, paradigm: str) -> tuple[Tensor, Tensor]:
    """Errors [T] of unseen pictures at General's prediction, and after a paradigm's steps, both by what ships."""
    app = app_by(name)
    module = importlib.import_module(f"data_tools.synthetic.{name}")
    tasks = stack(
        app, [task._replace(data={"image": task.data["image"]}) for task in module.synthetic_tasks("test", count)]
    )
    recipe = recipes_of(app.name)["quick"]
    job = Job(app, recipe, recipe.rule)
    starts = {each: load_checkpoint(shipped_path(name, each))[0] for each in ("general", "quickft", recipe.rule)}
    starts["quickft"] = starts["general"]._replace(alpha=starts["quickft"].alpha)

    def errors(each: str, start: str) -> Tensor:
        theta = paradigms()[each].fit(job, starts[start], tasks, Generator().manual_seed(0))
        return app.errors(theta, tasks)["error"]

    return errors("general", "general"), errors(paradigm, recipe.rule if paradigm == "meta" else paradigm)


@pytest.mark.usefixtures("vgg")
@pytest.mark.parametrize(
    ("name", "count", "paradigm"),
    [
        ("texture", 4, "meta"),
        # errors of these fall less: fewer than eight pictures say too little about the share
        *(pytest.param("svbrdf_stationary", 8, each, marks=pytest.mark.slow) for each in ("quickft", "meta")),
        pytest.param("texture", 4, "quickft", marks=pytest.mark.slow),
    ],
)
def test_few_steps_beat_none_on_unseen_pictures(name: str, count: int, paradigm: str) -> None:
    general, fitted = errors_of_pictures(name, count, paradigm)
    assert fitted.mean() < 0.8 * general.mean()


@pytest.mark.usefixtures("vgg")
def test_few_steps_beat_none_on_each_of_two_stationary_materials() -> None:
    general, fitted = errors_of_pictures("svbrdf_stationary", 2, "meta")
    assert (fitted < general).all()


@pytest.mark.usefixtures("vgg")
@pytest.mark.parametrize("name", ["texture", pytest.param("svbrdf_stationary", marks=pytest.mark.slow)])
def test_a_photo_is_fitted_in_seconds_by_what_ships(name: str, metapp: Callable, tmp_path: Path) -> None:
    module = importlib.import_module(f"data_tools.synthetic.{name}")
    (task,) = module.synthetic_tasks("test", 1)
    photo = np.ascontiguousarray(task.data["image"].permute(1, 2, 0).numpy())
    oiio.ImageBuf(photo).write(str(tmp_path / "wall.png"))
    small = ("--size", "64x64")  # of the files; the fit has the size of the recipe
    result = metapp("meta", name, tmp_path / "wall.png", *small, "--out", tmp_path / "runs", "--json")
    assert result.code == 0, result.err
    assert "the checkpoint that ships" in result.err
    assert result.document["error"] < 0.5


# What can be fitted to the thing itself, or to a photograph of it alone

OBSERVED = ("illumination", "svbrdf_nonstationary")
PROTOCOLS = ("reference", "photo")


@functools.cache
def tasks_of(name: str) -> list[Task]:
    """Unseen tasks of an application, the same for all protocols."""
    return list(importlib.import_module(f"data_tools.synthetic.{name}").synthetic_tasks("test", 16))


def recipe_of(name: str, protocol: str) -> tuple[App, Recipe]:
    return app_by(name, protocol=protocol), recipes_of(name, protocol)["quick"]


@pytest.mark.parametrize("name", OBSERVED)
def test_starts_by_protocol_say_what_they_are(name: str) -> None:
    files = sorted(shipped_path(name, "general").parent.glob("*.safetensors"))
    expected = {"general"}
    for protocol in PROTOCOLS:
        app, recipe = recipe_of(name, protocol)
        expected |= {checkpoint_name(app, "quickft"), checkpoint_name(app, recipe.rule)}
    assert {path.stem for path in files} == expected
    encoder = tensor_digest(load_checkpoint(shipped_path(name, "general"))[0].encoder)
    for path in files:
        _, info = load_checkpoint(path)
        assert info["app"] == name
        assert info["data"].startswith(name)  # the embedded set alone
        if path.stem != "general":
            # this one holds an encoder of its own, which went on from General before General did
            assert info["encoder"] == encoder or (name, path.stem) == ("svbrdf_nonstationary", "meta-lgd")
            assert info["observe"] == ("photo" if path.stem.endswith("-photo") else "reference")
        assert path.stat().st_size < 5e6


@pytest.mark.usefixtures("scene")
@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", OBSERVED)
def test_few_steps_beat_none_on_unseen_tasks(name: str, protocol: str) -> None:
    app, recipe = recipe_of(name, protocol)
    tasks = stack(app, tasks_of(name))
    job = Job(app, recipe, recipe.rule)
    errors, losses = {}, {}
    for paradigm, start in (("general", "general"), ("meta", checkpoint_name(app, recipe.rule))):
        prepared = load_checkpoint(shipped_path(name, start))[0]
        theta = paradigms()[paradigm].fit(job, prepared, tasks, Generator().manual_seed(0))
        errors[paradigm] = float(app.errors(theta, tasks)["error"].mean())
        losses[paradigm] = float(app.loss(theta, app.sample(tasks, Generator(), 1), {}).mean())
    if protocol == "reference":
        assert errors["meta"] < 0.25 * errors["general"]
    else:  # a photograph that is explained better need not mean better maps on so few of them
        assert losses["meta"] < 0.9 * losses["general"]
        assert errors["meta"] < 1.2 * errors["general"]


@pytest.mark.usefixtures("scene")
def test_a_ball_is_fitted_at_once_by_what_ships(metapp: Callable, tmp_path: Path) -> None:
    task = tasks_of("illumination")[0]
    photo = np.ascontiguousarray(task.data["photos"][0].permute(1, 2, 0).numpy())
    oiio.ImageBuf(photo).write(str(tmp_path / "ball.png"))
    result = metapp(
        "meta", "illumination", tmp_path / "ball.png", "--observe", "photo", "--out", tmp_path / "runs", "--json"
    )
    assert result.code == 0, result.err
    assert "the checkpoint that ships" in result.err
    made = Path(result.document["out"]) / "outputs" / "ball"
    assert {path.name for path in made.iterdir()} == {"map.exr", "map.png", "relit.png"}


def test_a_flash_photo_is_fitted_at_once_by_what_ships(metapp: Callable, tmp_path: Path) -> None:
    task = tasks_of("svbrdf_nonstationary")[0]
    photo = np.ascontiguousarray(task.data["photo"].permute(1, 2, 0).numpy())
    oiio.ImageBuf(photo).write(str(tmp_path / "wall.png"))
    common = ("--observe", "photo", "--out", tmp_path / "runs", "--json")
    result = metapp("meta", "svbrdf_nonstationary", tmp_path / "wall.png", *common)
    assert result.code == 0, result.err
    assert "the checkpoint that ships" in result.err
    made = Path(result.document["out"]) / "outputs" / "wall"
    assert {"normal.png", "diffuse.png", "roughness.png", "specular.png"} <= {path.name for path in made.iterdir()}


# Light transport


def test_starts_of_transport_say_what_they_are() -> None:
    recipe = recipes_of("transport")["quick"]
    files = sorted(shipped_path("transport", "general").parent.glob("*.safetensors"))
    assert {path.stem for path in files} == {"general", "quickft", recipe.rule}
    encoder = tensor_digest(load_checkpoint(shipped_path("transport", "general"))[0].encoder)
    for path in files:
        _, info = load_checkpoint(path)
        assert (info["app"], info["start"]) == ("transport", path.stem)
        assert info["data"].startswith("transport")  # the embedded set alone
        if path.stem != "general":
            assert info["encoder"] == encoder
        assert path.stat().st_size < 2e6


def test_few_steps_beat_none_on_unseen_scenes() -> None:
    app = app_by("transport")
    recipe = recipes_of(app.name)["quick"]
    module = importlib.import_module("data_tools.synthetic.transport")
    tasks = stack(app, list(module.synthetic_tasks("test", 2)))
    job, errors = Job(app, recipe, recipe.rule), {}
    for paradigm, start in (("general", "general"), ("meta", recipe.rule)):
        prepared = load_checkpoint(shipped_path("transport", start))[0]
        theta = paradigms()[paradigm].fit(job, prepared, tasks, Generator().manual_seed(0))
        errors[paradigm] = app.errors(theta, tasks)
    for part in ("error", "film", "directions"):
        assert (errors["meta"][part] < errors["general"][part]).all(), part
    assert errors["meta"]["error"].mean() < errors["general"]["error"].mean() - 0.08
