"""Messages on a terminal, help and completion."""

import contextlib
import io
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.cli.console import Terminal, run_command, state_what_interruption_keeps
from metapp.paradigms import PARADIGMS
from metapp.registry import Command, Entry, registry

# names are printed as they are, whatever they look like: markup, emoji codes
NAMES = ("bad:x:b.csv", "[red]a[/red].csv", "[/].csv", ":smile:.csv")


def test_each_command_prints_a_warning_once(capsys: pytest.CaptureFixture[str]) -> None:
    for terminal in (Terminal(), Terminal()):
        for message in ("warning: a.png: it clips", "a line", "warning: b.png: it clips", "a line"):
            terminal.say(message)
            terminal.say(message)
    lines = capsys.readouterr().err.splitlines()
    assert lines.count("warning: a.png: it clips") == lines.count("warning: b.png: it clips") == 2
    assert lines.count("a line") == 8


def test_paths_in_messages_cannot_reverse_text(capsys: pytest.CaptureFixture[str]) -> None:
    Terminal().say("picture: a\u202egnp.b\nrecords: \u0639\u0631\u0628\u064a")
    assert capsys.readouterr().err == "picture: a\\u202egnp.b\nrecords: \u0639\u0631\u0628\u064a\n"


def test_an_interruption_says_what_the_command_keeps(capsys: pytest.CaptureFixture[str]) -> None:
    def fit() -> None:
        state_what_interruption_keeps("fits that are done are kept")
        raise KeyboardInterrupt

    def compare() -> None:
        raise KeyboardInterrupt

    assert [run_command(fit), run_command(compare)] == [130, 130]
    assert capsys.readouterr().err == "interrupted; fits that are done are kept.\ninterrupted.\n"


def test_a_reader_that_goes_away_ends_a_command_quietly(capsys: pytest.CaptureFixture[str]) -> None:
    """An example is `metapp ... | head`."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as pipe, contextlib.redirect_stdout(pipe):
        assert run_command(lambda: print("a line")) == 141
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize("flush", [False, True])
def test_a_full_standard_output_is_named(flush: bool, capsys: pytest.CaptureFixture[str]) -> None:
    with open("/dev/full", "w") as full, contextlib.redirect_stdout(full):
        assert run_command(lambda: print("a line", flush=flush)) == 1
    assert capsys.readouterr().err == "error: standard output: No space left on device; print to another file.\n"


@pytest.mark.parametrize("streams", ["1>&-", "0<&- 1>&-", "0<&- 1>&- 2>&-", "2>&-"])
def test_closed_streams_are_one_line_and_no_file_gets_their_numbers(streams: str, tmp_path: Path) -> None:
    lines = "from metapp.cli.console import run_command\nimport sys\n"
    lines += "def command():\n    file = open('made', 'w')\n    print('printed')\n    print(file.fileno(), file=file)\n"
    lines += "    file.close()\nsys.exit(run_command(command))"
    process = subprocess.run(
        ["bash", "-c", f'"$0" -c "$1" {streams}', sys.executable, lines], capture_output=True, text=True, cwd=tmp_path
    )
    output = "error: standard output: closed, expected an open one; print to a file or to /dev/null, or add --quiet.\n"
    is_closed = "1>" in streams
    assert process.stderr == (output if is_closed and "2>" not in streams else "")
    assert (process.returncode, process.stdout) == ((1, "") if is_closed else (0, "printed\n"))
    assert int((tmp_path / "made").read_text()) > 2


def test_a_program_that_ends_itself_keeps_its_exit_code() -> None:
    """--show-completion ends so; only a broken pipe counts as output that nobody read."""
    with pytest.raises(SystemExit) as ended:
        run_command(lambda: sys.exit(0))
    assert ended.value.code == 0


def test_help_lists_commands_in_the_order_of_their_use(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = [re.findall(r"^│ ([a-z][a-z-]*)", metapp(*words, "--help").out, re.MULTILINE) for words in ([], ["data"])]
    assert listed == [
        [
            *("try", "examples", *PARADIGMS, "evaluate"),
            *("view", "export", "compare", "baseline", "plan", "data", "doctor"),
        ],
        [
            *("synth", "merl", "bsdf", "gonio", "nbrdf", "images", "flash", "maps", "strips", "materials", "laval"),
            *("cornell", "join", "check", "markers", "rectify", "ball", "vgg"),
        ],
    ]
    monkeypatch.setitem(registry().commands, "last", Entry("os:getcwd"))
    monkeypatch.setitem(registry().commands, "second", Command("os:getcwd", position=15))
    names = re.findall(r"^│ ([a-z][a-z-]*)", metapp("--help").out, re.MULTILINE)
    assert names == ["try", "second", *listed[0][1:], "last"]


def test_help_of_every_command_fits_a_screen(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for words in ([], *(name.split() for name in registry().commands)):
        shown = metapp(*words, "--help").out.strip("\n")
        assert len(shown.splitlines()) <= 40, words
    assert "Seed of all random draws. Default: 0." in metapp("data", "cornell", "--help").out
    assert "Folder to write to; made if missing. Required." in metapp("data", "merl", "--help").out


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("command", ["meta brdf", "data check", "meta brdf --export", ""])
def test_a_name_in_an_error_line_is_as_it_was_given(metapp: Callable, command: str, name: str) -> None:
    if "/" not in name:
        Path(name).write_text("theta\n1\n")
    assert name in metapp(*command.split(), name).err


class TerminalStream(io.StringIO):
    """A stream that keeps what a terminal is sent."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def _terminal_with_a_cursor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    for name in ("FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)


