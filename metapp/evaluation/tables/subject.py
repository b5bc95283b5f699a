"""What tables are about: an application under a protocol on a data set, and the cells that are measured of it."""

from __future__ import annotations

import functools
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from metapp.appearance.presentation import Presentation
from metapp.apps import presentation_of
from metapp.evaluation.study import Budget, Study
from metapp.evaluation.tables.rows import Row, blank
from metapp.evaluation.tables.statistics import Paired, paired, statistics_of
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.paradigms import Paradigm, paradigms
from metapp.runs.checkpoints import find_checkpoint, trained_path
from metapp.runs.embedded import embedded_exists
from metapp.runs.inputs import tasks_to_fit
from metapp.runs.origin import origin_of
from metapp.runs.reporter import say
from metapp.runs.run import fit_and_keep, run_path
from metapp.runs.session import (
    Checkpoint,
    Options,
    is_first_protocol,
    make_folder,
    name_of,
    observe_of,
    settings_of,
    threads_of,
    title_of,
)
from metapp.storage.records import FIT, RunFolder, guarded, summary

Record = dict[str, Any]


class Cell(NamedTuple):
    """Something that is measured on each of some tasks and kept as records, as soon as a task is done.

    Attributes:
        title: for the progress.
        tasks: what it is measured on.
        folder: where records are kept; None where the checkpoint is missing that it needs.
        measure: missing tasks -> their records, each kept before it is passed on.
        steps: gradient steps a task, about: cells with few come first.
        command: the command that fills it.
        stage: cells of a lower stage come first, which this one reads.
        threads: that torch works with meanwhile; None: as many as it does.
        guess: seconds that a task takes beside its steps, about, before any was measured.
    """

    title: str
    tasks: Sequence[Task]
    folder: RunFolder | None
    measure: Callable[[list[Task]], Iterator[Record]]
    steps: int
    command: str
    stage: int = 0
    threads: int | None = None
    guess: float = 0.0

    def records(self) -> list[Record]:
        """Those there are, in the order of the tasks."""
        finished = self.folder.finished() if self.folder else {}
        return [finished[task.name] for task in self.tasks if task.name in finished]

    def missing(self) -> list[Task]:
        """The tasks that have no record yet."""
        finished = self.folder.finished() if self.folder else {}
        return [task for task in self.tasks if task.name not in finished]


class Fit(NamedTuple):
    """What a row of the results is fitted by: `name` is the paradigm's, or meta:<rule> for rules but the default."""

    name: str
    options: Options
    paradigm: Paradigm
    checkpoint: Checkpoint | None


def error_in(record: Record) -> float | None:
    """The table's error of a task; None where it holds no reference."""
    result: float | None = record["error"]
    return result


