"""Attacks on the command line: whatever is wrong with files, names or streams is one line, and nothing is lost."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.cli.streams import LONGEST, one_line
from metapp.learning.recipe import Adam
from metapp.runs.fits import fitter
from metapp.storage.records import load_checkpoint, read_records, save_checkpoint
from tests.conftest import Result
from tests.small_spheres import run_small

pytestmark = pytest.mark.usefixtures("small_spheres")

SHIPPED = Path(__file__).parents[2] / "metapp" / "checkpoints"


@pytest.fixture(scope="module")
def network(neural_fits: Callable[[int], Path]) -> Path:
    return neural_fits(1) / "m0"


@pytest.fixture(scope="module")
def made(network: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of one small material, for tests to copy."""
    folder = tmp_path_factory.mktemp("attacks") / "set"
    run_small("data", "nbrdf", network, "--out", folder, "--samples", "512", "--split", "test")
    return folder


@pytest.fixture
def data(made: Path) -> Path:
    return shutil.copytree(made, Path("set"))


@pytest.fixture
def fit(metapp: Callable) -> Callable:
    return lambda paradigm, *arguments: metapp(paradigm, "brdf", *arguments, "--quiet")


def one(result: Result) -> str:
    """The one line, and no other, of a command that failed."""
    assert result.code == 1
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    assert len(line) <= LONGEST
    return line


# Shards


def cut(data: dict) -> dict:
    return {key: value for key, value in data.items() if key != "reflectance"}


MISSHAPED = {
    "missing": (cut, "'reflectance' is missing"),
    "eight bits": (lambda data: data | {"angles": data["angles"].to(torch.float8_e4m3fn)}, "float8_e4m3fn"),
    "NaN": (lambda data: data | {"reflectance": data["reflectance"] / 0}, "NaN or infinite"),
}


@pytest.mark.parametrize(("change", "said"), MISSHAPED.values(), ids=MISSHAPED)
def test_what_a_shard_lacks_is_said_by_the_check_and_by_fits(
    metapp: Callable, fit: Callable, data: Path, change: Callable, said: str
) -> None:
    (file,) = data.glob("*.safetensors")
    save_file(change(load_file(file)), file)
    checked = metapp("data", "check", data, "--json")
    assert checked.code == 1
    assert any(said in problem and file.name in problem for problem in checked.document["problems"])
    line = one(fit("overfit", "--data", data))
    assert said in line
    assert file.name in line


def test_a_set_of_an_unknown_application_is_one_line(metapp: Callable, data: Path) -> None:
    manifest = data / "manifest.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"app": "../brdf"}))
    assert one(metapp("data", "check", data))


def test_what_applications_draw_is_what_they_hold(metapp: Callable) -> None:
    for name in ("texture", "svbrdf_stationary", "svbrdf_nonstationary", "illumination"):
        assert metapp("data", "synth", name, "--count", "2", "--out", name, "--quiet").code == 0
        assert metapp("data", "check", name).code == 0


# Two writers

SLOW_WRITER = """
import sys, time, torch
from pathlib import Path
from typing import Any
from metapp.storage.shards import ShardWriter
from metapp.learning.task import Task
with ShardWriter(Path(sys.argv[1]), "brdf", {"x": "1"}) as writer:
    writer.add(Task("slow", {"x": torch.ones(2)}), "train")
    print("writing", flush=True)
    time.sleep(60)
"""


