"""By which recipe a user's own files are fitted."""

from __future__ import annotations

from pathlib import Path

import pytest
from metapp.runs.session import options_of

from metapp.apps import app_names, load_app

NAMES = app_names()


@pytest.mark.parametrize("name", NAMES)
def test_every_application_has_a_full_recipe_that_ships(name: str) -> None:
    assert {"quick", "full", "paper"} <= set(load_app(name).recipes)
    assert options_of(name, recipe="full").recipe == "full"


@pytest.mark.parametrize("name", NAMES)
def test_own_files_are_fitted_by_full_where_its_fits_are_others(name: str) -> None:
    expected = {"brdf": {"meta"}, "transport": set()}.get(name, {"meta", "general"})
    for paradigm in ("meta", "general"):
        recipe = options_of(name, own_files_by=paradigm).recipe
        assert recipe == ("full" if paradigm in expected else "quick"), paradigm
        assert options_of(name, own_files_by=paradigm, recipe="quick").recipe == "quick"
        assert options_of(name, own_files_by=paradigm, data=Path("data")).recipe == "quick"
    assert options_of(name).recipe == "quick"  # of a data set
