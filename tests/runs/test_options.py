"""The options of fits: the default recipe, parsing and refusals, and which options help shows for which application."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from data_tools.synthetic.examples import write_example
from metapp.appearance.presenter import Presenter
from metapp.apps.exemplar.exemplar_codec import LARGEST_PHOTO_PX
from metapp.cli.command_tree import app as cli
from metapp.options import BadOption, options_by_name
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.checkpoints import has_shipped_recipe
from metapp.runs.inputs.finding import find
from metapp.runs.resolve import app_of, complete
from metapp.runs.spec import RunOptions, Spec, given_words, parse_fit_options
from tests.recipe_apps import app_by_recipe, app_names, observations_of, presenter_of, recipes_of


@pytest.mark.parametrize("name", app_names())
def test_fits_go_by_the_best_recipe_that_ships(name: str) -> None:
    assert {"quick", "full", "paper"} <= set(recipes_of(name))
    assert has_shipped_recipe(registry().applications[name], "full")
    for more in ({}, {"paradigm": "general"}, {"seed": 3}):
        assert complete(Spec(app=name, **more), trained=False).recipe == "full", more
    assert complete(Spec(app=name, recipe="quick"), trained=False).recipe == "quick"


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
    of_fits = (*options_by_name(Spec).values(), *options_by_name(RunOptions).values())
    every = {option.flag.removeprefix("--") for option in of_fits} | SHOWN[name] | {"json"}
    assert options == every - (OWN - SHOWN[name]) - UNUSED[paradigm]
    assert ("MERL" in shown) == (name == "brdf")  # the inputs are those of the application, too


def test_values_are_parsed_at_the_edge() -> None:
    assert parse_fit_options("texture", size="512")[0].app_options.size == (512, 512)
    assert parse_fit_options("texture", size=(256, 512))[0].app_options.size == (256, 512)
    assert parse_fit_options("brdf", data="merl")[1].data == Path("merl")


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
        complete(parse_fit_options(app, **options)[0], trained=False)


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
    (one,) = find(Spec(app="brdf"), [link])
    assert (one.given, one.path) == ((str(link),), str(first))


def test_files_are_read_as_fine_as_fits_are(tmp_path: Path) -> None:
    for app, side, limit in (("illumination", 128, 128), ("svbrdf_stationary", 256, LARGEST_PHOTO_PX)):
        spec = complete(Spec(app=app, paradigm="general", recipe="full"), trained=False)
        (one,) = find(spec, write_example(app, tmp_path)[:1])
        assert app_of(spec).read_size in (0, limit)
        assert side in one.read_task(spec, app_of(spec)).data["map" if app == "illumination" else "image"].shape


def test_a_specification_is_read_back_as_it_was_written() -> None:
    given, _ = parse_fit_options("illumination", observe="photo", fov=60.0, size="64x128", checkpoint="a.safetensors")
    for spec in (given, complete(given, trained=False)):
        assert Spec.of_document(json.loads(json.dumps(spec.document()))) == spec
        assert spec.app_options.fov == 60.0
        assert spec.app_options.size == (64, 128)
    assert given.key != complete(given, trained=False).key


def test_a_file_that_two_formats_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An extension's format of a suffix that is taken neither wins nor loses in silence."""
    (tmp_path / "paint.csv").write_text("")
    formats = registry().applications["brdf"].formats
    monkeypatch.setitem(formats, "acme", formats["gonio"])
    for path in (tmp_path / "paint.csv", tmp_path):
        with pytest.raises(
            ValueError, match=r"paint\.csv: the formats acme and gonio both read it, expected one; leave"
        ):
            find(Spec(app="brdf"), [path])


# What was learned at the quick size fits at the full one


@pytest.mark.parametrize(
    ("app", "values", "name"),
    [
        ("brdf", {"conserve": True}, "meta-conserve"),
        ("brdf", {"recipe": "quick", "rule": "meta-sgd", "steps": 5, "seed": 3}, "meta-quick-meta-sgd-5steps-seed3"),
        ("illumination", {"observe": "photo", "fov": 60.0}, "meta-photo-fov60.0"),
        ("illumination", {"shutter": "1/10,1/160"}, "meta-[0-9a-f]{8}"),
        ("svbrdf_stationary", {"relief": 2.0, "size": "64x128"}, "meta-relief2.0-size64x128"),
        ("brdf", {"checkpoint": "runs/mine.safetensors"}, "meta-mine-[0-9a-f]{6}"),
    ],
)
def test_folders_of_runs_are_named_by_the_users_words(app: str, values: dict[str, Any], name: str) -> None:
    assert re.fullmatch(name, given_words(parse_fit_options(app, **values)[0]))
