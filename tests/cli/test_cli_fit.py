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
from safetensors.torch import load_file, save_file

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.learning.recipe import Adam, Recipe
from metapp.learning.task import Params, Tasks
from metapp.registry import registry
from metapp.storage.checkpoint_files import load_checkpoint
from metapp.storage.files import file_digest
from metapp.storage.fit_records import FitRecord
from metapp.storage.fit_store import RECORD, FitStore, read_fit_records, read_params
from metapp.storage.folders import MARKER
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
        merl = replace(registry().applications["brdf"].exports["merl"], reference=f"{__name__}:write_to_a_full_disk")
        monkeypatch.setitem(registry().applications["brdf"].exports.data, "merl", merl)
    else:
        for name in ("m4", "m9"):
            (folder / name / "merl").touch()
    result = fit("general", *STEPS, "--export", "merl,nbrdf")
    assert result.code == 1
    output = " ".join(result.err.split())
    for name in ("m4", "m9"):
        assert (
            f"{folder}/{name}/merl/{name}: not written as merl: {'No space left' if full else 'File exists'}" in output
        )
        assert (folder / name / "nbrdf" / name).is_dir()
        assert read_params(folder / name)
    assert "error: 2 exports were not written; all fits are kept." in output
    assert "inputs were not fitted" not in output
    assert [record.name for record in read_fit_records(folder)] == ["m4", "m9"]


@pytest.mark.parametrize(("number", "fitted"), [(errno.ENOSPC, 1), (errno.EACCES, 3)])
def test_a_fit_that_cannot_be_written_leaves_the_others_and_the_report(
    metapp: Callable, write_nbrdf_networks: Callable, monkeypatch: pytest.MonkeyPatch, number: int, fitted: int
) -> None:
    """The second of four fits is not written: a full disk ends the fits, a folder without rights ends none."""
    write_fit, records = FitStore.write, []

    def write(store: FitStore, record: FitRecord, *arguments: Any) -> FitRecord:
        records.append(record)
        if len(records) == 2:
            raise OSError(number, os.strerror(number))
        return write_fit(store, record, *arguments)

    monkeypatch.setattr(FitStore, "write", write)
    result = metapp("general", "brdf", write_nbrdf_networks(4), "--json")
    assert result.code == 1
    assert len(result.json_document["tasks"]) == fitted
    reasons = [failure["reason"] for failure in result.json_document["failures"]]
    assert os.strerror(number) in reasons[0]
    assert ["not fitted, since the disk is full" in reason for reason in reasons[1:]] == [True] * (3 - fitted)


def test_a_fit_prints_a_table_and_leaves_its_files(fit: Callable) -> None:
    result = fit("overfit", "--steps", "40")
    assert result.code == 0
    assert "m4" in result.out
    assert "mean error" in result.out
    assert "from a random initialisation" in result.err
    (folder,) = Path("runs/brdf").iterdir()
    assert folder.name.startswith("overfit-materials-")
    assert f"fits: {folder}" in result.err
    assert f"to look at: metapp view {folder}" in result.err
    records = read_fit_records(folder)
    assert [record.name for record in records] == ["m4", "m9"]
    assert all(record.settings.adam and record.settings.adam["rate"] > 0 for record in records)
    assert records[0].settings.steps == 40
    assert records[0].settings.versions["torch"] == str(torch.__version__)
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
    (record,) = read_fit_records(Path("runs/brdf/general-quick"))
    assert error == f"{record.error:.3f}"
    assert record.seconds is not None
    assert float(seconds) + 0.05 >= record.seconds
    folder = "runs/brdf/general-quick/m1"
    *_, merl, mitsuba, spectral, fits, view = result.err.splitlines()
    assert [merl, mitsuba] == [f"merl: {folder}/merl/m1.binary", f"mitsuba: {folder}/mitsuba/m1/m1.xml"]
    assert spectral == f"bsdf-spectral: {folder}/bsdf-spectral/m1_spec.bsdf"
    assert [fits, view] == [f"fits: {folder}", f"to look at: metapp view {folder}"]
    assert metapp("export", folder, "nbrdf").err.splitlines()[-1] == f"written as nbrdf: {folder}/nbrdf/m1"
    several = metapp(
        "general", "brdf", *(networks / f"m{i}" for i in range(6)), "--recipe", "quick", "--export", "merl"
    )
    assert "mean error; other columns: median" in several.out
    assert "merl: 6 files, the first is runs/brdf/general-quick/m0/merl/m0.binary" in several.err


