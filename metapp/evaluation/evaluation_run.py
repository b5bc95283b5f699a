"""An evaluation: one application, whose fits all see the same, on one data set, with the records of its fits.

Tables and figures ask an :class:`EvaluationRun` for records, so that a fit is read where it was made before, is made
once where it is missing, and is kept. The module knows neither what a table shows nor how it is printed.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from metapp.evaluation.table import Table
from metapp.learning.task import Params, Task
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.checkpoint_selection import attach_checkpoint
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.fitting import fit_tasks
from metapp.runs.inputs.embedded import has_embedded_tests
from metapp.runs.inputs.run_inputs import read_test_tasks, task_digest
from metapp.runs.outputs.contact_sheet import MAX_SHEET_ROWS, tiles_of_methods, write_comparison_sheet
from metapp.runs.reporter import progress, say
from metapp.runs.run import Run
from metapp.storage.files import content_digest
from metapp.storage.fit_folders import NUMBER_ENTRIES, Record, RunFolder

# gradient steps; Meta and QuickFT take fewer, while Overfit and Finetune take more, and most of the time of a table
LONG_FIT_STEPS = 30
LONG_FIT_TASKS = 2  # test tasks that are fitted by more than LONG_FIT_STEPS steps, unless the user asks for all

RecordMeasurement = Callable[[list[Task]], Iterator[tuple[Record, Params | None]]]


class EvaluationRun:
    """An application, whose fits all see the same, on a data set, with the records of its fits.

    A "row of the results" is a paradigm, or "meta:<rule>" for a further learned rule that has a checkpoint.

    Attributes:
        run: General's run, with the options of the command; other rows differ in paradigm, rule or steps.
        app: the network of the fits, what they see and how they are judged.
        presenter: the application's presenter, which draws its fits.
        title: the application's title in tables and pictures.
        is_measuring: whether missing records are measured when a table asks for them.
        whole: whether all rows cover all test tasks; otherwise rows of more than LONG_FIT_STEPS steps cover fewer.
        long_fit_tasks: the number of test tasks in these rows.
        runs: the run of each row of the results, by the row's name.
        tasks: the test tasks; empty if nothing is to be measured and the embedded data set was never drawn.
        label: the data set's name in run folders.
        requested: tasks that tables asked for and records of these tasks, by the title of the records.
    """

    def __init__(
        self, run: Run, *, is_measuring: bool, whole: bool = True, long_fit_tasks: int = LONG_FIT_TASKS
    ) -> None:
        """Read all checkpoints, then the tasks, so that a missing checkpoint is found before any fit.

        Args:
            run: General's run, with the options of the command.
            is_measuring: whether missing records are measured when a table asks for them.
            whole: whether all rows cover all test tasks.
            long_fit_tasks: the number of test tasks in rows of long fits, unless `whole`.

        Raises:
            ValueError: a checkpoint that fits need is missing. If nothing is measured, the message is printed instead,
                and the rows of this checkpoint stay empty.
        """
        self.run, self.app, self.presenter, self.title = run, run.app, run.presenter, run.presenter.title
        self.is_measuring, self.whole, self.long_fit_tasks = is_measuring, whole, long_fit_tasks
        self.requested: dict[str, tuple[list[Task], list[Record]]] = {}
        self._tables: dict[str, Table] = {}
        self.runs: dict[str, Run] = {}
        for name in PARADIGMS:
            self.runs[name] = Run.from_options(replace(run.options, paradigm=name, steps=None))
            try:
                self.runs[name] = attach_checkpoint(self.runs[name])
            except ValueError as error:
                if is_measuring:
                    raise
                say(f"{error}")
        # the checkpoints that ship for further rules were not trained on the user's data: their rows would say little
        rules = run.recipe.meta if run.options.checkpoint or not run.options.data else ()
        for rule in (rule for rule in rules if rule != run.options.rule):
            with suppress(ValueError):  # no checkpoint was trained by this rule
                self.runs[f"meta:{rule}"] = attach_checkpoint(
                    Run.from_options(replace(run.options, paradigm="meta", rule=rule))
                )
        make_folder(run.options.out)
        self.tasks: list[Task] = []
        self.label = "none"
        if is_measuring or run.options.data or has_embedded_tests(run.application):
            self.tasks, self.label = read_test_tasks(run.application, run.app, run.options.data, run.options.quiet)

    @property
    def observes_default(self) -> bool:
        """Whether fits see what they see by default, as the paper's do."""
        return self.app.observes == self.run.application.default_observation

    @property
    def groups(self) -> dict[str, str]:
        """The group of each task, by the task's name; tasks of one group show the same thing."""
        return {task.name: task.group or task.name for task in self.tasks}

    def tasks_of(self, name: str) -> list[Task]:
        """Return the test tasks of a row of the results."""
        if self.whole or self.runs[name].paradigm.steps <= LONG_FIT_STEPS:
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

    def records(self, name: str) -> list[Record]:
        """Return the records of a row of the results, kept where the paradigm's command keeps them."""
        return self.fit_records(name, self.runs[name], self.tasks_of(name))

    def existing_records(self, name: str) -> list[Record]:
        """Return the records of a row of the results that exist; nothing is measured."""
        _, records = self.requested.get(name) or ((), _read_records(self._folder(self.runs[name]), self.tasks_of(name)))
        return records

    def fit_records(self, title: str, run: Run, tasks: list[Task], settings: Record | None = None) -> list[Record]:
        """Fit tasks by a run where records are missing, and return all records.

        Args:
            title: the name of these records in progress lines.
            run: the run that fits the tasks; a run without a checkpoint has no records.
            tasks: the tasks to fit.
            settings: further settings of fits that no command makes, such as those of the ablation.
        """

        def measure(tasks: list[Task]) -> Iterator[tuple[Record, Params | None]]:
            return ((fit.record, fit.parameters) for fit in fit_tasks(run, tasks))

        return self.measure_records(title, self._folder(run, settings), measure, tasks, run.paradigm.steps)

    def _folder(self, run: Run, settings: Record | None = None) -> RunFolder | None:
        """Return the folder of a run's fits, or None if the run lacks its checkpoint."""
        if run.checkpoint is None:
            return None
        path = run.path(self.label, run.paradigm.name if settings else "")
        return RunFolder(path, run.settings(self.label) | (settings or {}), NUMBER_ENTRIES)

    def measure_records(
        self, title: str, folder: RunFolder | None, measure: RecordMeasurement, tasks: list[Task], steps: int = 0
    ) -> list[Record]:
        """Measure missing records of tasks, each kept as soon as its task is done, and return all in the tasks' order.

        Args:
            title: the name of these records in progress lines and in `requested`.
            folder: the folder of these records; None if they cannot be measured, as a checkpoint is missing.
            measure: yields for each of the given tasks its record, and parameters to keep beside it or None. It may end
                early.
            tasks: the tasks whose records are wanted.
            steps: about how many gradient steps a task takes; the progress counts them.
        """
        if title in self.requested:
            return self.requested[title][1]
        records = _read_records(folder, tasks)
        names = {record["name"] for record in records}
        missing = [task for task in tasks if task.name not in names]
        if folder and missing and self.is_measuring:
            row_name, task_steps, total = f"{self.app.full_name} {title}", steps + 1, (steps + 1) * len(missing)
            bars = progress("evaluate", total, long=True, quiet=self.run.options.quiet)
            with bars as bar, torch_defaults(single=self.app.small_tensors):
                bar.set_done(0, total, row_name)
                for count, (task, (record, tensors)) in enumerate(zip(missing, measure(missing), strict=False), 1):
                    folder.write({**record, "content": task_digest(task), "origin": self.run.input_places(())}, tensors)
                    bar.set_done(task_steps * count, total, f"{row_name} {task.name}")
            records = _read_records(folder, tasks)
            if not self.run.options.quiet:
                say(f"{row_name}: {_summarise(records)}")
        self.requested[title] = tasks, records
        return records

    def record_folder(
        self, kind: str, settings: Record, entries: Collection[str], rows: Collection[str] = ()
    ) -> RunFolder | None:
        """Return the folder of records that are no fits: <out>/<app>/<kind>, with the options that were given.

        Args:
            kind: the kind of these records, such as "trace".
            settings: all settings that the records' figures depend on.
            entries: the entries that each record must have, beside its name.
            rows: rows of the results whose fits the records are made of.

        Returns:
            The folder; None if one of the rows has no checkpoint.
        """
        runs = [self.runs[name] for name in rows]
        if not all(run.checkpoint for run in runs):
            return None
        fits = {"fits": [content_digest(run.settings(self.label)) for run in runs]} if runs else {}
        return RunFolder(self.run.path(self.label, kind), settings | fits, entries)

    def draw_fits(self, kind: str, fits: Mapping[str, list[Record]]) -> Path | None:
        """Draw fits of several methods side by side, for the test tasks that all methods fitted.

        Args:
            kind: the kind of the picture, which its file is named by.
            fits: the records of each method, by the method's name.

        Returns:
            The path of the picture; None if no task was fitted by all methods.
        """
        by_method = {name: {record["name"]: record for record in records} for name, records in fits.items() if records}
        common = [task for task in self.tasks if all(task.name in records for records in by_method.values())]
        if not by_method or not common:
            return None
        tiles, path = [], self.run.path(self.label, kind)
        with progress(f"pictures of {self.title}", len(common[:MAX_SHEET_ROWS]), quiet=self.run.options.quiet) as bar:
            for task in common[:MAX_SHEET_ROWS]:
                task_fits = [(name, self.presenter, records[task.name]) for name, records in by_method.items()]
                tiles.append(tiles_of_methods(task, task_fits))
                bar.advance()
        return write_comparison_sheet(self.presenter, tiles, path.with_name(f"{path.name}.png"))


def _read_records(folder: RunFolder | None, tasks: list[Task]) -> list[Record]:
    """Return the records of tasks that a folder holds, in the tasks' order."""
    finished = folder.records() if folder else {}
    return [finished[task.name] for task in tasks if task.name in finished]


def _summarise(records: list[Record]) -> str:
    """Return the words that report a row as soon as it is measured, before the whole table is printed."""
    errors = [record["error"] for record in records if record.get("error") is not None]
    seconds = [record["seconds"] for record in records if record.get("seconds") is not None]
    figures = [f"mean error {statistics.fmean(errors):.3f}"] if errors else []
    figures += [f"median {statistics.median(seconds):.4f} s"] if seconds else []
    return ", ".join([*figures, f"{len(records)} task{'s' * (len(records) != 1)}"])


def select_evenly(tasks: list[Task], count: int) -> list[Task]:
    """Return up to `count` of the tasks, evenly spaced."""
    size = min(count, len(tasks))
    return [tasks[i * len(tasks) // size] for i in range(size)]
