"""Messages on a terminal, and help."""

import os
import sys

import pytest

from metapp.cli.console import run
from metapp.cli.terminal import Terminal


def test_a_warning_is_said_once_by_each_command(capsys: pytest.CaptureFixture[str]) -> None:
    for terminal in (Terminal(), Terminal()):
        for message in ("warning: a.png: it clips", "a line", "warning: b.png: it clips", "a line"):
            terminal.say(message)
            terminal.say(message)
    lines = capsys.readouterr().err.splitlines()
    assert lines.count("warning: a.png: it clips") == lines.count("warning: b.png: it clips") == 2
    assert lines.count("a line") == 8


def test_paths_in_messages_turn_no_text(capsys: pytest.CaptureFixture[str]) -> None:
    Terminal().say("picture: a\u202egnp.b\nrecords: \u0639\u0631\u0628\u064a")
    assert capsys.readouterr().err == "picture: a\\u202egnp.b\nrecords: \u0639\u0631\u0628\u064a\n"


def test_a_reader_that_goes_away_ends_a_command_quietly(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of `metapp ... | head`."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as pipe:
        monkeypatch.setattr("sys.stdout", pipe)
        assert run(lambda: print("a line")) == 141
    assert capsys.readouterr().err == ""


def test_a_program_that_ends_itself_keeps_its_exit_code() -> None:
    """As --show-completion does; only a broken pipe counts as output that nobody read."""
    with pytest.raises(SystemExit) as ended:
        run(lambda: sys.exit(0))
    assert ended.value.code == 0