def test_an_empty_word_is_no_folder_and_no_value(metapp: Callable, networks: Path) -> None:
    """A shell makes it of a variable that is not set; it would be read as the current folder."""
    assert "an empty word, expected a file or a value" in metapp("general", "brdf", "").misuse
    for words in (("--export", ""), ("--out=",), ("", networks / "m1")):
        assert "an empty word after" in metapp("general", "brdf", networks / "m1", *words).misuse


def test_a_data_set_that_is_not_there_is_refused_beside_inputs(metapp: Callable, networks: Path) -> None:
    assert "typo: no such folder" in metapp("general", "brdf", networks / "m1", "--data", "typo").refusal


def test_a_name_that_begins_with_a_dash_is_no_option(metapp: Callable, networks: Path) -> None:
    for name in ("-m1", "-out.csv", "--m1"):
        shutil.copytree(networks / "m1", name)
        for words in (("general", "brdf", name), ("view", name), ("export", name, "merl"), ("data", "check", name)):
            assert f"{name}: a file whose name begins with a dash, which would be read as options; write ./{name}." in (
                metapp(*words).misuse
            )
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


def test_a_trained_checkpoint_is_used_where_it_is_named(fit: Callable) -> None:
    """The option names its file or folder.

    Without it, fits begin at the checkpoint that ships, whatever was trained here.
    """
    ships = fit("general", "--json")
    trained = fit("general", *STEPS, "--json")
    (checkpoint,) = Path("runs/brdf/checkpoints").rglob("general.safetensors")
    assert errors_of(fit("general", "--json")) == errors_of(ships) != errors_of(trained)
    for named in (checkpoint, checkpoint.parent):
        again = fit("general", "--json", "--checkpoint", named)
        assert str(checkpoint) in again.err
        assert errors_of(again) == errors_of(trained)
    assert fit("finetune", "--json", "--checkpoint", checkpoint.parent).json_document["steps"] == 5
    refuse(fit("meta", "--checkpoint", checkpoint.parent), "holds general, expected meta-curvature.safetensors")
    assert load_checkpoint(checkpoint)[1]["training"]["steps"] == 3
    fit("general", *STEPS)
    assert not checkpoint.with_suffix(".previous.safetensors").exists()  # it would be the same
    fit("general", *STEPS[:-1], "4")
    assert load_checkpoint(checkpoint.with_suffix(".previous.safetensors"))[1]["training"]["steps"] == 3
    result = fit("general", "--checkpoint", checkpoint.rename("mine.safetensors"))
    assert result.code == 0
    assert "mine.safetensors" in result.err


def test_a_table_compares_the_checkpoints_of_a_folder(fit: Callable, metapp: Callable, ten_materials: Path) -> None:
    trained = {paradigm: fit(paradigm, *STEPS, "--json") for paradigm in ("general", "quickft", "meta")}
    (folder,) = Path("runs/brdf/checkpoints").iterdir()
    table = ("evaluate", "brdf", "--which", "quickft", "--data", ten_materials, "--json")
    ships, own_rows = (metapp(*table, *more).json_result["rows"] for more in ((), ("--checkpoint", folder)))
    found = {row["paradigm"]: row["error"] for row in own_rows}
    means = {name: sum(errors_of(result)) / 2 for name, result in trained.items()}
    assert {name: found[name] for name in means} == pytest.approx(means)
    assert found != {row["paradigm"]: row["error"] for row in ships}
    both = metapp("evaluate", "brdf", "texture", "--checkpoint", folder)
    assert (both.code, "expected one APP and the folder" in " ".join(both.err.split())) == (2, True)


