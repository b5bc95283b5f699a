"""Trainings of checkpoints from the command line: entries of one file, which fits take by --checkpoint."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from metapp.apps.brdf.recipes import RECIPES
from metapp.learning.recipe import Adam, Recipe
from metapp.storage import Document
from metapp.storage.checkpoint_files import read_entry, read_headers
from tests.cli.messages import says
from tests.conftest import CommandResult

STEPS = ("--train", "--train-steps", "3")
pytestmark = pytest.mark.usefixtures("small_spheres")


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> Recipe:
    """The quick recipe with few steps of Finetune, and without a compiler."""
    recipe = replace(RECIPES["quick"], finetune_steps=5)
    monkeypatch.setitem(RECIPES, "quick", recipe)
    monkeypatch.setenv("TORCH_COMPILE_DISABLE", "1")
    return recipe


@pytest.fixture
def fit(metapp: Callable, ten_materials: Path) -> Callable:
    """`metapp PARADIGM brdf` on ten small materials, eight of them for training."""
    return lambda paradigm, *more: metapp(paradigm, "brdf", *more, "--recipe", "quick", "--data", ten_materials)


def trained_file() -> Path:
    """The one file of all trainings; what lies beside it has further suffixes."""
    (path,) = (path for path in Path("runs/brdf/checkpoints").iterdir() if path.suffixes == [".safetensors"])
    return path


def header_of(entry: str) -> Document:
    return read_headers(trained_file())[entry]


def errors_of(result: CommandResult) -> list[float]:
    return [task["error"] for task in result.json_document["tasks"]]


def refuse(result: CommandResult, *parts: str) -> None:
    assert result.out == ""
    assert all(part in result.error for part in parts), result.err


def test_a_trained_checkpoint_is_used_where_it_is_named(fit: Callable) -> None:
    """Without the option, fits begin at the checkpoint that ships, whatever was trained here."""
    ships = fit("general", "--json")
    trained = fit("general", *STEPS, "--json")
    path = trained_file()
    assert errors_of(fit("general", "--json")) == errors_of(ships) != errors_of(trained)
    again = fit("general", "--json", "--checkpoint", path)
    assert str(path) in again.err
    assert errors_of(again) == errors_of(trained)
    assert fit("finetune", "--json", "--checkpoint", path).json_document["steps"] == 5
    refuse(fit("meta", "--checkpoint", path), "brdf general", "meta-curvature")
    refuse(fit("meta", "--checkpoint", path.parent), "a folder", ".safetensors")
    result = fit("general", "--checkpoint", path.rename("mine.safetensors"))
    assert result.code == 0
    assert "mine.safetensors" in result.err


def test_a_replaced_entry_is_kept_beside_the_file(fit: Callable) -> None:
    fit("general", *STEPS)
    path = trained_file()
    previous = path.with_suffix(".general.previous.safetensors")
    assert header_of("general")["training"]["steps"] == 3
    fit("general", *STEPS)
    assert not previous.exists()  # it would be the same
    fit("general", *STEPS[:-1], "4")
    assert header_of("general")["training"]["steps"] == 4
    assert read_headers(previous)["general"]["training"]["steps"] == 3
    assert {file.name for file in path.parent.iterdir()} == {path.name, previous.name}


def test_trainings_of_one_data_set_write_one_file(fit: Callable) -> None:
    trained = {name: fit(name, *STEPS, "--json") for name in ("general", "quickft", "meta")}
    path = trained_file()
    assert set(read_headers(path)) == {"general", "quickft", "meta-curvature"}
    assert header_of("quickft")["encoder_of"] == "general"
    for name, result in trained.items():
        assert errors_of(fit(name, "--checkpoint", path, "--json")) == errors_of(result)


@pytest.mark.parametrize(("paradigm", "rule"), [("general", "general"), ("meta", "meta-sgd")])
def test_a_training_goes_on_from_a_checkpoint(fit: Callable, paradigm: str, rule: str) -> None:
    """Outer steps go on where those of the checkpoint ended, and fits use the result."""
    named = () if paradigm == "general" else ("--rule", rule)
    first = fit(paradigm, *named, *STEPS, "--json")
    assert first.code == 0, first.err
    then = header_of(rule)
    kept = trained_file().rename("mine.safetensors")
    more = fit(paradigm, *named, *STEPS, "--checkpoint", kept, "--json")
    assert more.code == 0, more.err
    assert "going on from mine.safetensors" in more.err
    header = header_of(rule)
    assert header["first"] == then["digest"]
    assert header["curve"][0][2] == pytest.approx(then["validation_error"], rel=1e-4)
    assert header["validation_error"] <= then["validation_error"]
    assert str(trained_file()) in more.err


def test_a_training_begins_at_the_general_that_is_named(fit: Callable) -> None:
    fit("general", *STEPS)
    kept = trained_file().rename("mine.safetensors")
    for paradigm in ("quickft", "meta"):
        result = fit(paradigm, *STEPS, "--checkpoint", kept, "--json")
        assert (result.code, "General: mine.safetensors" in result.err) == (0, True)
    assert set(read_headers(trained_file())) == {"quickft", "meta-curvature"}
    refuse(fit("quickft", "--train", "--checkpoint", trained_file()), str(trained_file()), "General")
    refuse(fit("quickft", "--train", "--checkpoint", trained_file().parent), "a folder", ".safetensors")


def test_quickft_is_tuned_for_its_encoder(fit: Callable, monkeypatch: pytest.MonkeyPatch, short: Recipe) -> None:
    # a recipe that moves too far, and a search that looks at one other
    monkeypatch.setitem(RECIPES, "quick", replace(short, quickft=Adam(1.0), search=([{"beta1": 0.3, "rate": 1e-7}],)))
    assert fit("general", *STEPS).code == 0
    path = trained_file()
    assert says(fit("quickft", "--checkpoint", path).err, "no Adam", "--train")
    tuned = fit("quickft", "--train", "--checkpoint", path, "--json")
    assert tuned.code == 0
    assert float(read_entry(path, "quickft")[0].alpha["beta1"]) == pytest.approx(0.3)  # not the recipe's
    again = fit("quickft", "--checkpoint", path, "--json")
    assert errors_of(again) == errors_of(tuned)
    assert "no Adam" not in again.err


def test_meta_on_own_data_starts_from_a_general_of_this_data(fit: Callable) -> None:
    """A General of equal settings is not trained again, and one of other settings is not replaced."""
    result = fit("meta", *STEPS)
    assert says(result.err, "General", "training it first", "3 steps")
    before = header_of("general")
    assert "training it first" not in fit("quickft", *STEPS).err
    assert header_of("general") == before
    refuse(fit("meta", *STEPS[:-1], "2"), str(trained_file()), "General", "--checkpoint")
    assert header_of("general") == before


def test_a_rule_without_a_checkpoint_is_trained_and_used(fit: Callable) -> None:
    """It is trained as the recipe's default rule is."""
    trained = fit("meta", "--rule", "meta-adam", *STEPS, "--json", "--quiet")
    assert trained.code == 0, trained.err
    assert trained.json_document["rule"] == "meta-adam"
    path = trained_file()
    phi, header = read_entry(path, "meta-adam")
    assert header["checkpoint"] == "meta-adam"
    assert header["training"]["clip"] == RECIPES["quick"].meta["meta-curvature"].clip
    assert {"rate", "beta1", "beta2", "loss"} == {name.partition(".")[0] for name in phi.alpha}
    again = fit("meta", "--rule", "meta-adam", "--json", "--quiet", "--checkpoint", path).json_document
    assert [task["error"] for task in again["tasks"]] == errors_of(trained)
    assert again["rule"] == "meta-adam"
    refuse(fit("meta", "--checkpoint", path), "meta-adam", "expected brdf meta-curvature")


def test_a_damaged_file_is_refused_before_anything_is_trained(fit: Callable) -> None:
    fit("general", *STEPS)
    trained_file().write_bytes(b"broken")
    result = fit("general", *STEPS)
    refuse(result, str(trained_file()), "not a checkpoint that metapp wrote")
    assert "training brdf" not in result.err
    assert trained_file().read_bytes() == b"broken"
