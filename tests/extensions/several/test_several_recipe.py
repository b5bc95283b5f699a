"""The recipe of several photos: its checkpoints, and what five photos are worth; and the core without it."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest
from torch import Generator

from data_tools.readers.flash_places import CAMERA
from data_tools.synthetic.svbrdf_nonstationary import synthetic_tasks
from metapp.apps import recipes_of
from metapp.extensions.several import checkpoints
from metapp.learning.app import stack
from metapp.learning.task import Task
from metapp.registry import WITHOUT
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.checkpoints.shipped import FULL, shipped_path
from metapp.runs.options import fit_options
from metapp.runs.plan import plan
from metapp.storage.records import load_checkpoint, tensor_digest
from tests.pictures import noise, write

APP = "svbrdf_nonstationary"


def test_those_of_several_photos_share_the_general_of_one() -> None:
    """Their own are two small files; all else that a recipe looks for is that of "full"."""
    folder = Path(str(resources.files(checkpoints))) / "several"
    assert {path.name for path in folder.glob("*.safetensors")} == {
        "quickft-photo.safetensors",
        "meta-encoder-photo.safetensors",
    }
    shared = shipped_path(APP, "general-photo", FULL)
    general = load_checkpoint(shared)[0].encoder
    for each in ("quickft-photo", "meta-encoder-photo"):
        path = shipped_path(APP, each, "several", "photo")
        prepared, info = load_checkpoint(path, general=shared)
        assert path.stat().st_size < 2e5
        assert (info["recipe"], info["observe"], info["encoder"]) == ("several", "photo", tensor_digest(general))
        assert info["inner_steps"] == recipes_of(APP, "photo")["several"].steps
        assert not prepared.encoder or tensor_digest(prepared.encoder) == tensor_digest(general)
    assert shipped_path(APP, "general-photo", "several", "photo") == shared


@pytest.mark.slow
def test_five_photos_say_more_than_one_by_default() -> None:
    """By what ships: one photo by the recipe that a user gets, five by that of folders with places."""
    tasks = list(synthetic_tasks("test", 3, size=256, photos=5))
    errors = {}
    for recipe, paradigm in (("full", "meta"), ("several", "meta"), ("several", "quickft"), ("several", "general")):
        by = find_checkpoint(plan(fit_options(APP, paradigm, observe="photo", recipe=recipe, quiet=True)))
        of = tasks if recipe == "several" else [Task(t.name, {k: t.data[k] for k in ("photo", "maps")}) for t in tasks]
        theta = [by.paradigm.fit(by.job, by.prepared, stack(by.app, [task]), Generator()) for task in of]
        found = [float(by.app.errors(each, stack(by.app, [t]))["error"]) for each, t in zip(theta, of, strict=True)]
        errors[recipe, paradigm] = sum(found) / len(found)
    assert errors["several", "quickft"] < 0.8 * errors["several", "general"]
    assert errors["several", "meta"] < 0.8 * errors["full", "meta"]


def test_without_the_extension_its_folders_are_refused_by_its_name(
    metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photo = write(tmp_path / "leaf" / "a.png", noise(48, 48))
    (tmp_path / "leaf" / CAMERA).write_text("0,0,16\n")
    monkeypatch.setenv(WITHOUT, "several")
    assert "the extension several reads it" in metapp("meta", APP, photo.parent, "--observe", "photo").refusal
    assert plan(fit_options(APP, "meta", (photo,), observe="photo")).options.recipe == "full"
