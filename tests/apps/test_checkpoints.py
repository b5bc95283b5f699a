"""The checkpoints that ship: they load, belong together, are small, and fit tasks that they have not seen."""

from __future__ import annotations

import functools
import importlib
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from torch import Generator, Tensor

from data_tools.readers.brdf_task import brdf_task
from data_tools.synthetic.brdf import synthetic_materials
from metapp.apps import app_names, app_of, protocols_of, recipes_of
from metapp.learning.app import App, stack
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms import Job, paradigms
from metapp.runs.checkpoints.finding import checkpoint_name
from metapp.runs.checkpoints.shipped import FULL, QUICK, shipped_path, ships
from metapp.storage.records import load_checkpoint, tensor_digest
from tests.marked import long
from tests.quick import app_by
from tests.small_spheres import shrink_spheres

PACKAGE = shipped_path("brdf", "general").parent.parent
FULL_ONES = [name for name in app_names() if (PACKAGE / name / FULL).is_dir()]
FEATURES = {"texture": "VGG-16 features (ImageNet)", "svbrdf_stationary": "VGG-16 features (ImageNet)"}
OBSERVED = ("illumination", "svbrdf_nonstationary")


def files_of(name: str, recipe: str) -> dict[str, Path]:
    """What ships for a recipe, by the file's name without suffix."""
    folder = PACKAGE / name / (recipe if recipe == FULL else "")
    return {path.stem: path for path in sorted(folder.glob("*.safetensors"))}


def start_of(name: str, each: str, recipe: str = QUICK) -> MetaParameters:
    return load_checkpoint(shipped_path(name, each, recipe))[0]


@functools.cache
def tasks_of(name: str, count: int) -> list[Task]:
    """Unseen tasks of an application, the same for all protocols."""
    return list(importlib.import_module(f"data_tools.synthetic.{name}").synthetic_tasks("test", count))


def fitted(
    app: App, start: MetaParameters, tasks: Tasks, paradigm: str, *, recipe: str = QUICK, rule: str = ""
) -> Params:
    """What a paradigm makes of tasks by a checkpoint."""
    of = recipes_of(app.name, app.protocol)[recipe]
    return paradigms()[paradigm].fit(Job(app, of, rule or of.rule), start, tasks, Generator().manual_seed(0))


# What they are


def expected_of(name: str, recipe: str) -> set[str]:
    """What must ship: General, an Adam and rules; of "full", where rules go to a finer grid, Adams alone.

    There, a protocol with a network of its own has its own General and rule.
    """
    if recipe == FULL and protocols_of(name):
        names = set()
        for protocol in protocols_of(name):
            app, rule = app_by(name, FULL, protocol), recipes_of(name, protocol)[FULL].rule
            own = checkpoint_name(app, "general") != "general"
            names |= {checkpoint_name(app, each) for each in ("quickft", *(("general", rule) if own else ()))}
        return names
    names = {"general"}
    for protocol in protocols_of(name) or ("",):
        app, of = app_by(name, recipe, protocol), recipes_of(name, protocol)[recipe]
        rules = of.meta if name == "brdf" else (of.rule,)
        names |= {checkpoint_name(app, each) for each in ("quickft", *rules)}
    return names


@pytest.mark.parametrize(
    ("name", "recipe"), [*((name, QUICK) for name in app_names()), *((name, FULL) for name in FULL_ONES)]
)
def test_they_say_what_they_are(name: str, recipe: str) -> None:
    files = files_of(name, recipe)
    assert set(files) == expected_of(name, recipe)
    for stem, path in files.items():
        own = "-photo" if stem.endswith("-photo") and "general-photo" in files else ""
        encoder = tensor_digest(start_of(name, f"general{own}", recipe).encoder)
        _, info = load_checkpoint(path)
        assert (info["app"], info["checkpoint"], info["recipe"]) == (name, stem.removesuffix("-photo"), recipe), stem
        assert info.get("features") == FEATURES.get(name), stem
        assert info["validation_error"] > 0 or name == "transport", stem
        if recipe == QUICK and name != "brdf":
            assert info["data"].startswith(name), stem  # the embedded set alone
        if stem.startswith("general"):
            continue
        if name in OBSERVED:
            assert info["observe"] == ("photo" if stem.endswith("-photo") else "reference"), stem
        rule = recipes_of(name)[recipe].meta.get(stem)
        # this one holds an encoder of its own, which went on from General before General did
        if (rule is None or rule.from_general) and (name, stem) != ("svbrdf_nonstationary", "meta-lgd"):
            assert info["encoder"] == encoder, stem


def test_they_are_small() -> None:
    for name in app_names():
        for path in files_of(name, QUICK).values():
            assert path.stat().st_size < {"brdf": 2e6, "transport": 2e6, "svbrdf_nonstationary": 5e6}.get(name, 4e6)
    assert sum(path.stat().st_size for path in PACKAGE.rglob("*.safetensors")) < 25e6


def test_recipes_of_another_size_ship_only_where_they_have_a_folder() -> None:
    for name in app_names():
        recipes = recipes_of(name)
        if FULL in recipes:
            same = recipes[FULL].app == recipes[QUICK].app
            assert ships(name, FULL) == (same or name in FULL_ONES)
    assert FULL_ONES == ["illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture"]


# What they fit


@pytest.fixture(scope="module")
def unseen() -> Tasks:
    materials = synthetic_materials("test")[:8]
    with pytest.MonkeyPatch.context() as patch:
        shrink_spheres(patch)
        return stack(app_by("brdf"), [brdf_task(each.name, each.evaluate, samples=8192) for each in materials])


