"""Help, completion, and names in messages."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.paradigms import PARADIGMS
from metapp.registry import Command, registry
from tests.cli.messages import says

# names are printed as they are, whatever they look like: markup, emoji codes
NAMES = ("bad:x:b.csv", "[red]a[/red].csv", "[/].csv", ":smile:.csv")


def test_help_lists_commands_in_the_order_of_their_use(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = [re.findall(r"^│ ([a-z][a-z-]*)", metapp(*words, "--help").out, re.MULTILINE) for words in ([], ["data"])]
    assert listed == [
        [
            *("try", "examples", *PARADIGMS, "evaluate"),
            *("view", "export", "compare", "baseline", "plan", "data", "doctor"),
        ],
        [
            *("synth", "merl", "bsdf", "gonio", "nbrdf", "images", "flash", "maps", "strips", "materials", "domes"),
            "laval",
            *("cornell", "join", "check", "markers", "rectify", "ball", "lights", "vgg"),
        ],
    ]
    monkeypatch.setitem(registry().commands, "last", Command("os:getcwd"))
    monkeypatch.setitem(registry().commands, "second", Command("os:getcwd", position=15))
    names = re.findall(r"^│ ([a-z][a-z-]*)", metapp("--help").out, re.MULTILINE)
    assert names == ["try", "second", *listed[0][1:], "last"]


def test_help_of_every_command_fits_a_screen(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for words in ([], *(name.split() for name in registry().commands)):
        shown = metapp(*words, "--help").out.strip("\n")
        assert len(shown.splitlines()) <= 40, words
    assert says(metapp("data", "cornell", "--help").out, "--seed", "Default: 0.")
    assert says(metapp("data", "merl", "--help").out, "--out", "Required.")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("command", ["meta brdf", "data check", "meta brdf --export", ""])
def test_a_name_in_an_error_line_is_as_it_was_given(metapp: Callable, command: str, name: str) -> None:
    if "/" not in name:
        Path(name).write_text("theta\n1\n")
    assert name in metapp(*command.split(), name).err


def test_completion_imports_nothing_large() -> None:
    lines = "import sys\nfrom metapp.cli import main\ntry:\n    main()\nfinally:\n"
    lines += "    print({'torch', 'mitsuba', 'numpy', 'rich.console'} & sys.modules.keys())"
    line = {"_METAPP_COMPLETE": "complete_bash", "COMP_WORDS": "metapp meta brdf --recipe ", "COMP_CWORD": "4"}
    process = subprocess.run(
        [sys.executable, "-c", lines], capture_output=True, text=True, env=os.environ | line, check=True
    )
    *words, imported = process.stdout.splitlines()
    assert {"quick", "full", "few"} <= set(words)
    assert imported == "set()"