class Subject:
    """An application under a protocol, on a data set.

    Attributes:
        options: of the default row; others differ in rule or steps.
        run: whether cells without records will be run; else they stay empty.
        strict: whether a checkpoint that is missing is an error; else it is said, and its cells stay empty.
        share: of the recipe's steps that Overfit takes here.
        budget: how much the table of rules trains.
    """

    def __init__(
        self, options: Options, *, run: bool, strict: bool, share: float = 1.0, budget: Budget | None = None
    ) -> None:
        self.options, self.run, self.strict, self.share, self.budget = options, run, strict, share, budget or Budget()
        self._cells: dict[str, Cell] = {}

    @functools.cached_property
    def fits(self) -> dict[str, Fit]:
        """How each row of the results is fitted, by name.

        Raises:
            ValueError: a checkpoint is missing, and that is an error.
        """
        return {fit.name: fit for fit in _find_fits(self.options, self.strict, self.share)}

    def find_checkpoints(self) -> None:
        """Find all checkpoints now, not at the first row that needs one."""
        assert self.fits

    @functools.cached_property
    def study(self) -> Study:
        """What the table of rules is about."""
        return Study(self.options, self.budget)

    @property
    def app(self) -> App:
        """The application under the protocol."""
        return self.options.app

    @functools.cached_property
    def presentation(self) -> Presentation[Any]:
        """What tables and pictures need of the application."""
        return presentation_of(self.app)

    @property
    def title(self) -> str:
        """As tables and pictures call it."""
        return title_of(self.app)

    @property
    def shortened(self) -> str:
        """What names say of an Overfit of fewer steps than the recipe's; "" where there is nothing to say."""
        return f"overfit{self.share:g}" if self.share != 1 else ""

    @property
    def key(self) -> tuple[str, str]:
        """Application and protocol: what makes a table."""
        return self.app.name, self.app.protocol

    @functools.cached_property
    def _data(self) -> tuple[list[Task], str]:
        make_folder(self.options.out)
        if not self.run and not self.options.data and not embedded_exists(self.app.name):
            return [], "none"  # there are no records of a data set that was never made
        return tasks_to_fit(self.app, [], self.options.data, self.options.quiet)

    @property
    def tasks(self) -> list[Task]:
        """The test tasks; none where nothing is to be run and the embedded set was never made."""
        return self._data[0]

    @property
    def label(self) -> str:
        """The data set's name in run folders."""
        return self._data[1]

    def some(self, count: int) -> list[Task]:
        """Up to so many of the test tasks, evenly spaced."""
        size = min(count, len(self.tasks))
        return [self.tasks[i * len(self.tasks) // size] for i in range(size)]

    def cell(self, name: str) -> Cell:
        """The fits behind a row of the results."""
        if name not in self._cells:
            self._cells[name] = self.fit_cell(self.fits[name])
        return self._cells[name]

    def fit_cell(self, fit: Fit, settings: dict[str, Any] | None = None, name: str = "") -> Cell:
        """Fits of all tasks as a cell, kept as the command of the paradigm keeps them.

        Args:
            fit: by what.
            settings: what else the figures depend on.
            name: of the run folder, where it is no paradigm's.
        """
        options, paradigm, checkpoint = fit.options, fit.paradigm, fit.checkpoint
        folder = None
        if checkpoint is not None:
            said = settings_of(options, paradigm, checkpoint, self.label) | (settings or {})
            path = run_path(options, said, self.label)
            path = path.with_name(f"{path.name}-{name}") if name else path
            folder = RunFolder(path, said, FIT, origin_of(options))

        def measure(missing: list[Task]) -> Iterator[Record]:
            assert folder is not None
            assert checkpoint is not None
            return fit_and_keep(options, paradigm, checkpoint, missing, folder)

        steps = paradigm.count(options.job)
        command = self.command("") if name else _fit_command(fit)
        title, threads = f"{name_of(self.app)} {fit.name}", threads_of(self.app)
        return Cell(title, self.tasks, folder, measure, steps, command, threads=threads)

    def command(self, which: str) -> str:
        """The command that fills a table for this application."""
        words = ["metapp", "evaluate", self.app.name, *(["--which", which] if which else []), *_shared(self.options)]
        return shlex.join([*words, *(["--overfit-share", f"{self.share:g}"] if self.share != 1 else [])])

    def row(self, name: str, cell: Cell, take: Callable[[Record], float | None] = error_in, **more: Any) -> Row:
        """A row of what a cell has measured, with the statistics of one measure.

        Args:
            name: the paradigm, as the row calls it.
            cell: its records.
            take: the measure of a record; None where it has none.
            more: further or other entries.
        """
        records = cell.records()
        values = {record["name"]: value for record in records if (value := take(record)) is not None}
        groups = self.groups(cell)
        said = statistics_of(list(values.values()), [groups[each] for each in values])
        seconds = summary(records)["seconds"] if records and "seconds" in records[0] else None
        row = blank(self.app.name, name, **observe_of(self.app))
        if not self.is_papers or name.startswith("meta:"):  # the paper's fits see what those of the first protocol see
            row |= {"paper_error": None, "paper_seconds": None}
        return (
            row | said | {"seconds": seconds, "tasks": len(records), **remarks(records)} | more | self.app.conditions()
        )

    def groups(self, cell: Cell) -> dict[str, str]:
        """What each task of a cell shows, by its name."""
        return {task.name: task.group or task.name for task in cell.tasks}

    def paired(self, one: Cell, other: Cell) -> Paired | None:
        """The fits of a cell compared with another's, by their errors of the same tasks."""
        ours, theirs = (
            {record["name"]: record["error"] for record in cell.records() if record["error"] is not None}
            for cell in (one, other)
        )
        return paired(ours, theirs, self.groups(one), logarithmic=self.presentation.logarithmic)

    @property
    def is_papers(self) -> bool:
        """Whether fits see what the paper's do."""
        return is_first_protocol(self.app)


def remarks(records: Sequence[Record]) -> Row:
    """How many fits carry a warning, on how many the guard acted, and the threads, where records say so."""
    threads = sorted({record["threads"] for record in records if record.get("threads")})
    return {
        "warnings": sum(bool(record.get("warning")) for record in records),
        "guarded": guarded(records),
        "threads": ", ".join(map(str, threads)) or None,
    }


def _find_fits(options: Options, strict: bool, share: float) -> list[Fit]:
    """What one application's rows are fitted from: the paradigms, then Meta by further rules that have a checkpoint.

    Raises:
        ValueError: a checkpoint is missing that a row must have, and that is an error.
    """
    each = paradigms()
    others = [rule for rule in options.job.recipe.meta if rule != options.rule]
    if options.data:  # beside checkpoints of this data, none that was trained on other data
        others = [rule for rule in others if trained_path(options, rule).is_file()]
    fits: list[Fit] = []
    for name, paradigm in each.items():
        of = options.by(paradigm)
        if name == "overfit" and share != 1:
            of = options._replace(steps=max(1, round(share * options.job.recipe.overfit_steps)))
        try:
            fits.append(Fit(name, of, paradigm, find_checkpoint(of, paradigm)))
        except ValueError as error:
            if strict:
                raise
            say(f"{error}")
            fits.append(Fit(name, of, paradigm, None))
    for rule in others:
        with suppress(ValueError):  # nobody trained this rule
            of = options._replace(rule=rule).by(each["meta"])
            fits.append(Fit(f"meta:{rule}", of, each["meta"], find_checkpoint(of, each["meta"])))
    return fits


def _fit_command(fit: Fit) -> str:
    """The command that makes what is missing of a paradigm's fits."""
    options, paradigm = fit.options, fit.paradigm
    words = ["metapp", paradigm.name, options.app.name, *_shared(options)]
    words += ["--steps", str(options.steps)] if options.steps is not None else []
    words += (["--rule", options.rule] if paradigm.name == "meta" else []) + (
        ["--train"] if fit.checkpoint is None else []
    )
    return shlex.join(words)


def _shared(options: Options) -> list[str]:
    """The options that commands of one evaluation share."""
    words = ["--out", str(options.out), "--recipe", options.recipe]
    words += ["--observe", options.app.protocol] if options.app.protocol else []
    return words + ["--seed", str(options.seed)] + (["--data", str(options.data)] if options.data else [])