@pytest.mark.long
def test_ten_steps_of_the_default_rule_beat_the_other_quick_ways_on_unseen_materials(unseen: Tasks) -> None:
    recipe = recipes_of("brdf")[QUICK]
    general = start_of("brdf", "general")

    def error_of(paradigm: str, start: MetaParameters, rule: str = recipe.rule) -> float:
        app = app_of("brdf", recipe, rule=rule if paradigm == "meta" else "")
        theta = fitted(app, start, unseen, paradigm, rule=rule)
        return app.scale * float(app.errors(theta, unseen)["error"].mean())

    meta = error_of("meta", start_of("brdf", recipe.rule))
    assert meta < 0.8
    assert meta < error_of("quickft", general._replace(alpha=start_of("brdf", "quickft").alpha))
    assert meta < error_of("general", general)
    assert error_of("meta", start_of("brdf", "ridge"), "ridge") < 0.2 * meta


def errors_of_pictures(name: str, count: int, paradigm: str, recipe: str = QUICK) -> tuple[Tensor, Tensor]:
    """Errors [T] of unseen pictures at General's prediction, and after a paradigm's steps, both by what ships."""
    app, rule = app_by(name, recipe), recipes_of(name)[recipe].rule
    tasks = stack(app, [task._replace(data={"image": task.data["image"]}) for task in tasks_of(name, count)])
    general = start_of(name, "general", recipe)
    by = start_of(name, rule if paradigm == "meta" else paradigm, recipe)
    starts = {"general": general, paradigm: by if paradigm == "meta" else general._replace(alpha=by.alpha)}
    before, after = (
        app.errors(fitted(app, start, tasks, each, recipe=recipe), tasks)["error"] for each, start in starts.items()
    )
    return before, after


@pytest.mark.usefixtures("vgg")
@pytest.mark.parametrize(
    ("name", "count", "paradigm", "recipe", "share"),
    [
        long("texture", 4, "meta", QUICK, 0.8),
        # errors of these fall less: fewer than eight pictures say too little about the share
        *(pytest.param("svbrdf_stationary", 8, by, QUICK, 0.8, marks=pytest.mark.slow) for by in ("quickft", "meta")),
        pytest.param("texture", 4, "quickft", QUICK, 0.8, marks=pytest.mark.slow),
        pytest.param("texture", 4, "meta", FULL, 0.85, marks=pytest.mark.slow),
        pytest.param("svbrdf_stationary", 4, "meta", FULL, 0.9, marks=pytest.mark.slow),
    ],
)
def test_few_steps_beat_none_on_unseen_pictures(
    name: str, count: int, paradigm: str, recipe: str, share: float
) -> None:
    general, fits = errors_of_pictures(name, count, paradigm, recipe)
    assert fits.mean() < share * general.mean()


@pytest.mark.long
@pytest.mark.usefixtures("scene")
@pytest.mark.parametrize("protocol", ["reference", long("photo")])
@pytest.mark.parametrize("name", ["illumination", long("svbrdf_nonstationary")])
def test_few_steps_beat_none_on_unseen_tasks(name: str, protocol: str) -> None:
    app, rule = app_by(name, protocol=protocol), recipes_of(name, protocol)[QUICK].rule
    tasks, errors, losses = stack(app, tasks_of(name, 16)), {}, {}
    for paradigm, start in (("general", "general"), ("meta", checkpoint_name(app, rule))):
        theta = fitted(app, start_of(name, start), tasks, paradigm)
        errors[paradigm] = float(app.errors(theta, tasks)["error"].mean())
        losses[paradigm] = float(app.loss(theta, app.sample(tasks, Generator(), 1), {}).mean())
    if protocol == "reference":
        assert errors["meta"] < 0.25 * errors["general"]
    else:  # a photograph that is explained better need not mean better maps on so few of them
        assert losses["meta"] < 0.9 * losses["general"]
        assert errors["meta"] < 1.2 * errors["general"]


@pytest.mark.long
def test_few_steps_beat_none_on_unseen_scenes() -> None:
    app = app_by("transport")
    tasks = stack(app, tasks_of("transport", 2))
    rule = recipes_of("transport")[QUICK].rule
    before, after = (
        app.errors(fitted(app, start_of("transport", start), tasks, paradigm), tasks)
        for paradigm, start in (("general", "general"), ("meta", rule))
    )
    for part in ("error", "film", "directions"):
        assert (after[part] < before[part]).all(), part
    assert after["error"].mean() < before["error"].mean() - 0.08


# What commands find


@pytest.mark.usefixtures("small_spheres")
def test_the_command_finds_them(metapp: Callable, tmp_path: Path) -> None:
    data = tmp_path / "few"
    assert metapp("data", "synth", "brdf", "--count", "5", "--out", data).code == 0
    result = metapp("meta", "brdf", "--data", data, "--out", tmp_path, "--json")
    assert "the checkpoint that ships, trained on other data" in result.err
    assert result.document["error"] < 2
    trained = tmp_path / "brdf/checkpoints" / f"{result.document['data']}-quick-seed0/meta-curvature.safetensors"
    trained.parent.mkdir(parents=True)
    shutil.copy(shipped_path("brdf", "meta-curvature"), trained)
    again = ("meta", "brdf", "--data", data, "--out", tmp_path, "--recipe", "quick")
    assert "the checkpoint that ships" in metapp(*again).err
    assert f"from {trained}" in metapp(*again, "--checkpoint", trained).err
