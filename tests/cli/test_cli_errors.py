"""Errors of commands: one line each, also of what nobody foresaw; names that are no text."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from torch import Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.cli.console import MAX_MESSAGE_CHARACTERS, shorten_to_line
from metapp.learning.recipe import Adam
from metapp.learning.task import Task
from metapp.runs import fitting
from metapp.runs.fit import Fit, read_fit
from metapp.runs.memory_errors import describe_short_memory
from metapp.runs.stored_fits import read_fits
from metapp.storage.fit_folders import PARAMS, RECORD
from tests.cli.messages import says
from tests.conftest import CommandResult

pytestmark = pytest.mark.usefixtures("small_spheres")


def only_error_line(result: CommandResult) -> str:
    """The one line, and no other, of a command that failed."""
    assert result.code == 1
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    assert len(line) <= MAX_MESSAGE_CHARACTERS
    return line


SLOW_WRITER = """
import sys, time, torch
from pathlib import Path
from metapp.storage.shards import write_data_set
from metapp.learning.task import Task
def slow():
    yield Task("slow", {"x": torch.ones(2)}), "train", ""
    print("writing", flush=True)
    time.sleep(60)
write_data_set(Path(sys.argv[1]), "brdf", {"x": "1"}, slow())
"""


def test_two_writers_of_a_folder_lose_nothing(metapp: Callable, network: Path) -> None:
    words = ("data", "nbrdf", network, "--out", "set", "--samples", "64", "--quiet")
    with subprocess.Popen([sys.executable, "-c", SLOW_WRITER, "set"], stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout
            assert program.stdout.readline() == "writing\n"
            assert metapp(*words).code == 0
        finally:
            program.kill()
    assert metapp(*words, "--overwrite").code == 0
    assert metapp("data", "check", "set").code == 0


def test_names_that_are_not_utf_8_are_to_be_changed(metapp: Callable, network: Path) -> None:
    """As old archives from other systems leave them; the refusal, and what follows of it in JSON, is UTF-8."""
    place = Path(os.fsdecode(b"caf\xe9"))
    shutil.copytree(network, place)
    result = metapp("meta", "brdf", place, "--recipe", "quick", "--json")
    assert "caf\\udce9': a name that is not UTF-8, expected one that is; rename it." in result.error
    assert metapp("meta", "brdf", network, "--recipe", "quick", "--out", place, "--json").code == 0
    (file,) = place.rglob(RECORD)
    assert read_fit(file.parent)


@pytest.mark.parametrize("name", ["x" * 230, "a\nb$x$", "日" * 80, "aux"])
def test_files_of_any_name_are_fitted(fit: Callable, network: Path, name: str) -> None:
    shutil.copytree(network, Path(name))
    result = fit("overfit", Path(name), "--steps", "2", "--export", "nbrdf", "--json")
    assert result.code == 0
    (task,) = result.json_document["tasks"]
    assert task["name"].isprintable()
    folder = Path(result.json_document["out"])
    assert [fit.name for fit in read_fits(folder)] == [task["name"]]
    assert (folder / "pictures.png").is_file()
    place = Path(task["folder"])
    assert (place / PARAMS).is_file()
    assert len(list((place / "nbrdf").iterdir())) == 1


def test_messages_are_one_short_line(metapp: Callable) -> None:
    for words in (("data", "check", "a\nb\x1b[31m"), ("data", "check", "/".join(["x" * 200] * 10))):
        assert only_error_line(metapp(*words))
    assert only_error_line(metapp("overfit", "brdf", "y" * 5000))
    assert shorten_to_line("a\nb\t\x1b\udce9") == "a\\nb\\t\\x1b\\udce9"
    long = shorten_to_line("gold.binary: " + "x" * 5000 + "; download it again.")
    assert len(long) <= MAX_MESSAGE_CHARACTERS
    assert long.startswith("gold.binary: ")
    assert long.endswith("; download it again.")
    path = "/home/somebody/" + "x" * 260 + "/metapp/checkpoints/brdf/general.safetensors"
    assert shorten_to_line(f"{path}: damaged.") == ".../metapp/checkpoints/brdf/general.safetensors: damaged."


SHORT_MEMORY = (
    "[enforce fail at alloc_cpu.cpp:124] err == 0. DefaultCPUAllocator: can't allocate memory: you tried to allocate "
    "12000000000 bytes. Error code 12 (Cannot allocate memory)"
)


def test_short_memory_is_named_with_a_size_that_takes_less(
    fit: Callable, network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Failing(Brdf):
        def prepare(self, task: Task) -> dict[str, Tensor]:
            raise RuntimeError(SHORT_MEMORY)

    quick = RECIPES["quick"]
    monkeypatch.setitem(RECIPES, "quick", replace(quick, app=Failing(quick.app.network)))
    line = only_error_line(fit("overfit", network, "--steps", "2", "--recipe", "quick"))
    assert says(line, "memory", "12.0 GB")
    in_numpy = MemoryError("Unable to allocate 3.00 GiB for an array")
    assert says(describe_short_memory(in_numpy, (512, 1024)), "3.00 GiB", "512x1024", "--size 256x512")
    assert describe_short_memory(RuntimeError("shapes differ")) == ""


@pytest.mark.parametrize("error", [KeyError("w1"), TypeError("a\nb" * 200)])
def test_unexpected_errors_are_one_line_that_asks_for_a_report(
    fit: Callable, network: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    class Failing(Brdf):
        def prepare(self, task: Task) -> dict[str, Tensor]:
            raise error

    quick, words = RECIPES["quick"], ("overfit", network, "--steps", "2", "--recipe", "quick")
    monkeypatch.setitem(RECIPES, "quick", replace(quick, app=Failing(quick.app.network)))
    line = only_error_line(fit(*words))
    assert type(error).__name__ in line
    assert "report" in line
    monkeypatch.setenv("METAPP_TRACEBACK", "1")
    with pytest.raises(type(error)):
        fit(*words)


def test_records_state_threads_and_fits_that_end_worse(
    fit: Callable, network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def record(*words: str) -> tuple[CommandResult, Fit]:
        result = fit("overfit", network, "--steps", "2", "--json", *words)
        return result, read_fits(Path(result.json_result["out"]))[-1]

    _, whole = record()
    assert whole.threads == 1  # BRDFs are fitted by one thread
    assert "threads" not in whole.spec.document()
    assert whole.warning == ""
    assert "warning" not in whole.document()
    monkeypatch.setitem(RECIPES, "quick", replace(RECIPES["quick"], overfit=Adam(1.0)))
    result, worse = record("--recipe", "quick")
    assert says(result.err, "warning: m0: ", "loss rose")
    assert "loss rose" in worse.warning
    assert result.json_result["tasks"][0]["warning"] == worse.warning
    monkeypatch.setattr(fitting, "draw_per_task", None)
    assert "warning" not in fit("meta", network, "--json").json_result["tasks"][0]  # its guard compared them
