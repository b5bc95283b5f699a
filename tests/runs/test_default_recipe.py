"""By which recipe fits go where none is named."""

from __future__ import annotations

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
