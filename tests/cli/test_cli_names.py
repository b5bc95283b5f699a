"""Names of files and tasks are printed as they are, whatever they look like: markup, emoji codes."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.cli.terminal import Terminal

NAMES = ("bad:x:b.csv", "[red]a[/red].csv", "[/].csv", ":smile:.csv")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("command", ["meta brdf", "data check", "meta brdf --export", ""])
def test_a_name_in_an_error_line_is_as_it_was_given(metapp: Callable, command: str, name: str) -> None:
    if "/" not in name:
        Path(name).write_text("theta\n1\n")
    assert name in metapp(*command.split(), name).err


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("overfit brdf --steps", "steps: 99999999999999999999999, expected 0 to 1,000,000,000"),
        ("general brdf --train --train-steps", "train_steps: 99999999999999999999999, expected 0 to 1,000,000,000"),
        ("data synth brdf --seed", "'--seed': Input should be less than or equal to 9223372036854775807"),
        ("data nbrdf m --out set --samples", "'--samples': Input should be less than or equal to 10000000"),
    ],
)
def test_numbers_that_nothing_can_hold_are_refused_in_a_line(metapp: Callable, command: str, said: str) -> None:
    assert said in metapp(*command.split(), 99999999999999999999999).misuse


def test_names_beside_a_progress_bar_are_drawn_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = io.StringIO()
    monkeypatch.setattr(sys, "stderr", drawn)
    monkeypatch.setenv("FORCE_COLOR", "1")
    shown = Terminal()
    with shown.bar(NAMES[0], 2, 0, False) as bar:
        bar.advance(NAMES[1])
        shown.say(NAMES[3])
    assert all(name in drawn.getvalue() for name in (NAMES[0], NAMES[1], NAMES[3]))
