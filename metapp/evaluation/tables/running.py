"""Run all cells that have no records yet, one progress over all of them with the time left."""

from __future__ import annotations

import time
from collections.abc import Sequence

from metapp.evaluation.tables.subject import Cell
from metapp.learning.task import Task
from metapp.runs.reporter import clock as shown_clock
from metapp.runs.surroundings import threads


def distinct(cells: Sequence[Cell]) -> list[Cell]:
    """The same cells, each once: tables share most of them."""
    return list({cell.folder.path: cell for cell in cells if cell.folder}.values())


def run_cells(cells: Sequence[Cell], *, quiet: bool) -> None:
    """Measure what is missing; each record is kept as soon as it is there, so a killed run goes on where it was.

    Within a stage cells of few steps come first: the time left is soon known, and most of a table is soon there.
    """
    planned = [(cell, cell.missing()) for cell in sorted(distinct(cells), key=lambda cell: (cell.stage, cell.steps))]
    planned = [(cell, missing) for cell, missing in planned if missing]
    if not planned:
        return
    clock = Clock(planned)
    with shown_clock(quiet=quiet) as tell:
        for i, (cell, missing) in enumerate(planned, 1):
            tell(f"{cell.title}, cell {i} of {len(planned)}", clock.spent, clock.left())
            with threads(cell.threads):
                begin = time.perf_counter()
                for record in cell.run(missing):
                    now = time.perf_counter()
                    clock.add(cell, now - begin)
                    begin = now
                    tell(f"{cell.title} {record['name']}, cell {i} of {len(planned)}", clock.spent, clock.left())


class Clock:
    """How long the rest will take: seconds a gradient step of each application, as measured so far.

    What takes its time beside steps, such as pictures, has seconds a task of its own, at first those it guesses.
    """

    def __init__(self, planned: Sequence[tuple[Cell, list[Task]]]) -> None:
        self.spent = 0.0
        self._missing = {cell.folder.path: (cell, len(missing)) for cell, missing in planned if cell.folder}
        self._measured: dict[tuple[str, float], list[float]] = {}  # what takes time -> [seconds, steps, or tasks]

    def add(self, cell: Cell, seconds: float) -> None:
        """A task of a cell took so long."""
        self.spent += seconds
        if cell.folder:
            self._missing[cell.folder.path] = (cell, self._missing[cell.folder.path][1] - 1)
        total = self._measured.setdefault(_kind(cell), [0.0, 0.0])
        total[0] += seconds
        total[1] += _amount(cell)

    def left(self) -> float:
        """Seconds left, 0 where nothing was measured yet; an application without a figure takes the others' mean."""
        if not self._measured:
            return 0.0
        fits = [each for (_, guess), each in self._measured.items() if not guess]
        mean = [sum(each[0] for each in fits), sum(each[1] for each in fits) or 1.0]
        rest = 0.0
        for cell, count in self._missing.values():
            own = self._measured.get(_kind(cell), [cell.guess, 1.0] if cell.guess else mean)
            rest += count * _amount(cell) * own[0] / own[1]
        return rest


def _kind(cell: Cell) -> tuple[str, float]:
    """What takes the same time: steps of one application, or tasks that guess the same."""
    return cell.title.partition(" ")[0], cell.guess


def _amount(cell: Cell) -> float:
    return 1.0 if cell.guess else cell.steps + 1.0
