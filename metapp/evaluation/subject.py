"""What a table is about: an application under a protocol on a data set, and the fits behind its rows."""

from __future__ import annotations

import functools
import shlex
from contextlib import suppress
from typing import Any, NamedTuple

from metapp.appearance.presentation import Presentation
from metapp.apps import presentation_of
from metapp.evaluation.cell import Cell, Measure
from metapp.evaluation.study import Budget, Study
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.paradigms import Job, Paradigm, paradigms
from metapp.runs.checkpoints import find_checkpoint, trained_path
from metapp.runs.embedded import embedded_exists
from metapp.runs.fits import fit_tasks
from metapp.runs.inputs import tasks_to_fit
from metapp.runs.origin import origin_of
from metapp.runs.reporter import say
from metapp.runs.run import run_path
from metapp.runs.session import Checkpoint, Options, make_folder, name_of, settings_of, threads_of, title_of
from metapp.storage.records import FIT, RunFolder


class Fit(NamedTuple):
    """What a row of the results is fitted by: `name` is the paradigm's, or meta:<rule> for rules but the default."""

    name: str
    options: Options
    paradigm: Paradigm
    checkpoint: Checkpoint | None

    @property
    def job(self) -> Job:
        """Application, recipe, rule and steps."""
        return self.options.job

    @property
    def app(self) -> App:
        """The application with the network of the rule."""
        return self.options.app

    @property
    def steps(self) -> int:
        """Gradient steps."""
        return self.paradigm.count(self.job)


class Subject:
    """An application under a protocol, on a data set.

    Attributes:
        options: of the default row; others differ in rule or steps.
        run: whether cells without records will be run; else they stay empty.
        share: of the recipe's steps that Overfit takes here.
    """

    def __init__(
        self, options: Options, *, run: bool, strict: bool, share: float = 1.0, budget: Budget | None = None
    ) -> None:
        """Look up nothing yet.

        Args:
            options, run, share: as the attributes.
            strict: whether a checkpoint that is missing is an error; else it is said, and its cells stay empty.
            budget: how much the table of rules trains.
        """
        self.options, self.run, self.share = options, run, share
        self._strict, self._budget = strict, budget or Budget()
        self._cells: dict[str, Cell] = {}

    @functools.cached_property
    def fits(self) -> dict[str, Fit]:
        """How each row of the results is fitted: the paradigms, then meta:<rule> for further rules with a checkpoint.

        Raises:
            ValueError: a checkpoint is missing that a row must have, and that is an error.
        """
        options, known = self.options, paradigms()
        fits = {name: self._fit_of(name, options.by(paradigm), paradigm) for name, paradigm in known.items()}
        others = [rule for rule in options.job.recipe.meta if rule != options.rule]
        if options.data:  # beside checkpoints of this data, none that was trained on other data
            others = [rule for rule in others if trained_path(options, rule).is_file()]
        for rule in others:
            by_rule = options._replace(rule=rule).by(known["meta"])
            with suppress(ValueError):  # nobody trained this rule
                checkpoint = find_checkpoint(by_rule, known["meta"])
                fits[f"meta:{rule}"] = Fit(f"meta:{rule}", by_rule, known["meta"], checkpoint)
        return fits

    def _fit_of(self, name: str, options: Options, paradigm: Paradigm) -> Fit:
        if name == "overfit" and self.share != 1:
            options = options._replace(steps=max(1, round(self.share * options.job.recipe.overfit_steps)))
        try:
            return Fit(name, options, paradigm, find_checkpoint(options, paradigm))
        except ValueError as error:
            if self._strict:
                raise
            say(f"{error}")
            return Fit(name, options, paradigm, None)

    @functools.cached_property
    def study(self) -> Study:
        """What the table of rules is about."""
        return Study(self.options, self._budget)

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
            name: added to the run folder's, where it is no paradigm's own.
        """
        options, paradigm, checkpoint = fit.options, fit.paradigm, fit.checkpoint
        if checkpoint is None:
            return self.make_cell(fit.name, None, _nothing, fit.steps, command=_fit_command(fit))
        all_settings = settings_of(options, paradigm, checkpoint, self.label) | (settings or {})
        path = run_path(options, all_settings, self.label)
        path = path.with_name(f"{path.name}-{name}") if name else path
        folder = RunFolder(path, all_settings, FIT, origin_of(options))
        command = self.command() if name else _fit_command(fit)
        measure = functools.partial(fit_tasks, options, paradigm, checkpoint)
        return self.make_cell(fit.name, folder, measure, fit.steps, command=command)

    def make_cell(
        self, title: str, folder: RunFolder | None, measure: Measure, steps: int = 0, *, command: str
    ) -> Cell:
        """A cell of all tasks, of the application's threads; other entries by `Cell._replace`."""
        title = f"{name_of(self.app)} {title}"
        return Cell(title, self.tasks, folder, measure, steps, command, threads=threads_of(self.app))

    def folder(self, kind: str, settings: dict[str, Any], form: dict[str, Any], *, of_fits: bool = False) -> RunFolder:
        """Where records are kept: <out>/<app>/<kind>/<data>-<recipe>-seed<seed>, with the protocol.

        Args:
            kind: of records, a folder.
            settings: everything that their figures depend on.
            form: what records hold.
            of_fits: whether they are of fits of several paradigms: with the rule and Overfit's share.
        """
        options = self.options
        shortened = f"overfit{self.share:g}" if self.share != 1 else ""
        words = [self.label, options.recipe, f"seed{options.seed}", *([options.rule, shortened] if of_fits else [])]
        path = options.out / self.app.name / kind / "-".join(filter(None, (*words, self.app.protocol)))
        return RunFolder(path, settings, form, origin_of(options))

    def command(self, which: str = "") -> str:
        """The command that fills a table for this application."""
        words = ["metapp", "evaluate", self.app.name, *(["--which", which] if which else []), *_shared(self.options)]
        return shlex.join([*words, *(["--overfit-share", f"{self.share:g}"] if self.share != 1 else [])])


def evenly(tasks: list[Task], count: int) -> list[Task]:
    """Up to so many of the tasks, evenly spaced."""
    size = min(count, len(tasks))
    return [tasks[i * len(tasks) // size] for i in range(size)]


def _nothing(tasks: list[Task]) -> Any:
    return iter(())


def _fit_command(fit: Fit) -> str:
    """The command that makes what is missing of a paradigm's fits."""
    options, paradigm = fit.options, fit.paradigm.name
    words = ["metapp", paradigm, options.app.name, *_shared(options)]
    words += ["--steps", str(options.steps)] if options.steps is not None else []
    words += ["--rule", options.rule] if paradigm == "meta" else []
    return shlex.join(words + (["--train"] if fit.checkpoint is None else []))


def _shared(options: Options) -> list[str]:
    """The options that commands of one evaluation share."""
    words = ["--out", str(options.out), "--recipe", options.recipe]
    words += ["--observe", options.app.protocol] if options.app.protocol else []
    return words + ["--seed", str(options.seed)] + (["--data", str(options.data)] if options.data else [])
