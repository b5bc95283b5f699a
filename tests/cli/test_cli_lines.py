"""`- --json`: one process that stays warm answers each line of standard input by a line, whatever is wrong with it."""

from __future__ import annotations

import io
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.runs.fits.fitter import Fitter

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 3


@pytest.fixture
def answers(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> Callable:
    """`metapp meta brdf - --json` on lines: exit code, answers, standard error."""

    def call(*lines: str | Path, more: tuple[str, ...] = ()) -> tuple[int, list[dict], str]:
        text = b"".join(os.fsencode(f"{line}\n") for line in lines)
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text)))
        done = metapp("meta", "brdf", "-", "--json", "--quiet", *more)
        return done.code, [json.loads(line) for line in done.out.splitlines()], done.err

    return call


def test_each_answer_is_that_of_the_command_alone(answers: Callable, metapp: Callable, networks: Path) -> None:
    code, found, errors = answers(networks / "m0", "", networks / "m2", more=("--recipe", "quick"))
    assert (code, errors) == (0, "")
    assert [answer["input"] for answer in found] == [str(networks / "m0"), str(networks / "m2")]
    for answer in found:
        told = ("--recipe", "quick", "--json", "--quiet")
        alone = metapp("meta", "brdf", answer.pop("input"), *told).document
        for document in (answer, alone):
            del document["seconds"], document["tasks"][0]["seconds"]
        assert answer == alone


def test_what_fails_is_a_line_and_ends_nothing(answers: Callable, networks: Path) -> None:
    Path("broken.binary").write_bytes(b"nothing")
    code, found, errors = answers(Path("broken.binary"), "no\udcffwhere", networks / "m2")
    assert code == 1
    broken, missing, fitted = found
    assert broken["input"] == str(Path("broken.binary"))
    assert "broken.binary: " in broken["failure"]
    assert missing["input"] == r"no\udcffwhere"  # text, as JSON in UTF-8 has no lone surrogates
    assert missing["failure"] == r"no\udcffwhere: no such file or folder; give existing input files."
    assert fitted["tasks"][0]["name"] == "m2"
    note, last = errors.splitlines()
    assert note.startswith("m2: reflects 1.13 of the light")
    assert last == "error: 2 of 3 inputs were not fitted."


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


def test_whoever_asks_wrongly_is_told_before_any_line(answers: Callable, metapp: Callable) -> None:
    assert answers() == (0, [], "")  # no line is no work
    for more in (("--batch", "2"), ("--shard", "1/2")):
        code, _, errors = answers(more=more)
        assert code == 2
        assert "give --json, by which lines are answered" in errors
    assert metapp("meta", "brdf", "-").misuse
    code, found, errors = answers("never read", more=("--checkpoint", "none.safetensors"))
    assert (code, found) == (1, [])
    assert errors.startswith("error: ")


@pytest.mark.long
@pytest.mark.usefixtures("compiled")
def test_an_answer_comes_before_the_next_line_is_sent(networks: Path) -> None:
    command = [sys.executable, "-m", "metapp", "meta", "brdf", "-", "--json", "--quiet"]
    lines: queue.Queue[str] = queue.Queue()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdin
            threading.Thread(target=lambda: [lines.put(line) for line in process.stdout or ()], daemon=True).start()
            for name in ("m0", "m1"):
                process.stdin.write(f"{networks / name}\n")
                process.stdin.flush()
                answer = json.loads(lines.get(timeout=120))  # the pipe stays open: only a flushed line can be here
                assert answer["tasks"][0]["name"] == name
                assert Path(answer["out"], "params", f"{name}.safetensors").is_file()
            process.stdin.close()
            assert process.wait(timeout=60) == 0
        finally:
            process.kill()