@pytest.mark.parametrize(("paradigm", "rule"), [("general", "general"), ("meta", "meta-sgd")])
def test_a_training_goes_on_from_a_checkpoint(fit: Callable, paradigm: str, rule: str) -> None:
    """Outer steps go on where those of the checkpoint ended, and fits use the result."""
    named = () if paradigm == "general" else ("--rule", rule)
    first = fit(paradigm, *named, *STEPS, "--json")
    assert first.code == 0, first.err
    (kept,) = Path("runs/brdf/checkpoints").rglob(f"{rule}.safetensors")
    kept = kept.rename("mine.safetensors")
    more = fit(paradigm, *named, *STEPS, "--checkpoint", kept, "--json")
    assert more.code == 0, more.err
    assert "going on from mine.safetensors" in more.err
    (path,) = Path("runs/brdf/checkpoints").rglob(f"{rule}.safetensors")
    (_, then), (_, info) = load_checkpoint(kept), load_checkpoint(path)
    assert info["first"] == file_digest(kept)
    assert info["curve"][0][2] == pytest.approx(then["validation_error"], rel=1e-4)
    assert info["validation_error"] <= then["validation_error"]
    assert str(path) in more.err


def test_a_training_begins_at_the_general_that_is_named(fit: Callable) -> None:
    fit("general", *STEPS)
    (kept,) = Path("runs/brdf/checkpoints").rglob("general.safetensors")
    kept = kept.rename("mine.safetensors")
    for paradigm in ("quickft", "meta"):
        result = fit(paradigm, *STEPS, "--checkpoint", kept)
        assert (result.code, "General: mine.safetensors" in result.err) == (0, True)
    assert not list(Path("runs/brdf/checkpoints").rglob("general.safetensors"))
    (tuned,) = Path("runs/brdf/checkpoints").rglob("quickft.safetensors")
    refuse(fit("quickft", "--train", "--checkpoint", tuned), "expected the General that an Adam is searched for")
    folder = fit("quickft", "--train", "--checkpoint", tuned.parent)
    assert (folder.code, "with --train name a file in it" in folder.err) == (2, True)


def test_quickft_is_tuned_for_its_encoder(fit: Callable, monkeypatch: pytest.MonkeyPatch, short: Recipe) -> None:
    # a recipe that moves too far, and a search that looks at one other
    monkeypatch.setitem(RECIPES, "quick", replace(short, quickft=Adam(1.0), search=([{"beta1": 0.3, "rate": 1e-7}],)))
    assert fit("general", *STEPS).code == 0
    (general,) = Path("runs/brdf/checkpoints").rglob("general.safetensors")
    assert "no Adam was tuned" in fit("quickft", "--checkpoint", general).err
    tuned = fit("quickft", "--train", "--checkpoint", general, "--json")
    assert errors_of(fit("quickft", "--checkpoint", general.parent, "--json")) == errors_of(tuned)
    assert tuned.code == 0
    assert "tuned Adam" in tuned.err
    record = read_fit_records(Path(tuned.json_document["out"]))[-1]
    assert record.settings.adam is not None
    assert record.settings.adam["beta1"] == 0.3  # the tuned one, not the recipe's


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
    assert "interrupted; the same command with --resume fits only the inputs that have no fit yet." in result.err
    (run,) = (file.parents[1] for file in Path("runs").rglob(RECORD))
    (kept,) = read_fit_records(run)
    assert "1 of 2 inputs are skipped, since they have a fit by equal settings" in fit("overfit", "--resume").err
    first, second = read_fit_records(run)
    assert first == kept
    assert second.name == "m9"
    assert calls == [("m4",), ("m9",), ("m9",)]
    assert fit("overfit").code == 130  # run again, without --resume
    assert read_fit_records(run) == [first, second]
    assert "2 of 2 fits and their pictures replace earlier ones; --resume keeps earlier fits" in fit("overfit").err


