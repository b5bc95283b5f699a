"""Cells measured by processes side by side: what that will take, and rows as they come."""

from __future__ import annotations

import heapq
import itertools
import multiprocessing
import os
import signal
import statistics
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.evaluation.cell import Cell, run_cells
from metapp.evaluation.rows import Table
from metapp.evaluation.subject import FEW, Subject
from metapp.evaluation.tables import load_table
from metapp.learning.task import Task
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.fits.fitter import Fitter
from metapp.runs.inputs.embedded import embedded_data, embedded_exists, embedded_module, split_counts
from metapp.runs.reporter import Reporter, number, progress, reporting, say
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request
from metapp.runs.surroundings import threads_of
from metapp.runs.torch_state import threads

SMALL = 1000  # gradient steps of all that is missing, which is measured without further processes
LONG = 3.0  # seconds of a task: such cells come last, the longest first, so that processes end together
TIMED = 4  # steps


class Pace(NamedTuple):
    """The seconds of a gradient step, of the rest of a fit, and of an embedded set that must be made."""

    step: float
    rest: float
    data: float

    def of(self, cell: Cell) -> float:
        """The seconds of a task of a cell, about."""
        return self.rest + cell.steps * self.step


class Job(NamedTuple):
    """The work of a process at a time: some tasks of a cell, or a data set. Lower ones come first.

    Attributes:
        stage: of the cell.
        order: short jobs first, then long ones, the longest first.
        seconds: that it takes, about.
        subject: its number.
        cell: path of the cell's folder; None: the subject's data set.
        tasks: names.
    """

    stage: int
    order: tuple[bool, float]
    seconds: float
    subject: int
    cell: Path = Path()
    tasks: tuple[str, ...] = ()


def measure(subjects: Sequence[Subject], tables: Sequence[Table], *, quiet: bool) -> None:
    """Measure what has no record yet; a call that was ended goes on where it was."""
    names = [table.name for table in tables]
    needed = [unique(cells_of(foreseen(subject), names)) for subject in subjects]
    subjects = [subject for subject, cells in zip(subjects, needed, strict=True) if any(c.missing() for c in cells)]
    cells = unique(list(itertools.chain(*needed)))
    steps = sum((cell.steps + 1) * len(cell.missing()) for cell in cells)
    if all(map(made, subjects)) and steps <= SMALL:
        run_cells(cells, quiet=quiet)
        return
    count = min(2, os.cpu_count() or 1) if all(subject.plan.device.type == "cpu" for subject in subjects) else 1
    arguments = ([subject.plan.request for subject in subjects], subjects[0].whole, names, count)
    context = multiprocessing.get_context("spawn")  # a fork loses the threads of torch and Mitsuba
    with ProcessPoolExecutor(count, context, _begin, arguments) as pool:
        try:
            _Measuring(subjects, names, pool, count, quiet).run()
        except BaseException as error:
            for process in multiprocessing.active_children():
                process.terminate()
            if isinstance(error, BrokenProcessPool):
                lost = "evaluate: a process ended by itself, perhaps for lack of memory"
                raise OSError(f"{lost}; free some and give the command again: it goes on.") from None
            raise


def made(subject: Subject) -> bool:
    """False if the embedded set is to be fitted, and was never made."""
    return bool(subject.plan.request.data) or embedded_exists(subject.app.name)


def foreseen(subject: Subject) -> Subject:
    """The subject, with nameless tasks in the place of an embedded set that was never made."""
    if made(subject):
        return subject
    other = Subject(subject.plan, run=True, strict=False, whole=subject.whole)
    tasks = [Task(f"{i}", {}) for i in range(split_counts(subject.app.name)["test"])]
    other.__dict__ |= {"fits": subject.fits, "_data": (tasks, "none")}
    return other


def cells_of(subject: Subject, tables: Sequence[str]) -> list[Cell]:
    """The cells that tables need of a subject."""
    return [cell for name in tables for cell in load_table(name).cells(subject)]


def unique(cells: Sequence[Cell]) -> list[Cell]:
    """The cells that can be measured, each once: tables share most of them."""
    return list({cell.folder.path: cell for cell in cells if cell.folder}.values())


