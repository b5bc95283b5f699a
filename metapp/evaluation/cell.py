"""Cells of tables: something measured on tasks and kept as records; those that are missing are run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from metapp.learning.task import Params, Task
from metapp.runs.inputs.sources import content_of
from metapp.runs.reporter import progress
from metapp.runs.surroundings import threads
from metapp.storage.fits import Fits, Record

Measure = Callable[[list[Task]], Iterator[tuple[Record, Params | None]]]


class Cell(NamedTuple):
    """Something that is measured on each of some tasks and kept as records, as soon as a task is done.

    Attributes:
        title: for the progress; it begins with the application's name.
        tasks: what it is measured on.
        fits: where records are kept; None where the checkpoint is missing that it needs.
        measure: tasks -> the record of each, and what is kept beside it as parameters, if anything.
        steps: gradient steps a task, about: cells with few come first.
        stage: cells of a lower stage come first, which this one reads.
        threads: that torch works with meanwhile; None: as many as it does.
    """

    title: str
    tasks: Sequence[Task]
    fits: Fits | None
    measure: Measure
    steps: int
    stage: int = 0
    threads: int | None = None

    def records(self) -> list[Record]:
        """The records there are, in the order of the tasks."""
        finished = self.fits.records() if self.fits else {}
        return [finished[task.name] for task in self.tasks if task.name in finished]

    def missing(self) -> list[Task]:
        """The tasks that have no record yet."""
        finished = self.fits.records() if self.fits else {}
        return [task for task in self.tasks if task.name not in finished]

    @property
    def whole(self) -> bool:
        """True if there is a record of every task."""
        return bool(self.tasks) and not self.missing()

    def run(self, tasks: list[Task]) -> Iterator[Record]:
        """Measure tasks; each record is kept before it is yielded."""
        assert self.fits is not None
        for task, (record, tensors) in zip(tasks, self.measure(tasks), strict=False):  # it may end early
            yield self.fits.write({**record, "content": content_of(task)}, tensors)


def run_cells(cells: Sequence[Cell], *, quiet: bool) -> None:
    """Measure what is missing; a killed run goes on at the first task without a record.

    Within a stage cells of few steps come first: most of a table is soon there. The progress counts gradient steps.
    """
    once = {cell.fits.path: cell for cell in cells if cell.fits}.values()  # tables share most of them
    ordered = sorted(once, key=lambda cell: (cell.stage, cell.steps))
    planned = [(cell, missing) for cell in ordered if (missing := cell.missing())]
    if not planned:
        return
    total = sum((cell.steps + 1) * len(missing) for cell, missing in planned)
    done = 0
    with progress("evaluate", total, long=True, quiet=quiet) as bar:
        for i, (cell, missing) in enumerate(planned, 1):
            place = f"cell {i} of {len(planned)}"
            bar.at(done, total, f"{cell.title}, {place}")
            with threads(cell.threads):
                for record in cell.run(missing):
                    done += cell.steps + 1
                    bar.at(done, total, f"{cell.title} {record['name']}, {place}")