def test_names_beside_a_progress_bar_are_drawn_as_they_are() -> None:
    with contextlib.redirect_stderr(TerminalStream()) as drawn:
        shown = Terminal()
        with shown.bar(NAMES[0], 2, 0, False) as bar:
            bar.advance(NAMES[1])
            shown.say(NAMES[3])
    assert all(name in drawn.getvalue() for name in (NAMES[0], NAMES[1], NAMES[3]))


@pytest.mark.parametrize("variables", [{"FORCE_COLOR": "1"}, {"FORCE_COLOR": "1", "CI": "true"}, {"TERM": "dumb"}])
def test_logs_and_dumb_terminals_get_lines_and_no_bar(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str]
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    stream = TerminalStream() if "TERM" in variables else io.StringIO()
    with contextlib.redirect_stderr(stream), Terminal().bar("job", 2, 0, True) as bar:
        bar.advance("a.csv")
        bar.advance("b.csv")
    assert stream.getvalue() == "job: 1 of 2, a.csv\njob: 2 of 2, b.csv\n"


def test_the_time_left_is_shown_once_a_tenth_is_done() -> None:
    with contextlib.redirect_stderr(TerminalStream()) as drawn, Terminal().bar("job", 100, 0, False) as bar:
        for step in range(30):
            bar.set_done(step, 100)
            bar.bars.refresh()
            assert bool(re.search(r"\d:\d\d:\d\d", drawn.getvalue())) == (step >= 10)


def test_waits_are_reported_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal(wait_seconds=0.05)
    with terminal.bar("photos", 3, 0, False) as bar:
        bar.advance("a.jpg")
        bar.set_label("b.jpg: finding features")
        time.sleep(0.3)  # in one step, which tells nothing
    assert capsys.readouterr().err == "photos: 1 of 3, b.jpg: finding features\n"
    with terminal.bar("plan", None, 0, False):
        time.sleep(0.3)
    assert capsys.readouterr().err == "plan: under way\n"
    with terminal.bar("photos", 3, 0, False) as bar:  # as soon as all is done nothing more is said
        bar.advance("a.jpg")
    time.sleep(0.2)
    assert capsys.readouterr().err == ""


def test_long_waits_are_reported_from_time_to_time(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal(wait_seconds=3500.0, next_seconds=-3600.0)
    with terminal.bar("photos", 2, 0, False) as bar:
        bar.advance("a.jpg")
        terminal.next_seconds = 3600.0
        bar.advance("b.jpg")
        bar.set_done(2, 2, "c.jpg")
    assert capsys.readouterr().err.splitlines() == ["photos: 1 of 2, a.jpg", "photos: 2 of 2, b.jpg"]


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
