"""Fitting and evaluating end to end: tables, JSON, run folders, starts, and one line for every kind of bad input."""

import errno
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from data_tools.synthetic.examples import write_example
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.learning.recipe import Recipe
from metapp.learning.task import Params, Tasks
from metapp.registry import registry
from metapp.runs.fit import Fit
from metapp.runs.stored_fits import read_fits
from metapp.storage.fit_folders import RECORD, read_params
from metapp.storage.folders import MARKER
from tests.cli.messages import says
from tests.conftest import CommandResult

STEPS = ("--train", "--train-steps", "3")
pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 10


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> Recipe:
    """The quick recipe with few steps of Overfit and Finetune, and without a compiler."""
    recipe = replace(RECIPES["quick"], overfit_steps=30, finetune_steps=5)
    monkeypatch.setitem(RECIPES, "quick", recipe)
    monkeypatch.setenv("TORCH_COMPILE_DISABLE", "1")
    return recipe


@pytest.fixture
def fit(metapp: Callable, ten_materials: Path) -> Callable:
    """`metapp PARADIGM brdf` on ten small materials, eight of them for training, runs in a folder of this test."""

    def call(paradigm: str, *arguments: str | Path) -> CommandResult:
        defaults = {"--recipe": "quick", "--data": ten_materials}
        more = [word for pair in defaults.items() if pair[0] not in arguments for word in pair]
        return metapp(paradigm, "brdf", *arguments, *more)

    return call


def errors_of(result: CommandResult) -> list[float]:
    return [task["error"] for task in result.json_document["tasks"]]


# What works


def write_to_a_full_disk(*arguments: object) -> None:
    """An export, as entries of the registry name it."""
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("full", [False, True])
def test_an_export_that_fails_leaves_the_fit(fit: Callable, monkeypatch: pytest.MonkeyPatch, full: bool) -> None:
    """Parameters and records are written first; a file in a folder's place, or a full disk, is said by its path."""
    folder = Path(fit("general", *STEPS, "--json").json_result["out"])

    if full:
        merl = replace(registry().exports["reflectance", "merl"], reference=f"{__name__}:write_to_a_full_disk")
        monkeypatch.setitem(registry().exports, ("reflectance", "merl"), merl)
    else:
        for name in ("m4", "m9"):
            (folder / name / "merl").touch()
    result = fit("general", *STEPS, "--export", "merl,nbrdf")
    assert result.code == 1
    for name in ("m4", "m9"):
        assert says(result.err, f"{folder}/{name}/merl/{name}", "No space left" if full else "File exists")
        assert (folder / name / "nbrdf" / name).is_dir()
        assert read_params(folder / name)
    assert result.error.startswith("error: 2 exports")
    assert [fit.name for fit in read_fits(folder)] == ["m4", "m9"]


@pytest.mark.parametrize(("number", "fitted"), [(errno.ENOSPC, 1), (errno.EACCES, 3)])
def test_a_fit_that_cannot_be_written_leaves_the_others_and_the_report(
    metapp: Callable, write_nbrdf_networks: Callable, monkeypatch: pytest.MonkeyPatch, number: int, fitted: int
) -> None:
    """The second of four fits is not written: a full disk ends the fits, a folder without rights ends none."""
    keep, kept = Fit.keep, []

    def keep_but_one(fit: Fit, *arguments: Any) -> None:
        kept.append(fit)
        if len(kept) == 2:
            raise OSError(number, os.strerror(number))
        keep(fit, *arguments)

    monkeypatch.setattr(Fit, "keep", keep_but_one)
    result = metapp("general", "brdf", write_nbrdf_networks(4), "--json")
    assert result.code == 1
    assert len(result.json_document["tasks"]) == fitted
    reasons = [failure["reason"] for failure in result.json_document["failures"]]
    assert os.strerror(number) in reasons[0]
    assert ["disk" in reason for reason in reasons[1:]] == [True] * (3 - fitted)


@pytest.mark.parametrize(
    ("inputs", "code"), [(["in"], 0), (["in/broken.csv", "in/good.csv"], 1), (["in/broken.csv"], 1)]
)
def test_a_broken_file_is_listed_and_fails_a_run_that_names_it(metapp: Callable, inputs: list[str], code: int) -> None:
    """What the page on scripts says: the exit code depends on who named the file, the list of failures does not."""
    (paint,) = write_example("brdf", Path("in"))
    paint.rename("in/good.csv")
    Path("in/broken.csv").write_text("theta_i_deg,phi_i_deg\n1,x\n")
    result = metapp("general", "brdf", *inputs, "--json")
    assert result.code == code
    if len(inputs) == 1 and code:
        assert says(result.error, "broken.csv", "line 2", "'x'")
        assert not result.out
        return
    assert [task["name"] for task in result.json_document["tasks"]] == ["good"]
    (failure,) = result.json_document["failures"]
    assert Path(failure["source"]).resolve() == Path("in/broken.csv").resolve()
    assert says(failure["reason"], "broken.csv", "line 2", "'x'")