def test_meta_on_own_data_starts_from_a_general_of_this_data(fit: Callable) -> None:
    """A General of equal settings is not trained again, and one of other settings is not replaced."""
    result = fit("meta", *STEPS)
    assert "no General ships for this data: training it first, 3 steps" in result.err
    (general,) = Path("runs/brdf/checkpoints").rglob("general.safetensors")
    before = general.stat().st_mtime_ns
    assert "training it first" not in fit("quickft", *STEPS).err
    assert general.stat().st_mtime_ns == before
    refuse(fit("meta", *STEPS[:-1], "2"), "a General that was trained by other settings; begin at it with --checkpoint")
    assert general.stat().st_mtime_ns == before


# What is refused, each with its exit code and one line


MISUSED = """
meta --rule meta-magic                 | meta-magic ; meta-sgd
meta --recipe slow                     | slow ; quick
meta --observe photo                   | --observe
meta --export blend                    | blend ; nbrdf
meta --steps -1                        | --steps ; 0
meta --steps ten                       | --steps ; integer
meta --batch 0                         | --batch
meta --device tpu                      | tpu ; cuda
meta --train-steps 5                   | --train
overfit --seed -1                      | --seed
evaluate --which nothing               | nothing ; results
evaluate --format word                 | word ; markdown
evaluate --recipe slow                 | slow ; quick
meta --rule meta-lgd                   | rule 'meta-lgd': its part network does not apply to brdf: no parameter
meta --rule meta-curvatur              | Did you mean 'meta-curvature'?
overfit --steps 99999999999999999999   | --steps 99999999999999999999: expected 0 to 1,000,000,000
general --train --train-steps 99999999999999999999 | --train-steps 99999999999999999999: expected 1 to 1,000,000,000
"""
MISUSED_ELSEWHERE = """
meta brdfs                             | brdfs ; expected one of brdf ; Did you mean 'brdf'?
mta                                    | Did you mean 'meta'?
meta texture --export png61            | Did you mean 'png16'?
meta illumination --rule meta-basis    | its part average does not apply to illumination
data synth brdf --seed 99999999999999999999        | '--seed': Input should be less than or equal to 92233720368547758
data nbrdf m --out set --samples 99999999999999999 | --samples 99999999999999999: expected 2 to 10,000,000
"""


def test_wrong_options_are_refused(metapp: Callable, fit: Callable) -> None:
    for table, call in ((MISUSED, fit), (MISUSED_ELSEWHERE, metapp)):
        for words, parts in (line.split("|") for line in table.strip().splitlines()):
            misuse = call(*words.split()).misuse
            assert all(part.strip() in misuse for part in parts.split(" ; ")), (words, misuse)
    for words in (
        ("meta", "zzzz"),
        ("zzzz",),
        ("meta", "brdf", "--rule", "zzzz"),
        ("meta", "texture", "--export", "zzzz"),
    ):
        assert "Did you mean" not in metapp(*words).misuse


def refuse(result: CommandResult, *parts: str) -> None:
    assert result.out == ""
    assert all(part in result.error for part in parts), result.err


REFUSED = """
overfit none.binary                      | none.binary: no such file
overfit text.binary                      | text.binary: 14 bytes, expected 34,992,012
overfit photo.png                        | photo.png: not an input of brdf ; MERL ; one of ; svbrdf_stationary, texture.
overfit folder                           | folder: not an input of brdf
overfit --data none                      | none
overfit --data train                     | 0 test tasks
general --train --train-steps 3 --data test | 0 tasks
general --checkpoint none.safetensors    | no such checkpoint
general --checkpoint broken.safetensors  | not a checkpoint
general --checkpoint foreign.safetensors | not a checkpoint
meta --checkpoint general.safetensors    | a checkpoint of brdf general, expected brdf meta-curvature
meta --recipe paper --rule meta-encoder  | no checkpoint ; --train
meta --rule meta-average                 | brdf meta-average, recipe quick: no checkpoint ; --train
"""


