"""The options of fits: the default recipe, parsing and refusals, and which options help shows for which application."""

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from typer.testing import CliRunner

from data_tools.synthetic.examples import write_example
from metapp.appearance.presenter import Presenter
from metapp.apps.exemplar.quilted_app import LARGEST_PHOTO_PX
from metapp.cli.command_tree import app as cli
from metapp.options import BadOption, options_by_name
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.checkpoint_selection import find_checkpoint
from metapp.runs.choice import find_and_choose, has_shipped_recipe
from metapp.runs.fit_options import FitOptions, fit_options, folder_name_parts
from metapp.runs.fitter import Fitter
from metapp.runs.inputs.run_inputs import find_inputs
from metapp.storage.checkpoint_files import load_checkpoint, save_checkpoint
from metapp.storage.fit_records import Origin
from metapp.storage.shipped_checkpoints import shipped_checkpoint_path
from tests.recipe_apps import app_by_recipe, app_names, observations_of, presenter_of, recipes_of


@pytest.mark.parametrize("name", app_names())
def test_all_inputs_go_by_the_best_recipe_that_ships(name: str) -> None:
    assert {"quick", "full", "paper"} <= set(recipes_of(name))
    assert has_shipped_recipe(registry().applications[name], "full")
    for more in ({}, {"paradigm": "general"}, {"inputs": [Path("a")]}, {"data": Path("data")}, {"train": True}):
        assert find_and_choose(fit_options(name, **more)).options.recipe == "full", more
    assert find_and_choose(fit_options(name, recipe="quick")).options.recipe == "quick"


OWN = {"conserve", "observe", "export", "size", "render", "fov", "stops", "shutter", "pitch", "scene-root", "layer"}
OWN |= {"relief"}
SHOWN = {
    "brdf": {"export", "conserve"},
    "texture": {"export", "size", "layer"},
    "svbrdf_stationary": {"export", "size", "fov", "layer", "relief"},
    "svbrdf_nonstationary": {"observe", "export", "size", "fov", "stops", "layer", "relief"},
    "illumination": {"observe", "size", "fov", "shutter", "pitch", "layer"},
    "transport": {"render", "scene-root"},
}
UNUSED = {
    "general": {"steps", "rule"},
    "overfit": {"rule", "checkpoint", "train", "train-steps"},
    "finetune": {"rule"},
    "quickft": {"rule"},
    "meta": set(),
}


@pytest.mark.parametrize("paradigm", PARADIGMS)
@pytest.mark.parametrize("name", SHOWN)
def test_help_fits_a_screen_and_shows_the_options_that_are_used(paradigm: str, name: str) -> None:
    shown = CliRunner().invoke(cli, [paradigm, name, "--help"], env={"COLUMNS": "100"}).stdout
    assert len(shown.splitlines()) <= 43
    assert re.findall(r"╭─ (\w+)", shown) == ["Input", "Fit", "Output"]
    options = set(re.findall(r"^│ (?:-q, )?--([a-z-]+)", shown, re.MULTILINE))
    every = {option.flag.removeprefix("--") for option in options_by_name(FitOptions).values()} | SHOWN[name] | {"json"}
    assert options == every - (OWN - SHOWN[name]) - UNUSED[paradigm]
    assert ("MERL" in shown) == (name == "brdf")  # the inputs are those of the application, too


def test_values_are_parsed_at_the_edge() -> None:
    assert fit_options("texture", size="512").app_options.size == (512, 512)
    assert fit_options("texture", size=(256, 512)).app_options.size == (256, 512)
    assert fit_options("brdf", inputs=["gold.binary"], data="merl").data == Path("merl")


