"""The subject of a table: an application under a protocol on a data set, and the fits behind its rows."""

from __future__ import annotations

import functools
import shlex
from collections.abc import Collection, Iterator
from contextlib import suppress

from metapp.evaluation.cell import Cell, Measure
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.paradigms import PARADIGMS
from metapp.runs.checkpoints import with_checkpoint
from metapp.runs.fitting import fit_tasks
from metapp.runs.inputs.embedded import embedded_exists
from metapp.runs.inputs.sources import tasks_of_data
from metapp.runs.naming import name_of, title_of
from metapp.runs.reporter import say
from metapp.runs.run import Run
from metapp.runs.surroundings import make_folder, threads_of
from metapp.storage.fits import FIT, Fits, Record

LONG = 30  # gradient steps, more than those of Meta and QuickFT: Overfit's and Finetune's rows take most of the time
FEW = 3  # tasks of these rows, unless all are asked for


class Subject:
    """An application under a protocol, on a data set.

    Attributes:
        plan: of the application's own network; rows differ in paradigm, rule or steps.
        run: whether cells without records will be run; else they stay empty.
        whole: whether all rows are of all test tasks; else those of more than LONG steps are of FEW of them.
    """

    def __init__(self, plan: Run, *, run: bool, strict: bool, whole: bool = True) -> None:
        """Look up nothing yet.

        Args:
            plan, run, whole: as the attributes.
            strict: whether a checkpoint that is missing is an error; else it is said, and its cells stay empty.
        """
        self.plan, self.run, self.whole = plan, run, whole
        self._strict = strict
        self._cells: dict[str, Cell] = {}

    @functools.cached_property
    def fits(self) -> dict[str, Run]:
        """The plan of each row of the results: the paradigms, then meta:<rule> for further rules with a checkpoint.

        Raises:
            ValueError: a checkpoint is missing that a row must have, and that is an error.
        """
        fits = {name: self._found(name) for name in PARADIGMS}
        options = self.plan.options
        # on data of one's own the others that ship would say little
        others = self.plan.recipe.meta if options.checkpoint or not options.data else ()
        for rule in (rule for rule in others if rule != self.plan.paradigm.rule_name):
            with suppress(ValueError):  # there is no checkpoint of this rule
                fits[f"meta:{rule}"] = with_checkpoint(self.plan.by("meta", rule))
        return fits

    def _found(self, paradigm: str) -> Run:
        """The plan of a paradigm with its checkpoint; without one where it is missing, and that is no error."""
        plan = self.plan.by(paradigm)
        try:
            return with_checkpoint(plan)
        except ValueError as error:
            if self._strict:
                raise
            say(f"{error}")
            return plan

    @property
    def app(self) -> App:
        """The application under the protocol."""
        return self.plan.app

    @property
    def title(self) -> str:
        """As tables and pictures call it."""
        return title_of(self.app)

    @functools.cached_property
    def _data(self) -> tuple[list[Task], str]:
        options = self.plan.options
        make_folder(options.out)
        if not self.run and not options.data and not embedded_exists(self.app.name):
            return [], "none"  # there are no records of a data set that was never made
        return tasks_of_data(self.app, options.data, options.quiet)

    @property
    def tasks(self) -> list[Task]:
        """The test tasks; none where nothing is to be run and the embedded set was never made."""
        return self._data[0]

    @property
    def label(self) -> str:
        """The data set's name in run folders."""
        return self._data[1]

    def cell(self, name: str) -> Cell:
        """The fits behind a row of the results."""
        if name not in self._cells:
            self._cells[name] = self.fit_cell(name, self.fits[name])
        return self._cells[name]

    def is_of_few(self, name: str) -> bool:
        """True if the fits behind a row of the results are of some of the tasks alone."""
        return len(self.cell(name).tasks) < len(self.tasks)

    def fit_cell(self, title: str, plan: Run, settings: Record | None = None, name: str = "") -> Cell:
        """Fits of all tasks as a cell, kept as the command of the paradigm keeps them.

        Args:
            title: for the progress.
            plan: how tasks are fitted.
            settings: what else the figures depend on.
            name: added to the run folder's, where it is no paradigm's own.
        """
        fits = None
        if plan.checkpoint is not None:
            path = plan.path(self.label)
            path = path.with_name(f"{path.name}-{name}") if name else path
            fits = Fits(path, plan.settings(self.label) | (settings or {}), FIT, plan.origin(()))

        def measure(tasks: list[Task]) -> Iterator[tuple[Record, Params | None]]:
            return ((fit.record, fit.parameters) for fit in fit_tasks(plan, tasks))

        return self.make_cell(title, fits, measure, plan.steps)

    def make_cell(self, title: str, fits: Fits | None, measure: Measure, steps: int = 0) -> Cell:
        """A cell of the application's threads; other entries by `Cell._replace`."""
        tasks = self.tasks if self.whole or steps <= LONG else evenly(self.tasks, FEW)
        return Cell(f"{name_of(self.app)} {title}", tasks, fits, measure, steps, threads=threads_of(self.app))

    def kept(self, kind: str, settings: Record, entries: Collection[str], *, of_fits: bool = False) -> Fits:
        """Where records are kept: <out>/<app>/<kind>, with what is not the default.

        Args:
            kind: of records.
            settings: everything that their figures depend on.
            entries: of records, beside the name.
            of_fits: whether they are of fits of several paradigms: with the rule.
        """
        path = self.plan.path(self.label, kind, self.plan.paradigm.rule_name if of_fits else "")
        return Fits(path, settings, entries, self.plan.origin(()))

    def command(self, which: str) -> str:
        """The command that fills a table for this application."""
        words = ["metapp", "evaluate", self.app.name, "--which", which, *shared_words(self.plan)]
        words += ["--whole"] if self.whole else []
        words += (
            ["--rule", self.plan.paradigm.rule_name] if self.plan.paradigm.rule_name != self.plan.recipe.rule else []
        )
        return shlex.join(words)


def evenly(tasks: list[Task], count: int) -> list[Task]:
    """Up to so many of the tasks, evenly spaced."""
    size = min(count, len(tasks))
    return [tasks[i * len(tasks) // size] for i in range(size)]


def shared_words(plan: Run) -> list[str]:
    """The options that commands of one evaluation share."""
    options, protocol = plan.options, plan.app.protocol
    words = ["--out", str(options.out), "--recipe", options.recipe]
    words += ["--observe", protocol] if protocol else []
    words += ["--checkpoint", str(options.checkpoint)] if options.checkpoint else []
    return words + ["--seed", str(options.seed)] + (["--data", str(options.data)] if options.data else [])
