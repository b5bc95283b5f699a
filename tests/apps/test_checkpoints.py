"""The checkpoints that ship: they load, belong together, are small; golden values hold what they fit."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.learning.learn import MetaParameters
from metapp.paradigms.trainings import adam_search, general_training, rule_training
from metapp.registry import registry
from metapp.runs.checkpoints import (
    GENERAL,
    find_checkpoint,
    find_entry,
    has_shipped_recipe,
    read_checkpoint,
)
from metapp.runs.resolve import app_of, complete, recipe_of
from metapp.runs.spec import Spec
from metapp.storage.checkpoint_files import phi_digest, read_entry, read_headers, tensor_digest, write_entry
from metapp.storage.shipped_checkpoints import (
    FULL_RECIPE_NAME,
    QUICK_RECIPE_NAME,
    shipped_checkpoint_path,
    shipped_checkpoints,
)
from tests.recipe_apps import app_names, observations_of, recipes_of

FULL_ONES = [name for name in app_names() if shipped_checkpoint_path(name, FULL_RECIPE_NAME).is_file()]
FEATURES = {"texture": "VGG-16 features (ImageNet)", "svbrdf_stationary": "VGG-16 features (ImageNet)"}
FILES = [path for name in app_names() for path in shipped_checkpoints(name)]
EACH_FILE = pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")


def spec_of(app: str, recipe: str, header: dict[str, str]) -> Spec:
    """The specification of fits that begin at an entry."""
    return complete(Spec(app=app, paradigm="general", recipe=recipe, observe=header.get("observe", "")), trained=False)


# What they are


def expected_trainings(name: str, recipe: str) -> set[tuple[str, str]]:
    """What must ship, by name and observation: General, an Adam and rules.

    Of "full", where rules go to a finer grid, an application with several protocols has Adams alone; there, a protocol
    with a network of its own has its own General and rule.
    """
    found = set()
    for protocol in observations_of(name):
        of = recipes_of(name, protocol)[recipe]
        rules = of.meta if (name, recipe) == ("brdf", QUICK_RECIPE_NAME) else (of.rule,)
        default_networks = [recipe.app.encoder_settings for recipe in recipes_of(name).values()]
        has_own_network = of.app.encoder_settings not in default_networks
        trainings = [adam_search(of.app, of)]
        if recipe != FULL_RECIPE_NAME or has_own_network or observations_of(name) == ("",):
            trainings += [rule_training(of.app_with(rule), of, rule) for rule in rules]
            found.add((general_training(of.app, of).name, protocol if has_own_network else ""))
        found |= {(training.name, protocol) for training in trainings}
    return found


@pytest.mark.parametrize(
    ("name", "recipe"),
    [*((name, QUICK_RECIPE_NAME) for name in app_names()), *((name, FULL_RECIPE_NAME) for name in FULL_ONES)],
)
def test_all_checkpoints_of_an_application_ship(name: str, recipe: str) -> None:
    headers = read_headers(shipped_checkpoint_path(name, recipe)).values()
    found = {(header["checkpoint"], header.get("observe", "")) for header in headers}
    assert found == expected_trainings(name, recipe)


@EACH_FILE
def test_entries_state_their_application_recipe_and_features(path: Path) -> None:
    name, recipe = path.parent.name, path.stem
    for entry, header in read_headers(path).items():
        ending = "-photo" if entry.endswith("-photo") else ""
        assert (header["app"], header["checkpoint"], header["recipe"]) == (name, entry.removesuffix(ending), recipe)
        assert header.get("observe", "photo" if ending else "reference") == ("photo" if ending else "reference")
        if recipe != "pretrained":
            assert header.get("features") == FEATURES.get(name), entry
        error = header["validation_error"]
        assert error is None or error > 0 or name == "transport", entry
        if recipe == QUICK_RECIPE_NAME and name != "brdf":
            assert header["data"].startswith(name), entry  # the embedded set alone


@EACH_FILE
def test_entries_state_the_digest_of_their_values(path: Path) -> None:
    for entry, header in read_headers(path).items():
        assert header["digest"] == phi_digest(read_entry(path, entry)[0]), entry


@EACH_FILE
def test_adams_and_rules_begin_at_the_general_that_ships_beside_them(path: Path) -> None:
    """An Adam was searched for the very encoder that its fits take: its own, or the one that ships for the recipe."""
    name, recipe = path.parent.name, path.stem
    for entry, header in read_headers(path).items():
        phi, spec = read_entry(path, entry)[0], spec_of(name, recipe, header)
        if header["checkpoint"] == GENERAL or "encoder" not in header:
            continue
        general = find_entry(spec, app_of(spec), [GENERAL])
        encoder = tensor_digest(read_entry(general.path, general.name)[0].encoder)
        # this one holds an encoder of its own, which went on from General before General did
        if (name, entry) != ("svbrdf_nonstationary", "meta-lgd"):
            assert header["encoder"] == encoder, entry
        if header["checkpoint"] == "quickft" and phi.encoder:
            assert tensor_digest(phi.encoder) == encoder, entry


def test_checkpoints_are_small() -> None:
    sizes = {path: path.stat().st_size for path in FILES}
    of_default_recipes = {path: size for path, size in sizes.items() if path.stem in ("few", "pretrained", "several")}
    assert sum(sizes.values()) - sum(of_default_recipes.values()) < 25e6
    assert max(of_default_recipes.values()) < 2e6
    assert max(sizes.values()) < 6e6


def test_recipes_of_another_size_ship_with_a_file() -> None:
    for name in app_names():
        recipes = recipes_of(name)
        if FULL_RECIPE_NAME in recipes:
            same = recipes[FULL_RECIPE_NAME].app == recipes[QUICK_RECIPE_NAME].app
            assert has_shipped_recipe(registry().applications[name], FULL_RECIPE_NAME) == (same or name in FULL_ONES)
    assert FULL_ONES == ["illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture"]


# What fits begin at


def read_shipped(**values: str) -> MetaParameters:
    spec = complete(Spec(**values, device="cpu"))
    return read_checkpoint(spec, app_of(spec), recipe_of(spec))


@pytest.mark.parametrize("observe", ["reference", "photo"])
@pytest.mark.parametrize("name", ["illumination", "svbrdf_nonstationary"])
def test_meta_starts_from_what_quick_learned(name: str, observe: str) -> None:
    recipe = recipes_of(name, observe)["full"]
    phi, field = read_shipped(app=name, observe=observe, recipe="full"), recipe.app.decoder.network
    assert phi.alpha["rate.z"].shape[-2:] == (field.rows, field.columns)
    spec = Spec(app=name, observe=observe, recipe="full")
    entry = find_entry(spec, recipe.app, [recipe.rule])
    learned = read_entry(entry.path, entry.name)[0].alpha
    assert float(phi.alpha["rate.z"].mean()) == pytest.approx(float(learned["rate.z"].mean()), rel=1e-4)
    assert all(torch.equal(phi.alpha[key], learned[key]) for key in learned if learned[key].ndim < 4)


def test_another_number_of_channels_is_refused(tmp_path: Path) -> None:
    path, (phi, header) = tmp_path / "bad.safetensors", read_entry(shipped_checkpoint_path("illumination"), "meta-lgd")
    write_entry(path, "meta-lgd", phi._replace(alpha=phi.alpha | {"rate.z": torch.zeros(1, 7, 16, 32)}), header)
    spec = complete(Spec(app="illumination", recipe="full", checkpoint=path))
    with pytest.raises(ValueError, match=r"alpha rate.z is \(steps, 7, 16, 32\), expected \(steps, 8, 32, 64\)"):
        read_checkpoint(spec, app_of(spec), recipe_of(spec))


def test_a_rule_that_ships_at_the_quick_size_alone_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.runs.checkpoints._check_conditions", lambda *_: None)  # VGG may be missing
    with pytest.raises(ValueError, match=r"quick\.safetensors: .*; this checkpoint ships for --recipe quick\."):
        read_shipped(app="texture", recipe="full", rule="meta-basis")


def test_general_serves_what_fits_of_the_quick_recipe_see_alike() -> None:
    """By "full" photos have a network of their own, and other fits the General of "quick"."""
    for observe, recipe, expected in (
        ("photo", "quick", ("quick", "general")),
        ("photo", "full", ("full", "general-photo")),
        ("reference", "full", ("quick", "general")),
    ):
        spec = complete(Spec(app="svbrdf_nonstationary", paradigm="general", observe=observe, recipe=recipe))
        entry = find_checkpoint(spec, app_of(spec), recipe_of(spec))
        assert entry is not None
        assert (entry.path.stem, entry.name) == expected


# What commands find


@pytest.mark.usefixtures("small_spheres")
def test_commands_find_shipped_checkpoints(metapp: Callable, tmp_path: Path) -> None:
    data = tmp_path / "few"
    assert metapp("data", "synth", "brdf", "--count", "5", "--out", data).code == 0
    result = metapp("meta", "brdf", "--data", data, "--out", tmp_path, "--json")
    assert "the checkpoint that ships, trained on other data" in result.err
    assert result.json_document["error"] < 2
    trained = tmp_path / "brdf/checkpoints" / f"{result.json_document['data']}-quick-seed0.safetensors"
    trained.parent.mkdir(parents=True)
    shutil.copy(shipped_checkpoint_path("brdf"), trained)
    again = ("meta", "brdf", "--data", data, "--out", tmp_path, "--recipe", "quick")
    assert "the checkpoint that ships" in metapp(*again).err
    assert f"from {trained}" in metapp(*again, "--checkpoint", trained).err
