"""`- --json`: one process that stays warm answers each line of standard input by a line, whatever is wrong with it."""

from __future__ import annotations

import io
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from metapp.runs.fits import Fitter


@pytest.fixture(scope="module")
def networks(neural_fits: Callable[[int], Path]) -> Path:
    return neural_fits(3)


@pytest.fixture
def answers(metapp: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable:
    """`metapp meta brdf - --json` on lines: exit code, answers, standard error."""

    def call(*lines: str | Path, more: tuple[str, ...] = ()) -> tuple[int, list[dict], str]:
        text = b"".join(os.fsencode(f"{line}\n") for line in lines)
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text)))
        done = metapp("meta", "brdf", "-", "--json", "--quiet", "--out", tmp_path / "runs", *more)
        return done.code, [json.loads(line) for line in done.out.splitlines()], done.err

    return call


@pytest.mark.usefixtures("small_spheres")
def test_each_answer_is_that_of_the_command_alone(
    answers: Callable, metapp: Callable, networks: Path, tmp_path: Path
) -> None:
    code, found, errors = answers(networks / "m0", "", networks / "m2", more=("--recipe", "quick"))
    assert (code, errors) == (0, "")
    assert [answer["input"] for answer in found] == [str(networks / "m0"), str(networks / "m2")]
    for answer in found:
        told = ("--recipe", "quick", "--json", "--quiet", "--out", tmp_path / "runs")
        alone = metapp("meta", "brdf", answer.pop("input"), *told).document
        for document in (answer, alone):
            del document["seconds"], document["tasks"][0]["seconds"]
        assert answer == alone


@pytest.mark.usefixtures("small_spheres")
def test_what_fails_is_a_line_and_ends_nothing(answers: Callable, networks: Path, tmp_path: Path) -> None:
    (tmp_path / "broken.binary").write_bytes(b"nothing")
    code, found, errors = answers(tmp_path / "broken.binary", "no\udcffwhere", networks / "m2")
    assert code == 1
    broken, missing, fitted = found
    assert broken["input"] == str(tmp_path / "broken.binary")
    assert "broken.binary: " in broken["failure"]
    assert missing["failure"] == r"no\udcffwhere: no such file or folder; give existing input files."
    assert fitted["tasks"][0]["name"] == "m2"
    assert errors == "error: 2 of 3 inputs were not fitted.\n"


@pytest.mark.usefixtures("small_spheres")
def test_an_error_that_nobody_foresaw_is_a_line_too(
    answers: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = Fitter.fit

    def fit(self: Fitter, tasks: list) -> list:
        if tasks[0].name == "m0":
            raise KeyError("weights")
        return original(self, tasks)

    monkeypatch.setattr(Fitter, "fit", fit)
    code, (first, second), _ = answers(networks / "m0", networks / "m1")
    assert code == 1
    assert first["failure"].startswith("KeyError: 'weights'; unexpected: please report it")
    assert "failure" not in second


def test_no_line_is_no_work(answers: Callable) -> None:
    assert answers() == (0, [], "")


@pytest.mark.parametrize("more", [("--batch", "2"), ("--shard", "1/2")])
def test_lines_are_answered_one_by_one(answers: Callable, more: tuple[str, ...]) -> None:
    code, _, errors = answers(more=more)
    assert code == 2
    assert "give --json, by which lines are answered" in " ".join(errors.replace("│", " ").split())


def test_without_json_it_is_a_usage_error(metapp: Callable) -> None:
    assert metapp("meta", "brdf", "-").code == 2


def test_a_missing_checkpoint_is_said_before_any_line(answers: Callable, tmp_path: Path) -> None:
    code, found, errors = answers("never read", more=("--checkpoint", str(tmp_path / "none.safetensors")))
    assert (code, found) == (1, [])
    assert errors.startswith("error: ")


@pytest.fixture
def process(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "metapp", "meta", "brdf", "-", "--json", "--quiet", "--out", str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as started:
        yield started
        started.kill()


def test_an_answer_comes_before_the_next_line_is_sent(process: subprocess.Popen[str], networks: Path) -> None:
    assert process.stdin
    assert process.stdout
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=lambda: [lines.put(line) for line in process.stdout or ()], daemon=True).start()
    for name in ("m0", "m1"):
        process.stdin.write(f"{networks / name}\n")
        process.stdin.flush()
        answer = json.loads(lines.get(timeout=120))  # the pipe stays open: only a flushed line can be here
        assert answer["tasks"][0]["name"] == name
        assert Path(answer["out"], "params", f"{name}.safetensors").is_file()
    process.stdin.close()
    assert process.wait(timeout=60) == 0