def test_a_second_writer_is_refused_and_a_killed_one_forgotten(metapp: Callable, network: Path) -> None:
    words = ("data", "nbrdf", network, "--out", "set", "--samples", "64", "--quiet")
    with subprocess.Popen([sys.executable, "-c", SLOW_WRITER, "set"], stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout
            assert program.stdout.readline() == "writing\n"
            assert "another program is writing data there" in one(metapp(*words))
        finally:
            program.kill()
    assert metapp(*words).code == 0
    assert metapp("data", "check", "set").code == 0


# Checkpoints


def written(name: str, changes: dict[str, Any]) -> Path:
    """A rule's checkpoint that ships, with another description or other tensors: None takes one away."""
    checkpoint, info = load_checkpoint(SHIPPED / "brdf" / f"{name}.safetensors")
    for part, new in changes.items():
        if part in checkpoint._fields:
            tensors = getattr(checkpoint, part) | new
            tensors = {key: value for key, value in tensors.items() if value is not None}
            checkpoint = checkpoint._replace(**{part: tensors})
        else:
            info = info | {part: new}
    save_checkpoint(Path("s.safetensors"), checkpoint, info)
    return Path("s.safetensors")


CHECKPOINTS: list[tuple[str, dict[str, Any], str]] = [
    ("meta-curvature", {"alpha": {"rate.w1": None}}, "alpha rate.w1 is missing"),
    ("meta-curvature", {"alpha": {"rate.w1": torch.ones(1, 3)}}, "alpha rate.w1 is (steps, 3)"),
    ("meta-curvature", {"alpha": {"rate.w1": torch.ones(())}}, "alpha rate.w1 is ()"),
    ("meta-curvature", {"alpha": {"beta3": torch.ones(10)}}, "alpha beta3 is (10), expected missing"),
    ("meta-curvature", {"theta": {"w1": None}}, "theta w1 is missing"),
    ("meta-curvature", {"theta": {"w1": torch.ones(4, 4)}}, "theta w1 is (4, 4)"),
    ("meta-curvature", {"encoder": {"in.w": torch.ones(2)}}, "encoder in.w is (2)"),
    ("meta-sgd", {"app": ["brdf"]}, ""),
    ("meta-sgd", {"app": {"a": 1}}, ""),
    ("meta-sgd", {"checkpoint": ["meta-sgd"]}, ""),
    ("meta-sgd", {"checkpoint": None}, ""),
]


def test_checkpoints_of_other_rules_sizes_or_applications_are_one_line(fit: Callable, network: Path) -> None:
    for rule, changes, said in CHECKPOINTS:
        line = one(fit("meta", network, "--rule", rule, "--checkpoint", written(rule, changes)))
        assert said in line, changes
        assert "s.safetensors" in line, changes
    for name in ("texture/meta-basis", "illumination/general", "brdf/general", "brdf/quickft"):
        assert one(fit("meta", network, "--checkpoint", SHIPPED / f"{name}.safetensors"))


# Names


def test_names_that_are_no_utf_8_are_text_in_json(metapp: Callable, network: Path) -> None:
    """Every document is UTF-8 without lone surrogates, which strict readers refuse; and paths are found again."""
    place = Path(b"caf\xe9".decode(errors="surrogateescape"))
    place.mkdir()
    for name in ("m0", "m1"):
        shutil.copytree(network, place / (place.name + name))
    words = ("brdf", place, "--recipe", "quick", "--json", "--quiet")
    runs = [metapp("meta", *words).done["out"], metapp("meta", *words, "--batch", "2").done["out"]]
    texts = [path.read_bytes() for path in Path("runs").rglob("*.jsonl")]
    texts += [metapp("compare", run, run, "--json").out.encode() for run in runs]
    texts += [metapp("meta", *words[:1], place / "none", "--batch", "2", *words[2:]).out.encode()]
    for text in texts:
        for line in text.splitlines():
            json.dumps(json.loads(line), ensure_ascii=False).encode()
    assert sum(rb"caf\\udce9" in text for text in texts) == 2
    assert metapp("compare", runs[0], runs[0], "--json").done["picture"]
    said = metapp("meta", *words[:-1], "--batch", "2").err
    assert "2 fitted before" in said


@pytest.mark.parametrize(
    "name", ["x" * 230, "a\nb$x$", "\x1b[31mred", "日" * 80, b"caf\xe9".decode(errors="surrogateescape")]
)
def test_files_of_any_name_are_fitted(fit: Callable, network: Path, name: str) -> None:
    shutil.copytree(network, Path(name))
    result = fit("overfit", Path(name), "--steps", "2", "--export", "nbrdf", "--json")
    assert result.code == 0
    (task,) = result.document["tasks"]
    assert task["name"].isprintable()
    folder = Path(result.document["out"])
    assert [record["name"] for record in read_records(folder / "record.jsonl")] == [task["name"]]
    assert (folder / "pictures.png").is_file()
    assert len(list((folder / "params").iterdir())) == len(list((folder / "nbrdf").iterdir())) == 1


def test_messages_are_one_short_line(metapp: Callable) -> None:
    for words in (("data", "check", "a\nb\x1b[31m"), ("data", "check", "/".join(["x" * 200] * 10))):
        assert one(metapp(*words))
    assert one(metapp("overfit", "brdf", "y" * 5000))
    assert one_line("a\nb\t\x1b\udce9") == "a\\nb\\t\\x1b\\udce9"
    long = one_line("gold.binary: " + "x" * 5000 + "; download it again.")
    assert len(long) <= LONGEST
    assert long.startswith("gold.binary: ")
    assert long.endswith("; download it again.")


# Whatever nobody foresaw


@pytest.mark.parametrize("error", [KeyError("w1"), TypeError("a\nb" * 200), RecursionError(), RuntimeError("x" * 5000)])
def test_what_nobody_foresaw_is_one_line_that_asks_for_a_report(
    fit: Callable, network: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(Brdf, "prepare", staticmethod(fail))
    line = one(fit("overfit", network, "--steps", "2"))
    assert type(error).__name__ in line
    assert "please report it" in line
    monkeypatch.setenv("METAPP_TRACEBACK", "1")
    with pytest.raises(type(error)):
        fit("overfit", network, "--steps", "2")


# Records


def test_records_say_the_threads_and_fits_that_end_worse_than_they_began(
    fit: Callable, network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def record(*words: str) -> tuple[Result, dict[str, Any]]:
        result = fit("overfit", network, "--steps", "2", "--json", *words)
        return result, read_records(Path(result.done["out"], "record.jsonl"))[-1]

    _, whole = record()
    assert whole["threads"] == torch.get_num_threads()
    assert "threads" not in whole["settings"]
    assert "warning" not in whole
    monkeypatch.setitem(RECIPES, "quick", replace(RECIPES["quick"], overfit=Adam(1.0)))
    result, worse = record("--recipe", "quick")
    assert "warning: m0: the visible loss rose from" in result.err
    assert worse["warning"].startswith("the visible loss rose from ")
    monkeypatch.setattr(fitter, "_rises", lambda *_: [["again"]])
    assert fit("overfit", network, "--steps", "2", "--json").done["tasks"][0]["warning"] == "again"
    assert "warning" not in fit("meta", network, "--json").done["tasks"][0]  # its guard compared them
