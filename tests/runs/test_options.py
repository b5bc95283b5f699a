"""The options of fits: by which recipe they go where none is named, and what help shows of which application."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pytest

from metapp.apps import app_names, recipes_of
from metapp.cli.fit import OPTIONS
from metapp.runs.checks import ships
from metapp.runs.plan import plan
from metapp.runs.request import Request


@pytest.mark.parametrize("name", app_names())
def test_files_data_sets_and_trainings_go_by_the_best_recipe_that_ships(name: str) -> None:
    assert {"quick", "full", "paper"} <= set(recipes_of(name))
    assert ships(name, "full")
    for more in ({}, {"paradigm": "general"}, {"inputs": [Path("a")]}, {"data": Path("data")}, {"train": True}):
        assert plan(Request(name, **more)).request.recipe == "full", more
    assert plan(Request(name, recipe="quick")).request.recipe == "quick"


def test_every_field_of_a_request_is_an_option() -> None:
    assert {field.name for field in fields(Request)} == OPTIONS.keys() | {"paradigm"}


OWN = {"observe", "export", "size", "render", "fov", "scene-root"}
SHOWN = {
    "": set(),
    "brdf": {"export"},
    "texture": {"export", "size"},
    "svbrdf_stationary": {"export", "size", "fov"},
    "svbrdf_nonstationary": {"observe", "export", "fov"},
    "illumination": {"observe", "size"},
    "transport": {"render", "scene-root"},
}


@pytest.mark.parametrize("name", SHOWN)
def test_help_shows_the_options_of_the_application_alone(metapp: Callable, name: str) -> None:
    result = metapp("meta", *filter(None, [name]), "--help")
    assert result.code == 0
    options = set(re.findall(r"--([a-z-]+)", result.out))
    assert options & OWN == SHOWN[name]
    assert {"steps", "rule", "recipe", "batch", "budget"} <= options
    assert ("MERL" in result.out) == (name == "brdf")  # the inputs are those of the application, too
