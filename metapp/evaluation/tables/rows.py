"""Rows and columns of tables. Nothing is typed in: figures come from records, the paper's from `paper.json`."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from importlib import resources
from typing import Any, NamedTuple

from metapp.runs.reporter import number

Row = dict[str, Any]


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        title: above it.
        text: a row as this column shows it.
        left: align left, as words are.
    """

    title: str
    text: Callable[[Row], str]
    left: bool = False


def numbers(title: str, key: str, form: str) -> Column:
    """A column of numbers; a dash where there is none."""
    return Column(title, lambda row: number(row.get(key), form))


def words(title: str, key: str) -> Column:
    """A column of words."""
    return Column(title, lambda row: "-" if row.get(key) is None else str(row[key]), left=True)


def bytes_column(title: str, key: str) -> Column:
    """A column of bytes, to three digits; a dash where they are not known."""

    def text(row: Row) -> str:
        value = row[key]
        if value is None:
            return "-"
        for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
            if value >= scale:
                return f"{value / scale:.3g} {unit}"
        return f"{value:.0f} B"

    return Column(title, text)


def interval(title: str = "95 % interval") -> Column:
    """The column of intervals, from `low` and `high`."""
    return Column(title, lambda row: "-" if row["low"] is None else f"{row['low']:.3f} .. {row['high']:.3f}")


@functools.cache
def paper() -> dict[str, Any]:
    """The paper's figures, with where they stand in it."""
    result: dict[str, Any] = json.loads((resources.files("metapp") / "paper.json").read_text())
    return result


def blank(app: str, paradigm: str, **more: Any) -> Row:
    """A row of which nothing is known yet but the paper's figures; all rows have these keys."""
    known = paper()
    return {
        "app": app,
        "paradigm": paradigm,
        "error": None,
        "seconds": None,
        "tasks": 0,
        "warnings": 0,
        "guarded": None,
        "threads": None,
        "low": None,
        "high": None,
        "paper_error": known["error"].get(app, {}).get(paradigm),
        "paper_seconds": known["seconds"].get(app, {}).get(paradigm),
        **more,
    }


# what comes last: how sure, at what cost, how unlike the tasks are
LAST = (
    interval(),
    numbers("steps", "steps", "d"),
    numbers("seconds", "seconds", ".4f"),
    numbers("median", "median", ".3f"),
    numbers("worst", "worst", ".3f"),
)