class _Measuring:
    """What is done in the pool's processes, and what that takes."""

    def __init__(
        self, subjects: Sequence[Subject], tables: Sequence[str], pool: ProcessPoolExecutor, count: int, quiet: bool
    ) -> None:
        self.subjects, self.tables, self.pool, self.count, self.quiet = subjects, tables, pool, count, quiet
        self.waiting: list[Job] = []
        self.cells: dict[Path, Cell] = {}
        self.done = self.total = 0.0

    def say(self, line: str) -> None:
        if not self.quiet:
            say(line)

    def run(self) -> None:
        """Time a step of each application, say what all will take, and do it."""
        self.say(f"timing a step of {', '.join(subject.title for subject in self.subjects)}")
        self.paces = list(self.pool.map(_pace, range(len(self.subjects))))
        self.foresee()
        for i, (subject, pace) in enumerate(zip(self.subjects, self.paces, strict=True)):
            if made(subject):
                self.add_cells(i)
            else:
                heapq.heappush(self.waiting, Job(0, (False, pace.data), pace.data, i))
        self.began, running = time.monotonic(), dict[Future[list[str]], Job]()
        with progress("evaluate", round(self.total), quiet=self.quiet) as bar:
            while self.waiting or running:
                while self._next_can_begin(list(running.values())):
                    job = heapq.heappop(self.waiting)
                    running[self.pool.submit(_do, job)] = job
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running.pop(future)
                    self.done += job.seconds
                    self.finish(job, future.result())
                    bar.at(round(self.done), round(self.total), self.left())

    def _next_can_begin(self, running: Sequence[Job]) -> bool:
        first = self.waiting[0].stage if self.waiting else 0
        return bool(self.waiting) and len(running) < self.count and all(first <= job.stage for job in running)

    def foresee(self) -> None:
        """Say which sets must be made, how many records are missing, and how long that will take."""
        sets, records, rows = [], 0, 0
        for subject, pace in zip(self.subjects, self.paces, strict=True):
            self.total += pace.data
            sets += [] if made(subject) else [f"{subject.app.name} ({sum(split_counts(subject.app.name).values()):,})"]
            for cell in unique(cells_of(foreseen(subject), self.tables)):
                missing = len(cell.missing())
                records, rows = records + missing, rows + bool(missing)
                self.total += missing * pace.of(cell)
        if sets:
            self.say(f"data sets to make, once, and their tasks: {', '.join(dict.fromkeys(sets))}")
        self.say(
            f"{records:,} fits of {rows} rows have no record yet: {_minutes(self.total / self.count)} in {self.count} "
            "processes, by these steps; each record is kept, so that the same command goes on after Ctrl-C"
        )
        if not self.subjects[0].whole:
            self.say(f"Overfit and Finetune are fitted to {FEW} tasks of each application; --whole: to all")

    def add_cells(self, number: int) -> None:
        """Add what a subject's cells lack, in jobs of some seconds."""
        for cell in unique(cells_of(self.subjects[number], self.tables)):
            assert cell.folder
            path, missing, seconds = (
                cell.folder.path,
                [task.name for task in cell.missing()],
                self.paces[number].of(cell),
            )
            self.cells[path] = cell
            size, long = max(1, int(LONG / seconds)), seconds > LONG
            for first in range(0, len(missing), size):
                some = tuple(missing[first : first + size])
                order = (long, -seconds if long else seconds)
                heapq.heappush(self.waiting, Job(cell.stage, order, seconds * len(some), number, path, some))

    def finish(self, job: Job, lines: list[str]) -> None:
        """Say what a job said, then the row that it completes, or go on with a set that was made."""
        for line in lines:
            say(line)
        if not job.tasks:
            self.say(f"{self.subjects[job.subject].app.name}: data set made; {self.left()}")
            self.add_cells(job.subject)
        elif not self.cells[job.cell].missing():
            records = self.cells[job.cell].records()
            errors = [record["error"] for record in records if record["error"] is not None]
            seconds = [record["seconds"] for record in records if "seconds" in record]
            text = f"error {number(statistics.fmean(errors), '.3f')}, " if errors else ""
            text += f"{statistics.median(seconds):.3g} s, " if seconds else ""
            self.say(f"{self.cells[job.cell].title}: {text}{len(records)} tasks; {self.left()}")

    def left(self) -> str:
        """The time that is left, by what went before."""
        pace = (time.monotonic() - self.began) / self.done if self.done > 20 else 1 / self.count
        return f"{_minutes(pace * max(0.0, self.total - self.done))} left"


def _minutes(seconds: float) -> str:
    return f"about {round(seconds / 60)} min" if seconds >= 90 else "under 2 min"


# What a process does


class _Lines(Reporter):
    """Keeps what is said, for the process that prints."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, message: str) -> None:
        self.lines.append(message)


_here: tuple[list[Subject], Sequence[str], int]  # of this process: subjects, tables, processes


def _begin(requests: Sequence[Request], whole: bool, tables: Sequence[str], count: int) -> None:
    global _here
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all: the one that prints ends the others
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # which removes the half of a data set
    torch.set_num_threads(max(1, torch.get_num_threads() // count))
    with reporting(_Lines()):
        _here = [Subject(plan(one), run=True, strict=False, whole=whole) for one in requests], tables, count


def _do(job: Job) -> list[str]:
    """Do a job; what is to be said of it."""
    (subjects, tables, count), lines = _here, _Lines()
    subject = subjects[job.subject]
    with reporting(lines):
        if not job.tasks:
            embedded_data(subject.app.name, quiet=True)
            return lines.lines
        cell, folder = next((c, c.folder) for c in cells_of(subject, tables) if c.folder and c.folder.path == job.cell)
        assert folder
        with threads(cell.threads):
            for record, kept in cell.measure([task for task in cell.tasks if task.name in job.tasks]):
                folder.add(record | {"processes": count}, kept)
    return lines.lines


def _pace(number: int) -> Pace:
    """Time Overfit's steps on a test task, and the draw of a training task where the set must be made."""
    subject, data = _here[0][number], 0.0
    if made(subject):
        task = subject.tasks[0]
    else:
        module = embedded_module(subject.app.name)
        task = next(module.synthetic_tasks("test", 1, 0))
        begin = time.perf_counter()
        next(module.synthetic_tasks("train", 1, 0))
        data = (time.perf_counter() - begin) * sum(split_counts(subject.app.name).values())
    with threads(threads_of(subject.app)):
        fitter = Fitter(find_checkpoint(subject.plan.by("overfit", steps=TIMED)))
        fitter.fit([task])
        begin = time.perf_counter()
        seconds = fitter.fit([task])[0].record["seconds"]
        return Pace(seconds / TIMED, time.perf_counter() - begin - seconds, data)