REFUSED: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("brdfs", {}, "'brdfs' is not an application; expected one of brdf"),
    *(("brdf", {"steps": value}, f"--steps {value!r}: expected int or None") for value in ("ten", 1.5, True)),
    ("brdf", {"steps": -1}, "--steps -1: expected 0 to 1,000,000,000"),
    ("brdf", {"steps": 10**23}, "--steps 100000000000000000000000: expected 0 to 1,000,000,000"),
    ("brdf", {"seed": 2**63}, "--seed 9223372036854775808: expected 0 to 9,223,372,036,854,775,807"),
    ("brdf", {"seed": "a"}, "--seed 'a': expected int"),
    ("brdf", {"conserve": "wide"}, "--conserve 'wide': expected bool"),
    ("brdf", {"data": 3}, "--data 3: expected Path or None"),
    ("brdf", {"device": "gpu"}, "--device 'gpu': expected one of auto, cpu, cuda"),
    ("brdf", {"stepz": 1}, "stepz: no option of a fit, expected one of batch, .* Did you mean 'steps'"),
    ("brdf", {"train_steps": 3}, "--train-steps: only with --train"),
    ("brdf", {"recipe": "slow"}, "--recipe 'slow': expected one of"),
    ("svbrdf_nonstationary", {"observe": "fotto"}, "--observe 'fotto': svbrdf_nonstationary expects one of"),
    ("texture", {"size": "1000000x1000000"}, "--size 1000000x1000000: texture expects 16 to 4096"),
    *(("svbrdf_stationary", {"relief": factor}, f"--relief {factor}: expected 0 to 10")
      for factor in (-0.5, float("nan"), 11.0)),
    ("texture", {"relief": 2.0}, "--relief: texture has no such option, only svbrdf_nonstationary, svbrdf_stationary"),
    ("transport", {"render": 0}, "--render 0: expected 1 to 4,096"),
)  # fmt: skip


@pytest.mark.parametrize(("app", "options", "line"), REFUSED)
def test_options_that_fits_cannot_have_are_refused(app: str, options: dict[str, Any], line: str) -> None:
    with pytest.raises(BadOption, match=line):
        find_and_choose(fit_options(app, inputs=["gold.binary"], **options))


@pytest.mark.parametrize("name", app_names())
def test_applications_have_the_options_of_their_entries(name: str) -> None:
    assert all(recipes_of(name, observed) for observed in observations_of(name))
    app = app_by_recipe(name)
    sized = type(presenter_of(app)).size_refusal is not Presenter.size_refusal
    assert hasattr(registry().applications[name].options.load(), "size") is sized


# Inputs of a run, and where records say that they are


def test_records_name_inputs_as_they_were_given(tmp_path: Path) -> None:
    """A link that is given is what pages and exports read again, wherever it leads then."""
    first, link = tmp_path / "first.csv", tmp_path / "newest.csv"
    first.write_text("")
    link.symlink_to(first)
    planned = find_and_choose(fit_options("brdf", "general", inputs=[link], out=tmp_path, quiet=True))
    (run_input,) = find_inputs(planned)[0]
    assert planned.origin(run_input.given_paths) == Origin([str(link)])
    assert run_input.place == str(first)


def test_files_are_read_as_fine_as_fits_are(tmp_path: Path) -> None:
    for app, side, limit in (("illumination", 128, 128), ("svbrdf_stationary", 256, LARGEST_PHOTO_PX)):
        planned = find_and_choose(fit_options(app, "general", inputs=write_example(app, tmp_path)[:1], recipe="full"))
        (run_input,) = find_inputs(planned)[0]
        assert planned.app.read_size in (0, limit)
        assert side in run_input.read_task().data["map" if app == "illumination" else "image"].shape


NO_FIGURE = {
    "inputs",
    "train",
    "train_steps",
    "batch",
    "resume",
    "export",
    "out",
    "quiet",
}  # of no figure


