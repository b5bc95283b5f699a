"""An evaluation: one application, whose fits all see the same, on one data set, with the records of its fits.

Tables and figures ask an :class:`EvaluationRun` for records, so that a fit is read where it was made before, is made
once where it is missing, and is kept. The module knows neither what a table shows nor how it is printed.
"""

from __future__ import annotations

import functools
import statistics
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from msgspec import structs

from metapp.evaluation.table import Table
from metapp.learning.task import Params, Task
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.checkpoint_selection import Checkpoint, find_checkpoint
from metapp.runs.choice import Choice, find_and_choose
from metapp.runs.data_sets.embedded import has_embedded_tests, is_embedded
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.fitter import Fitter
from metapp.runs.inputs.run_inputs import read_test_tasks, task_digest
from metapp.runs.outputs.contact_sheet import MAX_SHEET_ROWS, tiles_of_methods, write_comparison_sheet
from metapp.runs.reporter import progress, say
from metapp.storage.files import content_digest
from metapp.storage.fit_records import FitRecord, Settings
from metapp.storage.fit_store import FitStore

# gradient steps; Meta and QuickFT take fewer, while Overfit and Finetune take more, and most of the time of a table
LONG_FIT_STEPS = 30
LONG_FIT_TASKS = 2  # test tasks that are fitted by more than LONG_FIT_STEPS steps, unless the user asks for all

RecordMeasurement = Callable[[list[Task]], Iterator[tuple[FitRecord, Params | None]]]