def test_a_fit_prints_a_table_and_leaves_its_files(fit: Callable) -> None:
    result = fit("overfit", "--steps", "40")
    assert result.code == 0
    assert "m4" in result.out
    assert "mean error" in result.out
    assert says(result.err, "brdf overfit", "40 steps", "random")
    (folder,) = Path("runs/brdf").iterdir()
    assert folder.name.startswith("overfit-materials-")
    assert f"fits: {folder}" in result.err
    assert f"to look at: metapp view {folder}" in result.err
    fits = read_fits(folder)
    assert [fit.name for fit in fits] == ["m4", "m9"]
    assert fits[0].spec.steps == 40
    assert fits[0].spec.versions["torch"] == str(torch.__version__)
    assert load_file(folder / "m4" / "params.safetensors")["w2"].shape == (21, 21)
    assert {file.name for file in folder.iterdir()} == {"m4", "m9", "pictures.png", MARKER}
    assert (folder / "pictures.png").read_bytes().startswith(b"\x89PNG")


def test_one_input_prints_a_line_and_the_files_that_were_asked_for(metapp: Callable, networks: Path) -> None:
    """No table of one row; the seconds are those of the whole command."""
    result = metapp("general", "brdf", networks / "m1", "--recipe", "quick", "--export", "merl,mitsuba,bsdf-spectral")
    assert result.code == 0, result.err
    error, seconds = re.fullmatch(
        rf"m1: error x100 (\d+\.\d{{3}}) \({re.escape(Brdf().error_measure.text)}\), (\d+\.\d) s in all\n", result.out
    ).groups()
    (fit,) = read_fits(Path("runs/brdf/general-quick"))
    assert error == f"{fit.error:.3f}"
    assert fit.seconds is not None
    assert float(seconds) + 0.05 >= fit.seconds
    folder = "runs/brdf/general-quick/m1"
    *_, merl, mitsuba, spectral, fits, view = result.err.splitlines()
    assert [merl, mitsuba] == [f"merl: {folder}/merl/m1.binary", f"mitsuba: {folder}/mitsuba/m1/m1.xml"]
    assert spectral == f"bsdf-spectral: {folder}/bsdf-spectral/m1_spec.bsdf"
    assert [fits, view] == [f"fits: {folder}", f"to look at: metapp view {folder}"]
    assert metapp("export", folder, "nbrdf").err.splitlines()[-1] == f"written as nbrdf: {folder}/nbrdf/m1"
    several = metapp(
        "general", "brdf", *(networks / f"m{i}" for i in range(6)), "--recipe", "quick", "--export", "merl"
    )
    assert says(several.out, "mean error")
    assert says(several.err, "merl: 6 files", "runs/brdf/general-quick/m0/merl/m0.binary")


def test_a_name_that_begins_with_a_dash_is_no_option(metapp: Callable, networks: Path) -> None:
    for name in ("-m1", "-out.csv", "--m1"):
        shutil.copytree(networks / "m1", name)
        for words in (("general", "brdf", name), ("view", name), ("export", name, "merl"), ("data", "check", name)):
            assert says(metapp(*words).misuse, f"{name}: ", f"./{name}")
    options = ("--recipe", "quick", "--quiet")
    for words in (("./-m1", *options), (*options, "--", "-m1"), (networks / "m1", *options, "--out", "-m1")):
        assert metapp("general", "brdf", *words).code == 0, words
    Path("-q").mkdir()
    assert metapp("general", "brdf", networks / "m1", "--recipe", "quick", "-q").code == 0  # it is an option


def test_json_is_one_object_as_scripts_rely_on_it(fit: Callable) -> None:
    result = fit("meta", "--rule", "meta-sgd", *STEPS, "--json", "--quiet")
    document = result.json_document
    assert len(result.out.splitlines()) == 1
    keys = ["app", "paradigm", "rule", "steps", "device", "data", "error", "seconds", "tasks", "out"]
    assert sorted(document) == sorted([*keys, "guarded", "failures", "scale", "tasks_per_second"])
    assert document["scale"] == Brdf().error_measure.scale
    assert (document["app"], document["paradigm"], document["rule"]) == ("brdf", "meta", "meta-sgd")
    assert document["steps"] == 10
    assert sorted(document["tasks"][0]) == ["error", "folder", "name", "note", "seconds"]  # it reflects more than all
    assert document["error"] == pytest.approx(np.mean([task["error"] for task in document["tasks"]]))
    assert Path(document["out"]).is_dir()


