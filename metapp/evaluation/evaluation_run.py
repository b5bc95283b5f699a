"""An evaluation: one application, whose fits all see the same, on one data set, with its fits.

Tables and figures ask an :class:`EvaluationRun` for fits, so that a fit is read where it was made before, is made once
where it is missing, and is kept. The module knows neither what a table shows nor how it is printed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from metapp.evaluation.table import Table
from metapp.learning.task import Task
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.data_sets.embedded import has_embedded_tests, is_embedded, make_embedded_test_set
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fit_pictures import tiles_of_methods, write_comparison_sheet
from metapp.runs.fit_tables import summarise
from metapp.runs.fitting import Fitter, fit_tasks_of
from metapp.runs.inputs.finding import DATA_SET_FORMAT, content_of, data_label, find_in_data_set
from metapp.runs.outputs.contact_sheet import MAX_SHEET_ROWS
from metapp.runs.reporter import progress, say
from metapp.runs.resolve import app_of, complete, presenter_of, recipe_of
from metapp.runs.spec import RunOptions, Spec, given_words
from metapp.runs.stored_fits import read_fits_of_spec

# gradient steps; Meta and QuickFT take fewer, while Overfit and Finetune take more, and most of the time of a table
LONG_FIT_STEPS = 30
LONG_FIT_TASKS = 2  # test tasks that are fitted by more than LONG_FIT_STEPS steps, unless the user asks for all

MeasureTasks = Callable[[list[Task]], Iterator[Fit]]


class EvaluationRun:
    """An application, whose fits all see the same, on a data set, with its fits.

    A "row of the results" is a paradigm, or "meta:<rule>" for a further learned rule that has a checkpoint.

    Attributes:
        given: the specification as the command gives it; rows differ in paradigm, rule or steps.
        options: the options of the command.
        app: the network of the fits, what they see and how they are judged.
        presenter: the application's presenter, which draws its fits.
        title: the application's title in tables and pictures.
        is_measuring: whether missing fits are made when a table asks for them.
        whole: whether all rows cover all test tasks; otherwise rows of more than LONG_FIT_STEPS steps cover fewer.
        long_fit_tasks: the number of test tasks in these rows.
        specs: the complete specification of each row of the results, by the row's name.
        fitters: what fits the tasks of these rows; a row whose checkpoint is missing has none.
        tasks: the test tasks; empty if nothing is to be measured and the embedded data set was never drawn.
        label: the label of the data set.
        requested: tasks that tables asked for and fits of these tasks, by the title of the fits.
    """

    def __init__(
        self,
        given: Spec,
        options: RunOptions,
        *,
        is_measuring: bool,
        whole: bool = True,
        long_fit_tasks: int = LONG_FIT_TASKS,
    ) -> None:
        """Read all checkpoints, then the tasks, so that a missing checkpoint is found before any fit.

        Args:
            given: the specification as the command gives it.
            options: the options of the command.
            is_measuring: whether missing fits are made when a table asks for them.
            whole: whether all rows cover all test tasks.
            long_fit_tasks: the number of test tasks in rows of long fits, unless `whole`.

        Raises:
            ValueError: a checkpoint that fits need is missing. If nothing is measured, the message is printed instead,
                and the rows of this checkpoint stay empty.
        """
        application = given.application
        general = complete(replace(given, paradigm="general"), trained=False)
        self.given, self.options, self.app = given, options, app_of(general)
        self.presenter = presenter_of(general, self.app)
        self.title = self.presenter.title
        self.is_measuring, self.whole, self.long_fit_tasks = is_measuring, whole, long_fit_tasks
        self.requested: dict[str, tuple[list[Task], list[Fit]]] = {}
        self._tables: dict[str, Table] = {}
        self.specs: dict[str, Spec] = {}
        self.fitters: dict[str, Fitter] = {}
        for name in PARADIGMS:
            self.specs[name] = complete(self.given_row(name), trained=False)
            try:
                self.fitters[name] = Fitter.of(complete(self.given_row(name)))
            except ValueError as error:
                if is_measuring:
                    raise
                say(f"{error}")
        # the checkpoints that ship for further rules were not trained on the user's data: their rows would say little
        rules = recipe_of(general).meta if given.checkpoint or not options.data else ()
        for name in (f"meta:{rule}" for rule in rules if rule != self.specs["meta"].rule):
            with suppress(ValueError):  # no checkpoint was trained by this rule
                self.fitters[name] = Fitter.of(complete(self.given_row(name)))
                self.specs[name] = self.fitters[name].spec
        make_folder(options.out)
        self.tasks: list[Task] = []
        self.label, self.data_folder = "none", options.data
        if is_measuring or options.data or has_embedded_tests(application):
            self.data_folder = options.data or make_embedded_test_set(application, options.quiet)
            self.tasks = [one.read_task(general, self.app) for one in find_in_data_set(general, self.data_folder)]
            self.label = data_label(self.data_folder)
        self.specs = {name: replace(spec, data=self.label) for name, spec in self.specs.items()}
        self.fitters = {
            name: fitter._replace(spec=replace(fitter.spec, data=self.label)) for name, fitter in self.fitters.items()
        }

    def given_row(self, name: str) -> Spec:
        """Return the specification of a row of the results as a user would give it."""
        paradigm, _, rule = name.partition(":")
        is_learned = PARADIGMS[paradigm].has_learned_rule
        return replace(self.given, paradigm=paradigm, rule=(rule or self.given.rule) if is_learned else "")

    @property
    def observes_default(self) -> bool:
        """Whether fits see what they see by default, as the paper's do."""
        return self.app.observes == self.given.application.default_observation

    @functools.cached_property
    def has_paper_figures(self) -> bool:
        """Whether the paper's figures stand beside ours: on embedded tasks alone, where fits see what the paper's do.

        Errors on a user's own data say nothing beside errors on other data.
        """
        data = self.options.data
        return self.observes_default and (data is None or is_embedded(data))

    @property
    def groups(self) -> dict[str, str]:
        """The group of each task, by the task's name; tasks of one group show the same thing."""
        return {task.name: task.group or task.name for task in self.tasks}

    def steps(self, name: str) -> int:
        """Return the number of gradient steps of a row of the results."""
        return self.specs[name].steps or 0

    def tasks_of(self, name: str) -> list[Task]:
        """Return the test tasks of a row of the results."""
        if self.whole or self.steps(name) <= LONG_FIT_STEPS:
            return self.tasks
        return select_evenly(self.tasks, self.long_fit_tasks)

    def is_of_subset(self, name: str) -> bool:
        """Return whether a row of the results covers only a subset of the test tasks."""
        return len(self.tasks_of(name)) < len(self.tasks)

    def table(self, name: str) -> Table:
        """Return the table that the registry has under this name; it is made once."""
        if name not in self._tables:
            make: Callable[[EvaluationRun], Table] = registry().tables[name].load()
            self._tables[name] = make(self)
        return self._tables[name]

    def folder(self, kind: str, given: Spec | None = None) -> Path:
        """Return the folder of fits, or of records of a kind, by the words by which they were asked for.

        Args:
            kind: the kind of the records, which stands in place of the paradigm; "" for fits.
            given: the specification of fits as a user would give it; None for General's.
        """
        label = self.label if self.options.data else ""
        words = given_words(replace(given or self.given, paradigm=kind or (given or self.given).paradigm), label)
        return self.options.out / self.app.name / words

    def fits(self, name: str) -> list[Fit]:
        """Return the fits of a row of the results, made where they are missing."""
        return self.fits_by(name, self.folder("", self.given_row(name)), self.fitters.get(name), self.tasks_of(name))

    def existing_fits(self, name: str) -> list[Fit]:
        """Return the fits of a row of the results that exist; nothing is measured."""
        if name in self.requested or name not in self.fitters:
            return self.requested.get(name, ((), []))[1]
        return self._read(self.folder("", self.given_row(name)), self.fitters[name].spec, self.tasks_of(name))

    def fits_by(self, title: str, folder: Path, fitter: Fitter | None, tasks: list[Task]) -> list[Fit]:
        """Fit tasks where fits are missing, and return all fits.

        Args:
            title: the name of these fits in progress lines.
            folder: the folder of the fits.
            fitter: what fits the tasks; None if its checkpoint is missing, so that there are no fits.
            tasks: the tasks to fit.
        """
        if fitter is None:
            return self.measure(title, folder, None, lambda tasks: iter(()), tasks)
        return self.measure(
            title,
            folder,
            fitter.spec,
            lambda tasks: (fit for task in tasks for fit in fit_tasks_of(fitter, [task])),
            tasks,
            fitter.method.steps,
        )

    def measure(
        self, title: str, folder: Path, spec: Spec | None, measure: MeasureTasks, tasks: list[Task], steps: int = 0
    ) -> list[Fit]:
        """Measure tasks that have no fit yet, each kept as soon as it is done, and return all fits in the tasks' order.

        Args:
            title: the name of these fits in progress lines and in `requested`.
            folder: the folder of these fits.
            spec: their specification; None if they cannot be measured, as a checkpoint is missing.
            measure: yields for each of the given tasks its fit. It may end early.
            tasks: the tasks whose fits are wanted.
            steps: about how many gradient steps a task takes; the progress counts them.
        """
        if title in self.requested:
            return self.requested[title][1]
        fits = self._read(folder, spec, tasks) if spec else []
        names = {fit.name for fit in fits}
        missing = [task for task in tasks if task.name not in names]
        if spec and missing and self.is_measuring:
            row_name, task_steps, total = f"{self.app.full_name} {title}", steps + 1, (steps + 1) * len(missing)
            bars = progress("evaluate", total, long=True, quiet=self.options.quiet)
            with bars as bar, torch_defaults(single=self.app.small_tensors):
                bar.set_done(0, total, row_name)
                for count, (task, fit) in enumerate(zip(missing, measure(missing), strict=False), 1):
                    fit.spec, fit.format, fit.content = spec, DATA_SET_FORMAT, content_of(task)
                    fit.inputs = [str(self.data_folder.absolute())] if self.data_folder else []
                    fit.keep(folder)
                    bar.set_done(task_steps * count, total, f"{row_name} {task.name}")
            fits = self._read(folder, spec, tasks)
            if not self.options.quiet:
                say(f"{row_name}: {_summarise(fits)}")
        self.requested[title] = tasks, fits
        return fits

    def _read(self, folder: Path, spec: Spec, tasks: list[Task]) -> list[Fit]:
        """Return the fits of tasks that a folder holds, in the tasks' order."""
        finished = read_fits_of_spec(folder, spec)
        fits = [(task, finished[task.name]) for task in tasks if task.name in finished]
        for task, fit in fits:
            fit.name, fit.task = task.name, task
        return [fit for _, fit in fits]

    def spec_of_kind(self, kind: str, conditions: Mapping[str, Any], rows: Collection[str] = ()) -> Spec | None:
        """Return the specification of records that are no fits by a paradigm, such as traces.

        Args:
            kind: the kind of these records.
            conditions: all that the records' figures depend on.
            rows: rows of the results whose fits the records are made of.

        Returns:
            The specification; None if one of the rows has no checkpoint.
        """
        if not all(name in self.fitters for name in rows):
            return None
        fits = {"fits": [self.fitters[name].spec.key for name in rows]} if rows else {}
        conditions = {"method": kind, **conditions, **fits}
        recipe, observe = self.specs["general"].recipe, self.app.observes
        return Spec(
            app=self.app.name, paradigm="", observe=observe, recipe=recipe, data=self.label, conditions=conditions
        )

    def draw_fits(self, kind: str, fits: Mapping[str, list[Fit]]) -> Path | None:
        """Draw fits of several methods side by side, for the test tasks that all methods fitted.

        Args:
            kind: the kind of the picture, which its file is named by.
            fits: the fits of each method, by the method's name.

        Returns:
            The path of the picture; None if no task was fitted by all methods.
        """
        by_method = {name: {fit.name: fit for fit in method_fits} for name, method_fits in fits.items() if method_fits}
        common = [task for task in self.tasks if all(task.name in fits for fits in by_method.values())]
        if not by_method or not common:
            return None
        tiles, path = [], self.folder(kind)
        shown = common[:MAX_SHEET_ROWS]
        with progress(f"pictures of {self.title}", len(shown), quiet=self.options.quiet) as bar:
            for task in shown:
                tiles.append(tiles_of_methods(task, [(name, fits[task.name]) for name, fits in by_method.items()]))
                bar.advance()
        return write_comparison_sheet(self.presenter, tiles, path.with_name(f"{path.name}.png"))


def _summarise(fits: list[Fit]) -> str:
    """Return the words that report a row as soon as it is measured, before the whole table is printed."""
    totals = summarise(fits)
    figures = [] if totals["error"] is None else [f"mean error {totals['error']:.3f}"]
    figures += [] if totals["seconds"] is None else [f"median {totals['seconds']:.4f} s"]
    return ", ".join([*figures, f"{len(fits)} task{'s' * (len(fits) != 1)}"])


def select_evenly(tasks: list[Task], count: int) -> list[Task]:
    """Return up to `count` of the tasks, evenly spaced."""
    size = min(count, len(tasks))
    return [tasks[i * len(tasks) // size] for i in range(size)]
