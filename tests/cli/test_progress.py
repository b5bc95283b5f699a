"""Messages and progress: bars on a terminal, lines in a log."""

import contextlib
import io
import re
import time

import pytest

from metapp.cli.progress import Terminal

NAMES = ("bad:x:b.csv", "[red]a[/red].csv", ":smile:.csv")  # they look like markup and emoji codes


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
            shown.say(NAMES[2])
    assert all(name in drawn.getvalue() for name in NAMES)


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
