"""Attacks on the command line: whatever is wrong with files, names or streams is one line, and nothing is lost."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from metapp.apps.brdf import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.cli.console import LONGEST, one_line
from metapp.learning.app import stack
from metapp.learning.recipe import Adam
from metapp.learning.task import Task
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.fits import warnings_of
from metapp.runs.plan import plan
from metapp.runs.request import Request
from metapp.storage.records import load_checkpoint, read_records, save_checkpoint
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
def data(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "set")


@pytest.fixture
def fit(metapp: Callable, tmp_path: Path) -> Callable:
    def call(paradigm: str, *arguments: str | Path):
        return metapp(paradigm, "brdf", *arguments, "--out", tmp_path / "runs", "--quiet")

    return call


def is_one_line(error: str) -> bool:
    lines = error.splitlines()
    return len(lines) == 1 and lines[0].startswith("error: ") and len(lines[0]) <= LONGEST and "Traceback" not in error


# Shards


def cut(data: dict) -> dict:
    return {key: value for key, value in data.items() if key != "render"}


MISSHAPED = {
    "missing": (cut, "'render' is missing"),
    "flat": (lambda data: data | {"angles": data["angles"].flatten()}, "'angles' is float32 [1536]"),
    "shorter": (lambda data: data | {"angles": data["angles"][:100].contiguous()}, "'reflectance' is float32 [512, 3]"),
    "empty": (lambda data: data | {"angles": torch.zeros(0, 3)}, "'angles' is float32 [0, 3]"),
    "bytes": (lambda data: data | {"angles": data["angles"].to(torch.uint8)}, "'angles' is uint8"),
    "eight bits": (lambda data: data | {"angles": data["angles"].to(torch.float8_e4m3fn)}, "float8_e4m3fn"),
    "negative": (lambda data: data | {"reflectance": -1 - data["reflectance"]}, "expected 0 to inf"),
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
    fitted = fit("overfit", "--data", data)
    assert fitted.code == 1
    assert is_one_line(fitted.err)
    assert said in fitted.err
    assert file.name in fitted.err


def test_a_set_of_an_unknown_application_is_one_line(metapp: Callable, data: Path) -> None:
    manifest = data / "manifest.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"app": "../brdf"}))
    assert is_one_line(metapp("data", "check", data).err)


def test_what_applications_draw_is_what_they_hold(metapp: Callable, tmp_path: Path) -> None:
    for name in ("texture", "svbrdf_stationary", "svbrdf_nonstationary", "illumination"):
        assert metapp("data", "synth", name, "--count", "2", "--out", tmp_path / name, "--quiet").code == 0
        assert metapp("data", "check", tmp_path / name).code == 0


# Two writers

SLOW_WRITER = """
import sys, time, torch
from pathlib import Path
from metapp.storage.shards import ShardWriter
from metapp.learning.task import Task
with ShardWriter(Path(sys.argv[1]), "brdf", {"x": "1"}) as writer:
    writer.add(Task("slow", {"x": torch.ones(2)}), "train")
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def writing(tmp_path: Path):
    """Another program that is writing a data set to the folder `set`."""
    folder = tmp_path / "set"
    program = subprocess.Popen([sys.executable, "-c", SLOW_WRITER, str(folder)], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    assert program.stdout.readline() == "writing\n"
    yield folder, program
    program.kill()
    program.wait()


def test_a_second_writer_is_refused_and_a_killed_one_forgotten(metapp: Callable, network: Path, writing: tuple) -> None:
    folder, program = writing
    words = ("data", "nbrdf", network, "--out", folder, "--samples", "64", "--quiet")
    refused = metapp(*words)
    assert refused.code == 1
    assert is_one_line(refused.err)
    assert "another program is writing data there" in refused.err
    program.send_signal(signal.SIGKILL)
    program.wait()
    assert metapp(*words).code == 0
    assert metapp("data", "check", folder).code == 0


# Starts


def broken(path: Path, **changes: dict) -> Path:
    """The rule meta-adam's start that ships, with other tensors: None takes one away."""
    start, info = load_checkpoint(SHIPPED / "brdf" / "meta-adam.safetensors")
    parts = {
        name: {k: v for k, v in (getattr(start, name) | new).items() if v is not None} for name, new in changes.items()
    }
    save_checkpoint(path, start._replace(**parts), info)
    return path


STARTS = {
    "alpha missing": ({"alpha": {"rate.w1": None}}, "alpha rate.w1 is missing"),
    "alpha misshaped": ({"alpha": {"rate.w1": torch.ones(1, 3)}}, "alpha rate.w1 is (steps, 3)"),
    "alpha scalar": ({"alpha": {"rate.w1": torch.ones(())}}, "alpha rate.w1 is ()"),
    "alpha more": ({"alpha": {"beta3": torch.ones(10)}}, "alpha beta3 is (10), expected missing"),
    "theta missing": ({"theta": {"w1": None}}, "theta w1 is missing"),
    "theta misshaped": ({"theta": {"w1": torch.ones(4, 4)}}, "theta w1 is (4, 4)"),
    "encoder": ({"encoder": {"in.w": torch.ones(2)}}, "encoder in.w is (2)"),
}


@pytest.mark.parametrize(("changes", "said"), STARTS.values(), ids=STARTS)
def test_starts_of_other_rules_or_sizes_are_one_line(
    fit: Callable, network: Path, tmp_path: Path, changes: dict, said: str
) -> None:
    result = fit("meta", network, "--rule", "meta-adam", "--checkpoint", broken(tmp_path / "s.safetensors", **changes))
    assert result.code == 1
    assert is_one_line(result.err)
    assert said in result.err
    assert "s.safetensors" in result.err


@pytest.mark.parametrize("changes", [{"app": ["brdf"]}, {"app": {"a": 1}}, {"start": ["meta-sgd"]}, {"start": None}])
def test_odd_descriptions_of_starts_are_one_line(fit: Callable, network: Path, tmp_path: Path, changes: dict) -> None:
    start, info = load_checkpoint(SHIPPED / "brdf" / "meta-sgd.safetensors")
    path = tmp_path / "s.safetensors"
    save_checkpoint(path, start, info | changes)
    result = fit("meta", network, "--rule", "meta-sgd", "--checkpoint", path)
    assert result.code == 1
    assert is_one_line(result.err)


def test_a_start_of_another_application_is_one_line(fit: Callable, network: Path) -> None:
    for name in ("texture/meta-basis", "illumination/general", "brdf/general", "brdf/quickft"):
        assert is_one_line(fit("meta", network, "--checkpoint", SHIPPED / f"{name}.safetensors").err)


# Names


@pytest.mark.parametrize(
    "name", ["x" * 230, "a\nb", "\x1b[31mred", "日" * 80, b"caf\xe9".decode(errors="surrogateescape")]
)
def test_files_of_any_name_are_fitted(fit: Callable, network: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(network, tmp_path / name)
    result = fit("overfit", tmp_path / name, "--steps", "2", "--export", "nbrdf", "--json")
    assert result.code == 0
    (task,) = result.document["tasks"]
    assert task["name"].isprintable()
    folder = Path(result.document["out"])
    assert [record["name"] for record in read_records(folder / "record.jsonl")] == [task["name"]]
    assert len(list((folder / "params").iterdir())) == len(list((folder / "nbrdf").iterdir())) == 1


def test_a_picture_of_an_odd_name_is_drawn(metapp: Callable, network: Path, tmp_path: Path) -> None:
    shutil.copytree(network, tmp_path / "a\nb$x$")
    result = metapp("overfit", "brdf", tmp_path / "a\nb$x$", "--steps", "2", "--out", tmp_path / "runs")
    assert result.code == 0
    assert list((tmp_path / "runs").rglob("pictures.png"))


def test_messages_are_one_short_line(metapp: Callable, tmp_path: Path) -> None:
    assert is_one_line(metapp("data", "check", tmp_path / "a\nb\x1b[31m").err)
    assert is_one_line(metapp("data", "check", "/".join(["x" * 200] * 10)).err)
    assert is_one_line(metapp("overfit", "brdf", "y" * 5000).err)
    assert one_line("a\nb\t\x1b\udce9") == "a\\nb\\t\\x1b\\udce9"
    long = one_line("gold.binary: " + "x" * 5000 + "; download it again.")
    assert len(long) <= LONGEST
    assert long.startswith("gold.binary: ")
    assert long.endswith("; download it again.")


# Streams


# one import of what takes long and looks at no stream; then a fork for each, which ends as a program of its own does
IN_FORKS = """
import json, os, sys
import metapp.apps.brdf, metapp.runs.convert, metapp.runs.embedded, rich.progress, torch, typer
NAMES, (cases, folder, *words) = ("stdin", "stdout", "stderr"), sys.argv[1:]
codes = []
for number, (more, streams) in enumerate(json.loads(cases)):
    child = os.fork()
    if not child:
        os.dup2(os.open(f"{folder}/{number}", os.O_WRONLY | os.O_CREAT), 2)
        for at, file in streams.items():
            if file:
                os.dup2(os.open(file, os.O_WRONLY), int(at))
            else:  # what Python does about a closed stream when it starts
                os.close(int(at))
                setattr(sys, NAMES[int(at)], None)
                setattr(sys, f"__{NAMES[int(at)]}__", None)
        break
    codes.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
else:
    print(json.dumps(codes))
    sys.exit()
from metapp.cli import main
sys.argv = ["metapp", *words, *more]
main()
"""
FULL = "/dev/full"


# words, streams by number (closed where they have no file), the exit code, lines on standard error
STREAMS: list[tuple[list[str], dict[int, str], int, int]] = [
    ([], {1: ""}, 0, 0),
    ([], {2: ""}, 0, 0),
    ([], {0: "", 1: "", 2: ""}, 0, 0),
    (["--json"], {1: ""}, 1, 1),
    (["--json"], {1: FULL}, 1, 1),
    ([], {1: FULL}, 1, 1),
    ([], {2: FULL}, 0, 0),
]


def test_closed_and_full_streams(data: Path, tmp_path: Path) -> None:
    cases, said = json.dumps([(more, streams) for more, streams, *_ in STREAMS]), tmp_path / "said"
    said.mkdir()
    words = [sys.executable, "-c", IN_FORKS, cases, said, "data", "check", data]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    errors = [(said / str(number)).read_text() for number in range(len(STREAMS))]
    assert json.loads(done.stdout.splitlines()[-1]) == [code for *_, code, _ in STREAMS], errors
    assert [len(each.splitlines()) for each in errors] == [lines for *_, lines in STREAMS]
    assert "Traceback" not in "".join(errors)


# Whatever nobody foresaw


@pytest.mark.parametrize("error", [KeyError("w1"), TypeError("a\nb" * 200), RecursionError(), RuntimeError("x" * 5000)])
def test_what_nobody_foresaw_is_one_line_that_asks_for_a_report(
    fit: Callable, network: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(Brdf, "prepare", staticmethod(fail))
    result = fit("overfit", network, "--steps", "2")
    assert result.code == 1
    assert is_one_line(result.err)
    assert type(error).__name__ in result.err
    assert "please report it" in result.err
    monkeypatch.setenv("METAPP_TRACEBACK", "1")
    with pytest.raises(type(error)):
        fit("overfit", network, "--steps", "2")


# Records


def test_a_bad_record_is_said_and_its_task_fitted_again(fit: Callable, network: Path, data: Path) -> None:
    fit("overfit", "--data", data, "--steps", "2")
    (file,) = data.parent.rglob("record.jsonl")
    record = json.loads(file.read_text())
    file.write_text(json.dumps(record | {"error": "much"}) + "\n")
    again = fit("overfit", "--data", data, "--steps", "2", "--json")
    assert again.code == 0
    assert "record.jsonl: line 1: no record" in again.err
    assert again.document["tasks"][0]["error"] == pytest.approx(record["error"])


def test_records_say_the_threads(fit: Callable, network: Path, tmp_path: Path) -> None:
    assert fit("overfit", network, "--steps", "2").code == 0
    (file,) = (tmp_path / "runs").rglob("record.jsonl")
    (record,) = read_records(file)
    assert record["threads"] == torch.get_num_threads()
    assert "threads" not in record["settings"]
    assert "warning" not in record


def test_a_fit_that_leaves_what_it_sees_worse_than_its_start_is_told(
    fit: Callable, network: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(RECIPES[""], "quick", replace(RECIPES[""]["quick"], overfit=Adam(1.0)))
    result = fit("overfit", network, "--steps", "2", "--recipe", "quick")
    assert result.code == 0
    assert "warning: m0: the visible loss rose from" in result.err
    (file,) = (tmp_path / "runs").rglob("record.jsonl")
    assert read_records(file)[0]["warning"].startswith("the visible loss rose from ")


def test_a_fit_that_gets_better_is_not_warned_of(network: Path, rng: torch.Generator) -> None:
    task = Task("gold", {"angles": torch.rand(64, 3, generator=rng), "reflectance": torch.rand(64, 3, generator=rng)})
    stacked, by = stack(Brdf(), [task]), find_checkpoint(plan(Request("brdf", "overfit", recipe="quick", steps=50)))

    def draws() -> torch.Generator:
        return torch.Generator().manual_seed(1)

    theta = by.paradigm.fit(by.job, by.prepared, stacked, draws())
    assert warnings_of(by, stacked, theta, draws()) == [""]
    assert warnings_of(replace(by, job=by.job._replace(steps=0)), stacked, theta, draws()) == [""]
