"""The checkpoints that ship: they load, belong together, are small; golden values hold what they fit."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.paradigms.trainings import trainings_of
from metapp.registry import registry
from metapp.runs.checkpoints import checkpoint_name, has_shipped_recipe
from metapp.storage.checkpoint_files import load_checkpoint, tensor_digest
from metapp.storage.shipped_checkpoints import FULL_RECIPE_NAME, QUICK_RECIPE_NAME, shipped_checkpoint_path
from tests.recipe_apps import app_by_recipe, app_names, application, observations_of, recipes_of

PACKAGE = shipped_checkpoint_path("brdf", "general").parent.parent
FULL_ONES = [name for name in app_names() if (PACKAGE / name / FULL_RECIPE_NAME).is_dir()]
FEATURES = {"texture": "VGG-16 features (ImageNet)", "svbrdf_stationary": "VGG-16 features (ImageNet)"}
OBSERVED = ("illumination", "svbrdf_nonstationary")


def files_of(name: str, recipe: str) -> dict[str, Path]:
    """What ships for a recipe, by the file's name without suffix."""
    folder = PACKAGE / name / (recipe if recipe == FULL_RECIPE_NAME else "")
    return {path.stem: path for path in sorted(folder.glob("*.safetensors"))}


def start_of(name: str, checkpoint: str, recipe: str = QUICK_RECIPE_NAME) -> MetaParameters:
    return load_checkpoint(shipped_checkpoint_path(name, checkpoint, recipe))[0]


# What they are


def names_of(paradigm: str, app: App, recipe: Recipe, rule: str = "") -> list[str]:
    trainings = trainings_of(paradigm, app, recipe, rule)
    return [checkpoint_name(application(app.name), app, training) for training in trainings]


def expected_of(name: str, recipe: str) -> set[str]:
    """What must ship: General, an Adam and rules; of "full", where rules go to a finer grid, Adams alone.

    There, a protocol with a network of its own has its own General and rule.
    """
    if recipe == FULL_RECIPE_NAME and observations_of(name) != ("",):
        names = set()
        for protocol in observations_of(name):
            app, of = app_by_recipe(name, FULL_RECIPE_NAME, protocol), recipes_of(name, protocol)[FULL_RECIPE_NAME]
            (general, adam), rule = names_of("quickft", app, of), names_of("meta", app, of)
            names |= {adam, *((general, *rule) if general != "general" else ())}
        return names
    names = {"general"}
    for protocol in observations_of(name):
        app, of = app_by_recipe(name, recipe, protocol), recipes_of(name, protocol)[recipe]
        rules = of.meta if name == "brdf" else (of.rule,)
        names.add(names_of("quickft", app, of)[1])
        names.update(*(names_of("meta", app, of, rule) for rule in rules))
    return names


@pytest.mark.parametrize(
    ("name", "recipe"),
    [*((name, QUICK_RECIPE_NAME) for name in app_names()), *((name, FULL_RECIPE_NAME) for name in FULL_ONES)],
)
def test_checkpoints_state_their_application_recipe_and_features(name: str, recipe: str) -> None:
    files = files_of(name, recipe)
    assert set(files) == expected_of(name, recipe)
    for stem, path in files.items():
        suffix = "-photo" if stem.endswith("-photo") and "general-photo" in files else ""
        encoder = tensor_digest(start_of(name, f"general{suffix}", recipe).encoder)
        _, info = load_checkpoint(path)
        assert (info["app"], info["checkpoint"], info["recipe"]) == (name, stem.removesuffix("-photo"), recipe), stem
        assert info.get("features") == FEATURES.get(name), stem
        assert info["validation_error"] > 0 or name == "transport", stem
        if recipe == QUICK_RECIPE_NAME and name != "brdf":
            assert info["data"].startswith(name), stem  # the embedded set alone
        if stem.startswith("general"):
            continue
        if name in OBSERVED:
            assert info["observe"] == ("photo" if stem.endswith("-photo") else "reference"), stem
        rule = recipes_of(name)[recipe].meta.get(stem)
        # this one holds an encoder of its own, which went on from General before General did
        if (rule is None or rule.from_general) and (name, stem) != ("svbrdf_nonstationary", "meta-lgd"):
            assert info["encoder"] == encoder, stem


def test_checkpoints_are_small() -> None:
    for name in app_names():
        for path in files_of(name, QUICK_RECIPE_NAME).values():
            assert path.stat().st_size < {"brdf": 2e6, "transport": 2e6, "svbrdf_nonstationary": 5e6}.get(name, 4e6)
    sizes = {path: path.stat().st_size for path in PACKAGE.rglob("*.safetensors")}
    of_default_recipes = {
        path: size for path, size in sizes.items() if path.parent.name in ("few", "pretrained", "several")
    }
    assert sum(sizes.values()) - sum(of_default_recipes.values()) < 25e6
    assert max(of_default_recipes.values()) < 2e6


def test_recipes_of_another_size_ship_with_a_folder() -> None:
    for name in app_names():
        recipes = recipes_of(name)
        if FULL_RECIPE_NAME in recipes:
            same = recipes[FULL_RECIPE_NAME].app == recipes[QUICK_RECIPE_NAME].app
            assert has_shipped_recipe(registry().applications[name], FULL_RECIPE_NAME) == (same or name in FULL_ONES)
    assert FULL_ONES == ["illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture"]


# What commands find


@pytest.mark.usefixtures("small_spheres")
def test_commands_find_shipped_checkpoints(metapp: Callable, tmp_path: Path) -> None:
    data = tmp_path / "few"
    assert metapp("data", "synth", "brdf", "--count", "5", "--out", data).code == 0
    result = metapp("meta", "brdf", "--data", data, "--out", tmp_path, "--json")
    assert "the checkpoint that ships, trained on other data" in result.err
    assert result.json_document["error"] < 2
    trained = tmp_path / "brdf/checkpoints" / f"{result.json_document['data']}-quick-seed0/meta-curvature.safetensors"
    trained.parent.mkdir(parents=True)
    shutil.copy(shipped_checkpoint_path("brdf", "meta-curvature"), trained)
    again = ("meta", "brdf", "--data", data, "--out", tmp_path, "--recipe", "quick")
    assert "the checkpoint that ships" in metapp(*again).err
    assert f"from {trained}" in metapp(*again, "--checkpoint", trained).err
