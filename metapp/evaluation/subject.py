"""The subject of tables: an application under a protocol on a data set, and records of its fits."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from metapp.apps import full_name
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
from metapp.storage.checkpoint_files import content_digest
from metapp.storage.fit_folders import NUMBER_ENTRIES, Record, RunFolder

LONG_FIT_STEPS = (
    30  # gradient steps, more than those of Meta and QuickFT: Overfit's and Finetune's rows take most of the time
)
LONG_FIT_TASKS = 3  # tasks of these rows, unless all are asked for

RecordMeasurement = Callable[[list[Task]], Iterator[tuple[Record, Params | None]]]


class EvaluationRun:
    """An application under a protocol, on a data set, with its records.

    Attributes:
        run: by General; rows differ in paradigm, rule or steps.
        app: the application under the protocol.
        presenter: of the application.
        title: of the application, in tables and pictures.
        measuring: whether missing records are measured when a table asks for them.
        whole: whether all rows are of all test tasks; else those of more than LONG steps are of `few` of them.
        few: number of tasks of these rows.
        runs: by the name of a row of the results: the paradigms, then meta:<rule> for further rules with a checkpoint.
        tasks: the test tasks; none if nothing is to be measured and the embedded set was never made.
        label: name of the data set in run folders.
        asked: (tasks, records of these) of all that tables asked for, by its title.
    """

    def __init__(self, run: Run, *, measuring: bool, whole: bool = True, few: int = LONG_FIT_TASKS) -> None:
        """Read all checkpoints, then the tasks: a missing one should not be found after an hour of fits.

        Args:
            run, measuring, whole, few: as the attributes.

        Raises:
            ValueError: a checkpoint is missing that fits need; if nothing is measured it is printed, and rows stay
                empty.
        """
        self.run, self.app, self.presenter, self.title = run, run.app, run.presenter, run.presenter.title
        self.measuring, self.whole, self.few = measuring, whole, few
        self.asked: dict[str, tuple[list[Task], list[Record]]] = {}
        self._tables: dict[str, Table] = {}
        self.runs: dict[str, Run] = {}
        for name in PARADIGMS:
            self.runs[name] = Run.from_options(replace(run.options, paradigm=name, steps=None))
            try:
                self.runs[name] = attach_checkpoint(self.runs[name])
            except ValueError as error:
                if measuring:
                    raise
                say(f"{error}")
        # on data of one's own the others that ship would say little
        others = run.recipe.meta if run.options.checkpoint or not run.options.data else ()
        for rule in (rule for rule in others if rule != run.options.rule):
            with suppress(ValueError):  # there is no checkpoint of this rule
                self.runs[f"meta:{rule}"] = attach_checkpoint(
                    Run.from_options(replace(run.options, paradigm="meta", rule=rule))
                )
        make_folder(run.options.out)
        self.tasks: list[Task] = []
        self.label = "none"
        if measuring or run.options.data or has_embedded_tests(run.app.name):
            self.tasks, self.label = read_test_tasks(run.app, run.options.data, run.options.quiet)

    @property
    def groups(self) -> dict[str, str]:
        """The subject that each task shows, by the task's name."""
        return {task.name: task.group or task.name for task in self.tasks}

    def tasks_of(self, name: str) -> list[Task]:
        """The tasks of a row of the results."""
        return (
            self.tasks
            if self.whole or self.runs[name].paradigm.steps <= LONG_FIT_STEPS
            else select_evenly(self.tasks, self.few)
        )

    def is_of_few(self, name: str) -> bool:
        """True if a row of the results is of some of the tasks alone."""
        return len(self.tasks_of(name)) < len(self.tasks)

    def table(self, name: str) -> Table:
        """The table of that name, made once."""
        if name not in self._tables:
            make: Callable[[EvaluationRun], Table] = registry().tables[name].load()
            self._tables[name] = make(self)
        return self._tables[name]

    def records(self, name: str) -> list[Record]:
        """The fits of a row of the results, kept as the paradigm's command does."""
        return self.fitted(name, self.runs[name], self.tasks_of(name))

    def found(self, name: str) -> list[Record]:
        """The fits of a row of the results that there are; nothing is measured."""
        _, records = self.asked.get(name) or ((), _read(self._folder(self.runs[name]), self.tasks_of(name)))
        return records

    def fitted(self, title: str, run: Run, tasks: list[Task], settings: Record | None = None) -> list[Record]:
        """Fits of tasks by a run, which has none without a checkpoint.

        Args:
            title: for the progress.
            run: by which tasks are fitted.
            tasks: to be fitted.
            settings: further ones, of fits that are no paradigm's own.
        """

        def measure(tasks: list[Task]) -> Iterator[tuple[Record, Params | None]]:
            return ((fit.record, fit.parameters) for fit in fit_tasks(run, tasks))

        return self.measured(title, self._folder(run, settings), measure, tasks, run.paradigm.steps)

    def _folder(self, run: Run, settings: Record | None = None) -> RunFolder | None:
        if run.checkpoint is None:
            return None
        path = run.path(self.label, run.paradigm.name if settings else "")
        return RunFolder(path, run.settings(self.label) | (settings or {}), NUMBER_ENTRIES)

    def measured(
        self, title: str, folder: RunFolder | None, measure: RecordMeasurement, tasks: list[Task], steps: int = 0
    ) -> list[Record]:
        """Records of tasks, in their order; missing ones are measured now, each kept as soon as its task is done.

        Args:
            title: for the progress, of these records alone.
            folder: of the records; None if they cannot be measured, as a checkpoint is missing.
            measure: tasks -> the record of each, and parameters that are kept beside it, if any; it may end early.
            tasks: to be measured.
            steps: gradient steps of a task, about, which the progress counts.
        """
        if title in self.asked:
            return self.asked[title][1]
        records = _read(folder, tasks)
        names = {record["name"] for record in records}
        missing = [task for task in tasks if task.name not in names]
        if folder and missing and self.measuring:
            name, each, total = f"{full_name(self.app)} {title}", steps + 1, (steps + 1) * len(missing)
            bars = progress("evaluate", total, long=True, quiet=self.run.options.quiet)
            with bars as bar, torch_defaults(single=self.app.single_threaded):
                bar.set_done(0, total, name)
                for i, (task, (record, tensors)) in enumerate(zip(missing, measure(missing), strict=False), 1):
                    folder.write({**record, "content": task_digest(task), "origin": self.run.input_places(())}, tensors)
                    bar.set_done(each * i, total, f"{name} {task.name}")
            records = _read(folder, tasks)
            if not self.run.options.quiet:
                say(f"{name}: {_summary_of(records)}")
        self.asked[title] = tasks, records
        return records

    def kept(
        self, kind: str, settings: Record, entries: Collection[str], rows: Collection[str] = ()
    ) -> RunFolder | None:
        """Return the folder of records that are no fits: <out>/<app>/<kind>, with the options that were given.

        Args:
            kind: of records.
            settings: everything that their figures depend on.
            entries: of records, beside the name.
            rows: of the results, whose fits the records are made of; None if one of these has no checkpoint.
        """
        runs = [self.runs[name] for name in rows]
        if not all(run.checkpoint for run in runs):
            return None
        fits = {"fits": [content_digest(run.settings(self.label)) for run in runs]} if runs else {}
        return RunFolder(self.run.path(self.label, kind), settings | fits, entries)

    def draw(self, kind: str, fits: Mapping[str, list[Record]]) -> Path | None:
        """Draw fits of several methods side by side, of the tasks that all have; None if there are none."""
        by_method = {name: {record["name"]: record for record in records} for name, records in fits.items() if records}
        common = [task for task in self.tasks if all(task.name in records for records in by_method.values())]
        if not by_method or not common:
            return None
        columns, path = [], self.run.path(self.label, kind)
        with progress(f"pictures of {self.title}", len(common[:MAX_SHEET_ROWS]), quiet=self.run.options.quiet) as bar:
            for task in common[:MAX_SHEET_ROWS]:
                shown = [(name, self.presenter, records[task.name]) for name, records in by_method.items()]
                columns.append(tiles_of_methods(task, shown))
                bar.advance()
        return write_comparison_sheet(self.presenter, columns, path.with_name(f"{path.name}.png"))


def _read(folder: RunFolder | None, tasks: list[Task]) -> list[Record]:
    finished = folder.records() if folder else {}
    return [finished[task.name] for task in tasks if task.name in finished]


def _summary_of(records: list[Record]) -> str:
    """Return the line that shows a row as soon as it is measured, before the whole table is printed."""
    errors = [record["error"] for record in records if record.get("error") is not None]
    seconds = [record["seconds"] for record in records if record.get("seconds") is not None]
    parts = [f"mean error {statistics.fmean(errors):.3f}"] if errors else []
    parts += [f"median {statistics.median(seconds):.4f} s"] if seconds else []
    return ", ".join([*parts, f"{len(records)} task{'s' * (len(records) != 1)}"])


def select_evenly(tasks: list[Task], count: int) -> list[Task]:
    """Up to so many of the tasks, evenly spaced."""
    size = min(count, len(tasks))
    return [tasks[i * len(tasks) // size] for i in range(size)]
