"""The recipe: where it is the default, and what it says where weights are missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.apps import app_of, recipes_of
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.extensions.pretrained.app import FromFeatures
from metapp.runs.options import fit_options
from metapp.runs.run import Run
from tests.extensions.pretrained.conftest import APP


def test_only_its_recipe_is_of_the_subclass() -> None:
    kinds = {name: type(app_of(APP, recipe, "photo")) for name, recipe in recipes_of(APP, "photo").items()}
    assert {name for name, kind in kinds.items() if kind is FromFeatures} == {"pretrained"}
    assert kinds["full"] is SvbrdfNonstationary


def test_without_the_weights_it_says_how_to_get_them(metapp: Callable, tmp_path: Path, cache: Path) -> None:
    photo = ("general", APP, "--observe", "photo", "--train", "--train-steps", "1", "--out", tmp_path / "runs")
    assert metapp("data", "synth", APP, "--count", "8", "--size", "32", "--out", tmp_path / "set").code == 0
    done = metapp(*photo, "--recipe", "pretrained", "--data", tmp_path / "set")
    assert done.code == 1
    assert "get them by metapp data vgg, or fit by --recipe full" in " ".join(done.err.split())
    assert "Traceback" not in done.err


@pytest.mark.parametrize("has", [True, False])
def test_it_is_the_default_of_what_goes_on_from_general_where_weights_are(
    request: pytest.FixtureRequest, metapp: Callable, tmp_path: Path, has: bool
) -> None:
    """Else the smaller network, which is said; other paradigms and protocols have no files for it."""
    if has:
        request.getfixturevalue("weights")
    assert metapp("data", "synth", APP, "--count", "8", "--size", "32", "--out", tmp_path / "set").code == 0

    def chosen(paradigm: str, **options: object) -> str:
        return Run.of(
            fit_options(APP, paradigm, **{"observe": "photo", "data": tmp_path / "set"} | options)
        ).options.recipe

    defaults = {chosen(paradigm) for paradigm in ("general", "quickft", "meta")}
    assert defaults == {"pretrained" if has else "full"}
    assert chosen("general", recipe="full") == chosen("finetune") == "full"
    assert chosen("general", observe="reference") == "full"
    done = metapp("general", APP, "--observe", "photo", "--data", tmp_path / "set", "--out", tmp_path / "runs")
    said = " ".join(done.err.split())
    assert ("the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them" in said) != has
    assert done.code == has  # these weights are not those that the checkpoint was trained with
