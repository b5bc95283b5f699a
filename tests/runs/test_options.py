"""The options of fits: by which recipe they go where none is named, and what help shows of which application."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pytest
import torch
from torch import Generator
from typer.testing import CliRunner

from metapp.apps import app_names, app_of, protocols_of, recipes_of
from metapp.cli.commands import SUMMARIES
from metapp.cli.commands import app as cli
from metapp.cli.fits.options import OPTIONS
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs import BadOption
from metapp.runs.checkpoints.shipped import ships
from metapp.runs.requests.options import all_options, options_of
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request


@pytest.mark.parametrize("name", app_names())
def test_files_data_sets_and_trainings_go_by_the_best_recipe_that_ships(name: str) -> None:
    assert {"quick", "full", "paper"} <= set(recipes_of(name))
    assert ships(name, "full")
    for more in ({}, {"paradigm": "general"}, {"inputs": [Path("a")]}, {"data": Path("data")}, {"train": True}):
        assert plan(Request(name, **more)).request.recipe == "full", more
    assert plan(Request(name, recipe="quick")).request.recipe == "quick"


def test_every_field_of_a_request_but_objects_is_an_option() -> None:
    assert {field.name for field in fields(Request)} == OPTIONS.keys() | {"paradigm", "objects", "options"}


OWN = {"conserve", "observe", "export", "size", "detail", "render", "fov", "exposure", "exposures", "scene-root"}
SHOWN = {
    "": set(),
    "brdf": {"export", "conserve"},
    "texture": {"export", "size", "detail"},
    "svbrdf_stationary": {"export", "size", "detail", "fov"},
    "svbrdf_nonstationary": {"observe", "export", "fov", "exposure"},
    "illumination": {"observe", "size", "fov", "exposures"},
    "transport": {"render", "scene-root"},
}


@pytest.mark.parametrize("name", SHOWN)
def test_help_shows_the_options_of_the_application_alone(metapp: Callable, name: str) -> None:
    result = metapp("meta", *filter(None, [name]), "--help")
    assert result.code == 0
    options = set(re.findall(r"--([a-z-]+)", result.out))
    assert options & OWN == SHOWN[name]
    assert {"steps", "rule", "recipe", "batch"} <= options
    assert ("MERL" in result.out) == (name == "brdf")  # the inputs are those of the application, too


UNUSED = {
    "general": {"steps", "rule"},
    "overfit": {"rule", "checkpoint", "train", "train-steps"},
    "finetune": {"rule"},
    "quickft": {"rule"},
    "meta": set(),
}


@pytest.mark.parametrize("paradigm", SUMMARIES)
def test_help_fits_a_screen_and_leaves_out_what_the_paradigm_does_not_use(paradigm: str) -> None:
    for name in ["", *app_names()]:
        shown = CliRunner().invoke(cli, [paradigm, *filter(None, [name]), "--help"], env={"COLUMNS": "100"}).stdout
        assert len(shown.splitlines()) <= 43
        assert re.findall(r"╭─ (\w+)", shown) == ["Input", "Fit", "Output"]
        options = set(re.findall(r"^│ (?:-q, )?--([a-z-]+)", shown, re.MULTILINE))
        every = {option.replace("_", "-") for option in (*OPTIONS, *all_options())} | {"json"}
        assert options == every - {"app", "inputs"} - (OWN - SHOWN[name]) - UNUSED[paradigm]


@pytest.mark.parametrize("name", app_names())
def test_offers_of_an_application_are_what_it_has(name: str) -> None:
    protocols = protocols_of(name)
    assert all(recipes_of(name, protocol) for protocol in protocols or ("",))
    app = app_of(name, recipes_of(name)["quick"], (protocols or ("",))[0])
    options = {option.name for option, _ in options_of(name)}
    assert ("size" in options) is (type(app).size_refusal is not App.size_refusal)


@pytest.mark.parametrize(
    ("app", "recipe", "detail", "line"),
    [
        ("brdf", "", 512, "--detail: brdf has no such option, only svbrdf_stationary, texture; leave it out"),
        ("texture", "quick", 512, "--detail 512, by recipe quick: expected no choice; take another recipe"),
        ("texture", "full", 300, "expected one of 256, 512"),
        ("texture", "", 0, "detail: 0, expected 256 or more"),
    ],
)
def test_a_detail_that_there_is_not_is_refused(app: str, recipe: str, detail: int, line: str) -> None:
    with pytest.raises(BadOption, match=line):
        plan(Request(app, recipe=recipe, options={"detail": detail}))


@pytest.mark.parametrize("app", ["texture", "svbrdf_stationary"])
def test_a_finer_detail_fits_the_same_parameters_to_larger_pictures(app: str) -> None:
    usual, fine = (plan(Request(app, "general", recipe="full", options={"detail": detail})) for detail in (256, 512))
    assert usual.options == {}
    assert fine.options == {"detail": 512}
    assert (usual.app.read_size, fine.app.read_size) == (0, 512)
    shapes = [{key: value.shape for key, value in of.app.init(Generator(), 1).items()} for of in (usual, fine)]
    assert shapes[0] == shapes[1]
    small = Task("small", {"image": torch.zeros(3, 300, 300, dtype=torch.uint8)})
    with pytest.raises(ValueError, match="small: 300 px a side, --detail 512 expects 512; leave it out"):
        fine.app.prepare(small)


def test_training_has_no_detail() -> None:
    with pytest.raises(BadOption, match="leave --train out"):
        plan(Request("texture", recipe="full", options={"detail": 512}, train=True))


@pytest.mark.parametrize(
    ("app", "options", "line"),
    [
        ("transport", {"render": 0}, "render: 0, expected 1 to 4096"),
        ("texture", {"size": "1000000x1000000"}, "--size 1000000x1000000: texture expects multiples of 32 from 64 to"),
    ],
)
def test_an_output_of_another_size_is_refused_with_its_range(app: str, options: dict[str, object], line: str) -> None:
    with pytest.raises(ValueError, match=line):
        plan(Request(app, options=options))