class EvaluationRun:
    """An application, whose fits all see the same, on a data set, with the records of its fits.

    A "row of the results" is a paradigm, or "meta:<rule>" for a further learned rule that has a checkpoint.

    Attributes:
        choice: General's choice, with the options of the command; other rows differ in paradigm, rule or steps.
        app: the network of the fits, what they see and how they are judged.
        presenter: the application's presenter, which draws its fits.
        title: the application's title in tables and pictures.
        is_measuring: whether missing records are measured when a table asks for them.
        whole: whether all rows cover all test tasks; otherwise rows of more than LONG_FIT_STEPS steps cover fewer.
        long_fit_tasks: the number of test tasks in these rows.
        choices: the choice of each row of the results, by the row's name.
        fitters: what fits the tasks of these rows; a row whose checkpoint is missing has none.
        tasks: the test tasks; empty if nothing is to be measured and the embedded data set was never drawn.
        label: the data set's name in run folders.
        requested: tasks that tables asked for and records of these tasks, by the title of the records.
    """

    def __init__(
        self, choice: Choice, *, is_measuring: bool, whole: bool = True, long_fit_tasks: int = LONG_FIT_TASKS
    ) -> None:
        """Read all checkpoints, then the tasks, so that a missing checkpoint is found before any fit.

        Args:
            choice: General's choice, with the options of the command.
            is_measuring: whether missing records are measured when a table asks for them.
            whole: whether all rows cover all test tasks.
            long_fit_tasks: the number of test tasks in rows of long fits, unless `whole`.

        Raises:
            ValueError: a checkpoint that fits need is missing. If nothing is measured, the message is printed instead,
                and the rows of this checkpoint stay empty.
        """
        self.choice, self.app, self.presenter = choice, choice.app, choice.presenter
        self.title = choice.presenter.title
        self.is_measuring, self.whole, self.long_fit_tasks = is_measuring, whole, long_fit_tasks
        self.requested: dict[str, tuple[list[Task], list[FitRecord]]] = {}
        self._tables: dict[str, Table] = {}
        options = choice.options
        self.choices: dict[str, Choice] = {}
        checkpoints: dict[str, Checkpoint] = {}
        for name in PARADIGMS:
            self.choices[name] = find_and_choose(replace(options, paradigm=name, steps=None))
            try:
                checkpoints[name] = find_checkpoint(self.choices[name])
            except ValueError as error:
                if is_measuring:
                    raise
                say(f"{error}")
        # the checkpoints that ship for further rules were not trained on the user's data: their rows would say little
        rules = choice.recipe.meta if options.checkpoint or not options.data else ()
        for rule in (rule for rule in rules if rule != options.rule):
            rule_choice = find_and_choose(replace(options, paradigm="meta", rule=rule))
            with suppress(ValueError):  # no checkpoint was trained by this rule
                checkpoints[f"meta:{rule}"] = find_checkpoint(rule_choice)
                self.choices[f"meta:{rule}"] = rule_choice
        make_folder(options.out)
        self.tasks: list[Task] = []
        self.label = "none"
        if is_measuring or options.data or has_embedded_tests(choice.application):
            self.tasks, self.label = read_test_tasks(choice.application, choice.app, options.data, options.quiet)
        self.fitters = {
            name: Fitter(self.choices[name], checkpoint, self.label) for name, checkpoint in checkpoints.items()
        }

    @property
    def observes_default(self) -> bool:
        """Whether fits see what they see by default, as the paper's do."""
        return self.app.observes == self.choice.application.default_observation

    @functools.cached_property
    def has_paper_figures(self) -> bool:
        """Whether the paper's figures stand beside ours: on embedded tasks alone, where fits see what the paper's do.

        Errors on a user's own data say nothing beside errors on other data.
        """
        data = self.choice.options.data
        return self.observes_default and (data is None or is_embedded(data))

    @property
    def groups(self) -> dict[str, str]:
        """The group of each task, by the task's name; tasks of one group show the same thing."""
        return {task.name: task.group or task.name for task in self.tasks}

    def tasks_of(self, name: str) -> list[Task]:
        """Return the test tasks of a row of the results."""
        if self.whole or self.choices[name].paradigm.steps <= LONG_FIT_STEPS:
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

    def records(self, name: str) -> list[FitRecord]:
        """Return the records of a row of the results, kept where the paradigm's command keeps them."""
        return self.fit_records(name, self.fitters.get(name), self.tasks_of(name))

    def existing_records(self, name: str) -> list[FitRecord]:
        """Return the records of a row of the results that exist; nothing is measured."""
        _, records = self.requested.get(name) or (
            (),
            _read_records(self._store(self.fitters.get(name)), self.tasks_of(name)),
        )
        return records

    def fit_records(
        self, title: str, fitter: Fitter | None, tasks: list[Task], settings: Mapping[str, Any] = MappingProxyType({})
    ) -> list[FitRecord]:
        """Fit tasks where records are missing, and return all records.

        Args:
            title: the name of these records in progress lines.
            fitter: what fits the tasks; None if its checkpoint is missing, so that there are no records.
            tasks: the tasks to fit.
            settings: further settings of fits that no command makes, such as those of the ablation.
        """
        steps = fitter.choice.paradigm.steps if fitter else 0

        def measure(tasks: list[Task]) -> Iterator[tuple[FitRecord, Params | None]]:
            assert fitter is not None  # without a fitter there is no store, and nothing is measured
            return ((fit.record, fit.parameters) for fit in fitter.fit_one_by_one(tasks))

        return self.measure_records(title, self._store(fitter, settings), measure, tasks, steps)

    def _store(self, fitter: Fitter | None, settings: Mapping[str, Any] = MappingProxyType({})) -> FitStore | None:
        """Return the folder of a fitter's fits; None without a fitter."""
        if fitter is None:
            return None
        if not settings:
            return fitter.store
        choice, digest = fitter.choice, fitter.checkpoint.digest
        entries = fitter.settings.document() | dict(settings)
        path = choice.folder(self.label, choice.paradigm.name, digest)
        return FitStore(path, Settings.of(entries), timed=True)

    def measure_records(
        self, title: str, store: FitStore | None, measure: RecordMeasurement, tasks: list[Task], steps: int = 0
    ) -> list[FitRecord]:
        """Measure missing records of tasks, each kept as soon as its task is done, and return all in the tasks' order.

        Args:
            title: the name of these records in progress lines and in `requested`.
            store: the folder of these records; None if they cannot be measured, as a checkpoint is missing.
            measure: yields for each of the given tasks its record, and parameters to keep beside it or None. It may end
                early.
            tasks: the tasks whose records are wanted.
            steps: about how many gradient steps a task takes; the progress counts them.
        """
        if title in self.requested:
            return self.requested[title][1]
        records = _read_records(store, tasks)
        names = {record.name for record in records}
        missing = [task for task in tasks if task.name not in names]
        if store and missing and self.is_measuring:
            row_name, task_steps, total = f"{self.app.full_name} {title}", steps + 1, (steps + 1) * len(missing)
            bars = progress("evaluate", total, long=True, quiet=self.choice.options.quiet)
            with bars as bar, torch_defaults(single=self.app.small_tensors):
                bar.set_done(0, total, row_name)
                for count, (task, (record, tensors)) in enumerate(zip(missing, measure(missing), strict=False), 1):
                    origin = self.choice.origin(())
                    store.write(structs.replace(record, content=task_digest(task), origin=origin), tensors)
                    bar.set_done(task_steps * count, total, f"{row_name} {task.name}")
            records = _read_records(store, tasks)
            if not self.choice.options.quiet:
                say(f"{row_name}: {_summarise(records)}")
        self.requested[title] = tasks, records
        return records

    def record_store(
        self, kind: str, settings: Settings, figures: Collection[str], rows: Collection[str] = ()
    ) -> FitStore | None:
        """Return the folder of records that are no fits: <out>/<app>/<kind>, with the options that were given.

        Args:
            kind: the kind of these records, such as "trace".
            settings: all settings that the records' figures depend on.
            figures: the names of the figures that each record must have.
            rows: rows of the results whose fits the records are made of.

        Returns:
            The folder; None if one of the rows has no checkpoint.
        """
        if not all(name in self.fitters for name in rows):
            return None
        digests = [content_digest(self.fitters[name].settings.document()) for name in rows]
        further = settings.further | ({"fits": digests} if rows else {})
        return FitStore(self.choice.folder(self.label, kind), structs.replace(settings, further=further), figures)

    def draw_fits(self, kind: str, fits: Mapping[str, list[FitRecord]]) -> Path | None:
        """Draw fits of several methods side by side, for the test tasks that all methods fitted.

        Args:
            kind: the kind of the picture, which its file is named by.
            fits: the records of each method, by the method's name.

        Returns:
            The path of the picture; None if no task was fitted by all methods.
        """
        by_method = {name: {record.name: record for record in records} for name, records in fits.items() if records}
        common = [task for task in self.tasks if all(task.name in records for records in by_method.values())]
        if not by_method or not common:
            return None
        tiles, path = [], self.choice.folder(self.label, kind)
        with progress(
            f"pictures of {self.title}", len(common[:MAX_SHEET_ROWS]), quiet=self.choice.options.quiet
        ) as bar:
            for task in common[:MAX_SHEET_ROWS]:
                task_fits = [(name, self.presenter, records[task.name]) for name, records in by_method.items()]
                tiles.append(tiles_of_methods(task, task_fits))
                bar.advance()
        return write_comparison_sheet(self.presenter, tiles, path.with_name(f"{path.name}.png"))


def _read_records(store: FitStore | None, tasks: list[Task]) -> list[FitRecord]:
    """Return the records of tasks that a folder holds, in the tasks' order."""
    finished = store.records() if store else {}
    return [finished[task.name] for task in tasks if task.name in finished]


def _summarise(records: list[FitRecord]) -> str:
    """Return the words that report a row as soon as it is measured, before the whole table is printed."""
    errors = [record.error for record in records if record.error is not None]
    seconds = [record.seconds for record in records if record.seconds is not None]
    figures = [f"mean error {statistics.fmean(errors):.3f}"] if errors else []
    figures += [f"median {statistics.median(seconds):.4f} s"] if seconds else []
    return ", ".join([*figures, f"{len(records)} task{'s' * (len(records) != 1)}"])


def select_evenly(tasks: list[Task], count: int) -> list[Task]:
    """Return up to `count` of the tasks, evenly spaced."""
    size = min(count, len(tasks))
    return [tasks[i * len(tasks) // size] for i in range(size)]