def test_records_state_all_options_that_figures_depend_on() -> None:
    choice = find_and_choose(fit_options("illumination", recipe="quick", observe="photo"))
    names = {"app_options": "options", "application": "app"}  # of fields in settings, where these differ
    named = {names.get(field.name, field.name) for field in fields(FitOptions)} - NO_FIGURE
    app_options = replace(choice.options.app_options, fov=60.0)
    choice = replace(choice, options=replace(choice.options, app_options=app_options))
    assert named <= Fitter.of(choice, "none").settings.document().keys()


def test_a_file_that_two_formats_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An extension's format of a suffix that is taken neither wins nor loses in silence."""
    (tmp_path / "paint.csv").write_text("")
    formats = registry().applications["brdf"].formats
    monkeypatch.setitem(formats.data, "acme", formats["gonio"])
    for path in (tmp_path / "paint.csv", tmp_path):
        options = fit_options("brdf", "general", inputs=[path], recipe="full")
        with pytest.raises(
            ValueError, match=r"paint\.csv: the formats acme and gonio both read it, expected one; leave"
        ):
            find_and_choose(options)


# What was learned at the quick size fits at the full one


@pytest.mark.parametrize("observe", ["reference", "photo"])
@pytest.mark.parametrize("name", ["illumination", "svbrdf_nonstationary"])
def test_meta_starts_from_what_quick_learned(name: str, observe: str, tmp_path: Path) -> None:
    planned = find_and_choose(fit_options(name, observe=observe, recipe="full", out=tmp_path))
    assert planned.app == planned.recipe.app
    assert planned.app.observes == planned.recipe.observes == observe
    prepared = find_checkpoint(planned).phi
    field = planned.app.decoder.network
    assert prepared.alpha["rate.z"].shape[-2:] == (field.rows, field.columns)
    file = f"{planned.recipe.rule}{'-photo' if observe == 'photo' else ''}"
    learned = load_checkpoint(shipped_checkpoint_path(name, file, "full"))[0].alpha
    assert float(prepared.alpha["rate.z"].mean()) == pytest.approx(float(learned["rate.z"].mean()), rel=1e-4)
    assert all(torch.equal(prepared.alpha[key], learned[key]) for key in learned if learned[key].ndim < 4)


def test_another_number_of_channels_is_refused(tmp_path: Path) -> None:
    start, info = load_checkpoint(shipped_checkpoint_path("illumination", "meta-lgd"))
    bad = start._replace(alpha=start.alpha | {"rate.z": torch.zeros(1, 7, 16, 32)})
    save_checkpoint(tmp_path / "bad.safetensors", bad, info)
    options = fit_options("illumination", recipe="full", out=tmp_path, checkpoint=tmp_path / "bad.safetensors")
    with pytest.raises(ValueError, match=r"alpha rate.z is \(steps, 7, 16, 32\), expected \(steps, 8, 32, 64\)"):
        find_checkpoint(find_and_choose(options))


def test_a_rule_that_ships_at_the_quick_size_alone_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.runs.checkpoint_selection._require_kind", lambda *_: None)  # VGG may be missing
    with pytest.raises(ValueError, match=r"meta-basis\.safetensors: .*; this checkpoint ships for --recipe quick\."):
        find_checkpoint(find_and_choose(fit_options("texture", rule="meta-basis", out=tmp_path)))


@pytest.mark.parametrize(
    ("app", "values", "parts"),
    [
        ("illumination", {"shutter": "1/10,1/160", "fov": 60.0}, ["inputs-[0-9a-f]{6}"]),
        ("svbrdf_stationary", {"fov": 60.0, "relief": 2.0}, ["relief2.0", "inputs-[0-9a-f]{6}"]),
        ("brdf", {"conserve": True}, ["conserve"]),
    ],
)
def test_names_of_run_folders_have_a_digest_of_options_about_inputs(
    app: str, values: dict[str, Any], parts: list[str]
) -> None:
    found = folder_name_parts(registry().applications[app].options.load()(**values))
    assert len(found) == len(parts)
    assert all(re.fullmatch(part, name) for part, name in zip(parts, found, strict=True))