def test_a_table_compares_the_entries_of_a_checkpoint(fit: Callable, metapp: Callable, ten_materials: Path) -> None:
    trained = {paradigm: fit(paradigm, *STEPS, "--json") for paradigm in ("general", "quickft", "meta")}
    (checkpoint,) = Path("runs/brdf/checkpoints").iterdir()
    table = ("evaluate", "brdf", "--which", "quickft", "--data", ten_materials, "--json")
    ships, own_rows = (metapp(*table, *more).json_result["rows"] for more in ((), ("--checkpoint", checkpoint)))
    found = {row["paradigm"]: row["error"] for row in own_rows}
    means = {name: sum(errors_of(result)) / 2 for name, result in trained.items()}
    assert {name: found[name] for name in means} == pytest.approx(means)
    assert found != {row["paradigm"]: row["error"] for row in ships}
    both = metapp("evaluate", "brdf", "texture", "--checkpoint", checkpoint)
    assert says(both.misuse, str(checkpoint), "2 applications", "one APP")


def test_interrupted_runs_lose_nothing_and_go_on(fit: Callable, monkeypatch: pytest.MonkeyPatch, short: Recipe) -> None:
    calls = []

    class Interrupted(Brdf):
        def errors(self, theta: Params, tasks: Tasks) -> dict[str, torch.Tensor]:
            calls.append(tasks.names)
            if len(calls) in (2, 4):
                raise KeyboardInterrupt
            return super().errors(theta, tasks)

    monkeypatch.setitem(RECIPES, "quick", replace(short, app=Interrupted(short.app.network)))
    result = fit("overfit")
    assert result.code == 130
    assert says(result.err, "interrupted", "--resume")
    (run,) = (file.parents[1] for file in Path("runs").rglob(RECORD))
    (kept,) = read_fits(run)
    assert says(fit("overfit", "--resume").err, "1 of 2 inputs", "skipped")
    first, second = read_fits(run)
    assert first == kept
    assert second.name == "m9"
    assert calls == [("m4",), ("m9",), ("m9",)]
    assert fit("overfit").code == 130  # run again, without --resume
    assert read_fits(run) == [first, second]
    assert says(fit("overfit").err, "2 of 2 fits", "replace", "--resume")


# What is refused: test_cli_messages.py has a table of each kind of message


def refuse(result: CommandResult, *parts: str) -> None:
    assert result.out == ""
    assert all(part in result.error for part in parts), result.err


def test_parameters_that_are_not_finite_are_an_error(
    metapp: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch, short: Recipe
) -> None:
    class Infinite(Brdf):
        def init(self, rng: torch.Generator, count: int) -> Params:
            return {key: value / 0 for key, value in super().init(rng, count).items()}

    monkeypatch.setitem(RECIPES, "quick", replace(short, app=Infinite(short.app.network)))
    error = metapp("overfit", "brdf", networks / "m1", "--steps", "0", "--recipe", "quick").error
    assert says(error, "m1: ", "not finite")
    assert not list(Path("runs").rglob("*.jsonl"))


@pytest.mark.long
def test_a_fit_imports_no_library_of_figures_and_ends_quietly() -> None:
    """Each takes as long to import as most fits; bindings of pictures must not be told of as garbage at the end."""
    lines = (
        "import gc, sys",
        "from metapp.cli.command_process import pause_garbage_collection",
        "with pause_garbage_collection():",
        "    import metapp.runs.keeping",
        "import metapp.apps.illumination, metapp.apps.svbrdf_nonstationary, metapp.apps.texture, OpenImageIO",
        "print(gc.isenabled(), gc.get_freeze_count() > 100_000)",
        "print({'matplotlib', 'scipy', 'torchmetrics', 'mitsuba', 'colour'} & sys.modules.keys())",
    )
    process = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout, process.stderr) == (0, "True True\nset()\n", "")


def test_records_state_the_albedo_of_brdfs(fit: Callable) -> None:
    done = fit("meta", "--conserve", "--json")
    assert done.code == 0, done.err
    record = read_fits(Path(done.json_document["out"]))[0]
    assert len(record.figures["albedo"]) == 16
    assert max(record.figures["albedo"]) <= 1
    assert "-conserve" in done.json_document["out"]
