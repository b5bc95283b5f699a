"""The checkpoints of recipes of another size that ship: what they say, that they are small, and that steps help."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
from torch import Generator

from data_tools.synthetic import svbrdf_stationary, texture
from metapp.apps import app_names, protocols_of, recipes_of
from metapp.learning.app import stack
from metapp.paradigms import Job, paradigms
from metapp.runs.shipped import FULL, shipped_path, ships
from metapp.storage.records import load_checkpoint, tensor_digest
from tests.quick import app_by

PACKAGE = shipped_path("brdf", "general").parent.parent
NAMES = [name for name in app_names() if (PACKAGE / name / FULL).is_dir()]


def folder(name: str) -> Path:
    return PACKAGE / name / FULL


def test_all_checkpoints_together_are_small() -> None:
    assert sum(path.stat().st_size for path in PACKAGE.rglob("*.safetensors")) < 25e6


def test_recipes_of_another_size_ship_only_where_they_have_a_folder() -> None:
    for name in app_names():
        recipes = recipes_of(name)
        if FULL in recipes:
            same = recipes[FULL].setup == recipes["quick"].setup
            assert ships(name, FULL) == (same or name in NAMES)
    assert NAMES == ["illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture"]


@pytest.mark.parametrize("name", NAMES)
def test_they_say_what_they_are(name: str) -> None:
    files, protocols = sorted(folder(name).glob("*.safetensors")), protocols_of(name)
    # with what "quick" learned on a coarser grid
    shared = {"quickft"} | {f"quickft-{each}" for each in protocols[1:]}
    own = {"general", "quickft", recipes_of(name)[FULL].rule}
    assert {path.stem for path in files} == (shared if protocols else own)
    encoder = tensor_digest(load_checkpoint(shipped_path(name, "general", FULL))[0].encoder)
    for path in files:
        _, info = load_checkpoint(path)
        assert (info["app"], info["start"], info["recipe"]) == (name, path.stem.split("-photo")[0], FULL)
        assert path.stem == "general" or info["encoder"] == encoder


@pytest.mark.usefixtures("vgg")
@pytest.mark.slow
@pytest.mark.parametrize(("synthetic", "least"), [(texture, 0.85), (svbrdf_stationary, 0.9)])
def test_few_steps_beat_none_on_unseen_tasks(synthetic: ModuleType, least: float) -> None:
    name = synthetic.__name__.rpartition(".")[2]
    app, recipe = app_by(name, FULL), recipes_of(name)[FULL]
    tasks = stack(app, list(synthetic.synthetic_tasks("test", 4)))
    starts = {each: load_checkpoint(shipped_path(name, each, FULL))[0] for each in ("general", recipe.rule)}
    errors = {}
    for paradigm, start in (("general", "general"), ("meta", recipe.rule)):
        theta = paradigms()[paradigm].fit(
            Job(app, recipe, recipe.rule), starts[start], tasks, Generator().manual_seed(0)
        )
        errors[paradigm] = float(app.errors(theta, tasks)["error"].mean())
    assert errors["meta"] < least * errors["general"]
