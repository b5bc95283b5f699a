"""Cards of checkpoints: each entry has a row, and the tasks that trained it are drawn today as they were then."""

import re
from pathlib import Path

import pytest

from tests.training_sets import (
    NO_SET,
    ROOT,
    SetRow,
    cards,
    entry_rows,
    read_summary,
    set_rows,
    stated_data,
    summarise_draws,
)

QUICK_SETS = ("metapp data synth texture", "metapp data synth svbrdf_nonstationary", "metapp data synth illumination")
SETS = sorted({row for card in cards() for row in set_rows(card)})


def place_of(card: Path, entry: str) -> tuple[Path, str]:
    """Return the file without suffix, and the name, of an entry that a card calls by both, such as `quick/general`."""
    file, name = entry.split("/")
    return card.parent / file, name


def test_each_entry_is_in_one_card() -> None:
    listed = [place_of(card, row.entry) for card in cards() for row in entry_rows(card)]
    assert sorted(listed) == sorted(stated_data(ROOT / "metapp"))


@pytest.mark.parametrize("card", cards(), ids=lambda card: f"{card.parent.name}-{card.stem}")
def test_a_card_states_data_commit_and_command_of_each_entry(card: Path) -> None:
    data_by_place = stated_data(card.parent)
    known_sets = {row.name for row in set_rows(card)}
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for row in entry_rows(card):
        assert row.data == data_by_place[place_of(card, row.entry)], row.entry
        assert re.fullmatch(r"[0-9a-f]{8}", row.commit), row.entry
        assert row.sets == [NO_SET] or (row.sets and set(row.sets) <= known_sets), row.entry
        assert all(target in targets for target in re.findall(r"make ([a-z-]+)", row.command)), row.entry
    assert known_sets == {name for row in entry_rows(card) for name in row.sets} - {NO_SET}


@pytest.mark.parametrize(
    "row",
    [row if row.command in QUICK_SETS else pytest.param(row, marks=pytest.mark.long) for row in SETS],
    ids=str,
)
def test_training_tasks_are_drawn_as_the_card_states(row: SetRow) -> None:
    """Whoever changes a draw trains the checkpoints of its set again, and states the new draws in the card."""
    stated, drawn = read_summary(row.summary), read_summary(summarise_draws(row.command))
    assert stated.keys() == drawn.keys()
    for name, numbers in stated.items():
        assert drawn[name] == pytest.approx(numbers, rel=2e-4), name


def test_other_draws_do_not_pass_for_the_stated_ones() -> None:
    stated = read_summary(summarise_draws("metapp data synth texture --size 64"))
    other = read_summary(summarise_draws("metapp data synth texture --size 64 --seed 1"))
    assert other["image"] != pytest.approx(stated["image"], rel=2e-4)
