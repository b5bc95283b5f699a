"""Cells of tables: something measured on tasks and kept as records; those that are missing are run under one clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from metapp.learning.task import Params, Task
from metapp.runs.reporter import clock as shown_clock
from metapp.runs.requests.request import Portion
from metapp.runs.surroundings import threads
from metapp.storage.records import Record, RunFolder

WHOLE = Portion()
Measure = Callable[[list[Task]], Iterator[tuple[Record, Params | None]]]


class Cell(NamedTuple):
    """Something that is measured on each of some tasks and kept as records, as soon as a task is done.

    Attributes:
        title: for the progress; it begins with the application's name.
        tasks: what it is measured on.
        folder: where records are kept; None where the checkpoint is missing that it needs.
        measure: tasks -> the record of each, and what is kept beside it as parameters, if anything.
        steps: gradient steps a task, about: cells with few come first.
        stage: cells of a lower stage come first, which this one reads.
        threads: that torch works with meanwhile; None: as many as it does.
        guess: seconds that a task takes beside its steps, about, before any was measured.
    """

    title: str
    tasks: Sequence[Task]
    folder: RunFolder | None
    measure: Measure
    steps: int
    stage: int = 0
    threads: int | None = None
    guess: float = 0.0

    def records(self) -> list[Record]:
        """The records there are, in the order of the tasks."""
        finished = self.folder.finished() if self.folder else {}
        return [finished[task.name] for task in self.tasks if task.name in finished]

    def missing(self, portion: Portion = WHOLE) -> list[Task]:
        """The tasks of a portion that have no record yet."""
        finished = self.folder.finished() if self.folder else {}
        return [task for task in portion.of(self.tasks) if task.name not in finished]

    @property
    def whole(self) -> bool:
        """Whether there is a record of every task."""
        return bool(self.tasks) and not self.missing()

    def run(self, tasks: list[Task]) -> Iterator[Record]:
        """Measure tasks; each record is kept before it is yielded."""
        assert self.folder is not None
        for record, tensors in self.measure(tasks):
            self.folder.add(record, tensors)
            yield record


def distinct(cells: Sequence[Cell]) -> list[Cell]:
    """The cells that can be run, once each: tables share most of them."""
    return list({cell.folder.path: cell for cell in cells if cell.folder}.values())


def run_cells(cells: Sequence[Cell], portion: Portion = WHOLE, *, quiet: bool) -> int:
    """Measure what is missing; a killed run goes on at the first task without a record.

    Within a stage cells of few steps come first: the time left is soon known, and most of a table is soon there.
    Programs that run different portions at the same time measure nothing twice, and none needs another's records.

    Returns:
        The number of records that were made.
    """
    ordered = sorted(distinct(cells), key=lambda cell: (cell.stage, cell.steps))
    planned = [(cell, missing) for cell in ordered if (missing := cell.missing(portion))]
    if not planned:
        return 0
    count = 0
    clock = Clock(planned)
    with shown_clock(quiet=quiet) as show:
        for i, (cell, missing) in enumerate(planned, 1):
            show(f"{cell.title}, cell {i} of {len(planned)}", clock.spent, clock.left())
            with threads(cell.threads):
                begin = time.perf_counter()
                for record in cell.run(missing):
                    now = time.perf_counter()
                    clock.add(cell, now - begin)
                    begin, count = now, count + 1
                    show(f"{cell.title} {record['name']}, cell {i} of {len(planned)}", clock.spent, clock.left())
    return count


class Clock:
    """The time left: seconds a gradient step of each application, as measured so far.

    Cells that take their time beside steps, such as pictures, have seconds a task of their own, at first their guess.
    """

    def __init__(self, planned: Sequence[tuple[Cell, list[Task]]]) -> None:
        self.spent = 0.0
        self._missing = {cell.folder.path: (cell, len(missing)) for cell, missing in planned if cell.folder}
        self._measured: dict[tuple[str, float], list[float]] = {}  # by kind: [seconds, steps or tasks]

    def add(self, cell: Cell, seconds: float) -> None:
        """Count a task of a cell, which took so long."""
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
        fits = [total for (_, guess), total in self._measured.items() if not guess]
        mean = [sum(seconds for seconds, _ in fits), sum(amount for _, amount in fits) or 1.0]
        rest = 0.0
        for cell, count in self._missing.values():
            own = self._measured.get(_kind(cell), [cell.guess, 1.0] if cell.guess else mean)
            rest += count * _amount(cell) * own[0] / own[1]
        return rest


def _kind(cell: Cell) -> tuple[str, float]:
    """What takes the same time: steps of one application, or tasks of the same guess."""
    return cell.title.partition(" ")[0], cell.guess


def _amount(cell: Cell) -> float:
    return 1.0 if cell.guess else cell.steps + 1.0