def test_bad_files_are_refused(fit: Callable, metapp: Callable, networks: Path) -> None:
    Path("folder").mkdir()
    for name, content in {"text.binary": b"not a material", "photo.png": b"\x89PNG", "folder/notes.txt": b""}.items():
        Path(name).write_bytes(content)
    Path("broken.safetensors").write_bytes(b"broken")
    save_file({"x": torch.zeros(2)}, "foreign.safetensors")
    for split in ("train", "test"):
        metapp("data", "nbrdf", networks / "m1", "--out", split, "--split", split, "--samples", "512")
    fit("general", *STEPS)
    next(Path("runs").rglob("general.safetensors")).rename("general.safetensors")
    for words, parts in (line.split(" | ") for line in REFUSED.strip().splitlines()):
        refuse(fit(*words.split()), *map(str.strip, parts.split(" ; ")))


def test_parameters_that_are_not_finite_are_an_error(
    metapp: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch, short: Recipe
) -> None:
    class Infinite(Brdf):
        def init(self, rng: torch.Generator, count: int) -> Params:
            return {key: value / 0 for key, value in super().init(rng, count).items()}

    monkeypatch.setitem(RECIPES, "quick", replace(short, app=Infinite(short.app.network)))
    error = metapp("overfit", "brdf", networks / "m1", "--steps", "0", "--recipe", "quick").error
    assert "m1: the fit's parameters are not finite" in error
    assert not list(Path("runs").rglob("*.jsonl"))


# Rules that ship without a checkpoint


def test_a_rule_without_a_checkpoint_is_trained_and_used(fit: Callable) -> None:
    """It is trained as the recipe's default rule is."""
    trained = fit("meta", "--rule", "meta-adam", *STEPS, "--json", "--quiet")
    assert trained.code == 0, trained.err
    assert trained.json_document["rule"] == "meta-adam"
    (path,) = Path("runs").rglob("meta-adam.safetensors")
    start, info = load_checkpoint(path)
    assert info["checkpoint"] == "meta-adam"
    assert info["training"]["clip"] == RECIPES["quick"].meta["meta-curvature"].clip
    assert {"rate", "beta1", "beta2", "loss"} == {name.partition(".")[0] for name in start.alpha}
    again = fit("meta", "--rule", "meta-adam", "--json", "--quiet", "--checkpoint", path.parent).json_document
    assert [task["error"] for task in again["tasks"]] == [task["error"] for task in trained.json_document["tasks"]]
    assert "meta-adam" in Path(again["out"]).name
    refuse(fit("meta", "--checkpoint", path), "expected brdf meta-curvature; add --rule meta-adam")


@pytest.mark.long
def test_a_fit_imports_no_library_of_figures_and_ends_quietly() -> None:
    """Each takes as long to import as most fits; bindings of pictures must not be told of as garbage at the end."""
    lines = (
        "import gc, sys",
        "from metapp.cli.command_process import pause_garbage_collection",
        "with pause_garbage_collection():",
        "    import metapp.runs.execution",
        "import metapp.apps.illumination, metapp.apps.svbrdf_nonstationary, metapp.apps.texture, OpenImageIO",
        "print(gc.isenabled(), gc.get_freeze_count() > 100_000)",
        "print({'matplotlib', 'scipy', 'torchmetrics', 'mitsuba', 'colour'} & sys.modules.keys())",
    )
    process = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout, process.stderr) == (0, "True True\nset()\n", "")


def test_records_state_the_albedo_of_brdfs(fit: Callable) -> None:
    done = fit("meta", "--conserve", "--json")
    assert done.code == 0, done.err
    record = read_fit_records(Path(done.json_document["out"]))[0]
    assert len(record.figures["albedo"]) == 16
    assert max(record.figures["albedo"]) <= 1
    assert "-conserve" in done.json_document["out"]
    refused = fit("meta", "--recipe", "few", "--conserve")
    assert refused.code == 2
    assert "expected a recipe of isotropic BRDFs, such as full or quick" in " ".join(refused.err.split())
