"""What a table of `metapp evaluate` is."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from metapp.evaluation.tables.rows import Column, Row
from metapp.evaluation.tables.subject import Cell, Subject


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
