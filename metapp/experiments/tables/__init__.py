"""The tables of `metapp evaluate`; one is a module here that defines TABLE, and a further one needs its name in NAMES.

Nothing here is typed in: figures come from records and parameters, the paper's from `paper.json`.
"""

from __future__ import annotations

import functools
import importlib
import json
from collections.abc import Callable
from importlib import resources
from typing import TYPE_CHECKING, Any, NamedTuple

from metapp.experiments.reporter import number

if TYPE_CHECKING:
    from metapp.experiments.tables.subject import Cell, Subject

NAMES = ("results", "quickft", "image", "ablation", "storage", "samples", "convergence")
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


class Table(NamedTuple):
    """One of the paper's tables, for any application.

    Attributes:
        name: a value of --which.
        title: what it shows, after the application's title; {factor} stands for the factor of its errors.
        columns: from left to right, after the application's; a terminal shows as many as it has room for.
        cells: what must have been measured.
        rows: its rows, of what has been measured so far.
        notes: what must be said below it.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    cells: Callable[[Subject], list[Cell]]
    rows: Callable[[Subject], list[Row]]
    notes: Callable[[Subject, list[Row]], list[str]]


def load_table(name: str) -> Table:
    """The table of that name, one of NAMES."""
    result: Table = importlib.import_module(f"metapp.experiments.tables.{name}").TABLE
    return result


def numbers(title: str, key: str, form: str) -> Column:
    """A column of numbers; a dash where there is none."""
    return Column(title, lambda row: number(row.get(key), form))


def words(title: str, key: str) -> Column:
    """A column of words."""
    return Column(title, lambda row: "-" if row.get(key) is None else str(row[key]), left=True)


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
        "threads": None,
        "low": None,
        "high": None,
        "paper_error": known["error"].get(app, {}).get(paradigm),
        "paper_seconds": known["seconds"].get(app, {}).get(paradigm),
        **more,
    }
