"""The subject of tables: an application under a protocol on a data set, and records of its fits."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from metapp.evaluation.table import Table
from metapp.learning.task import Params, Task
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.checkpoints import with_checkpoint
from metapp.runs.fitting import fit_tasks
from metapp.runs.inputs.embedded import embedded_exists
from metapp.runs.inputs.sources import content_of, tasks_of_data
from metapp.runs.naming import name_of, title_of
from metapp.runs.outputs.pictures import COMPARED, column_of, write_compared
from metapp.runs.reporter import progress, say
from metapp.runs.run import Run
from metapp.runs.surroundings import make_folder, threads, threads_of
from metapp.storage.fits import FIT, Fits, Record

LONG = 30  # gradient steps, more than those of Meta and QuickFT: Overfit's and Finetune's rows take most of the time
FEW = 3  # tasks of these rows, unless all are asked for

Measure = Callable[[list[Task]], Iterator[tuple[Record, Params | None]]]


class Subject:
    """An application under a protocol, on a data set, with what has been measured of it.

    Attributes:
        plan: of General; rows differ in paradigm, rule or steps.
        app: the application under the protocol.
        title: of the application, in tables and pictures.
        run: whether missing records are measured when a table asks for them.
        whole: whether all rows are of all test tasks; else those of more than LONG steps are of FEW of them.
        fits: the plan of each row of the results: the paradigms, then meta:<rule> for further rules with a checkpoint.
        tasks: the test tasks; none where nothing is to be run and the embedded set was never made.
        label: name of the data set in run folders.
        asked: (tasks, records of these) of all that tables asked for, by its title.
    """

    def __init__(self, plan: Run, *, run: bool, strict: bool = False, whole: bool = True) -> None:
        """Find all checkpoints, since a missing one should not be found after an hour, then read the tasks.

        Args:
            plan, run, whole: as the attributes.
            strict: whether a missing checkpoint is an error; else it is said, and rows that need it stay empty.

        Raises:
            ValueError: a checkpoint is missing, and that is an error; without General's nothing can be measured.
        """
        self.plan, self.app, self.title = plan, plan.app, title_of(plan.app)
        self.run, self.whole = run, whole
        self.asked: dict[str, tuple[int, int]] = {}
        self._records: dict[str, list[Record]] = {}
        self._tables: dict[str, Table] = {}
        self.fits: dict[str, Run] = {}
        for name in PARADIGMS:
            self.fits[name] = plan.by(name)
            try:
                self.fits[name] = with_checkpoint(self.fits[name])
            except ValueError as error:
                if strict or (run and name == "general"):
                    raise
                say(f"{error}")
        # on data of one's own the others that ship would say little
        others = plan.recipe.meta if plan.options.checkpoint or not plan.options.data else ()
        for rule in (rule for rule in others if rule != plan.paradigm.rule_name):
            with suppress(ValueError):  # there is no checkpoint of this rule
                self.fits[f"meta:{rule}"] = with_checkpoint(plan.by("meta", rule))
        make_folder(plan.options.out)
        self.tasks: list[Task] = []
        self.label = "none"
        if run or plan.options.data or embedded_exists(plan.app.name):
            self.tasks, self.label = tasks_of_data(plan.app, plan.options.data, plan.options.quiet)

    @property
    def groups(self) -> dict[str, str]:
        """The subject that each task shows, by the task's name."""
        return {task.name: task.group or task.name for task in self.tasks}

    def tasks_of(self, name: str) -> list[Task]:
        """The tasks of a row of the results."""
        return self.tasks if self.whole or self.fits[name].steps <= LONG else evenly(self.tasks, FEW)

    def is_of_few(self, name: str) -> bool:
        """True if a row of the results is of some of the tasks alone."""
        return len(self.tasks_of(name)) < len(self.tasks)

    def table(self, name: str) -> Table:
        """The table of that name, made once."""
        if name not in self._tables:
            make: Callable[[Subject], Table] = registry().tables[name].load()
            self._tables[name] = make(self)
        return self._tables[name]

    def records(self, name: str, *, found: bool = False) -> list[Record]:
        """The fits of a row of the results, kept as the paradigm's command does; `found` as of `measured`."""
        return self.fitted(name, self.fits[name], self.tasks_of(name), found=found)

    def fitted(
        self, title: str, plan: Run, tasks: list[Task], settings: Record | None = None, *, found: bool = False
    ) -> list[Record]:
        """Fits of tasks by a plan.

        Args:
            title: for the progress.
            plan: how tasks are fitted; without a checkpoint there are no fits.
            tasks: to be fitted.
            settings: what else the figures depend on, where they are no paradigm's own; `rule` names the folder.
            found: as of `measured`.
        """
        fits = None
        if plan.checkpoint is not None:
            path, more = plan.path(self.label), settings or {}
            path = path.with_name(f"{path.name}-{more['rule']}") if more else path
            fits = Fits(path, plan.settings(self.label) | more, FIT, plan.origin(()))

        def measure(tasks: list[Task]) -> Iterator[tuple[Record, Params | None]]:
            return ((fit.record, fit.parameters) for fit in fit_tasks(plan, tasks))

        return self.measured(title, fits, measure, tasks, plan.steps, found=found)

    def measured(
        self, title: str, fits: Fits | None, measure: Measure, tasks: list[Task], steps: int = 0, *, found: bool = False
    ) -> list[Record]:
        """Records of tasks, in their order; missing ones are measured now, each kept as soon as its task is done.

        Args:
            title: for the progress, of these records alone.
            fits: where records are kept; None where they cannot be measured, as a checkpoint is missing.
            measure: tasks -> the record of each, and parameters that are kept beside it, if any; it may end early.
            tasks: to be measured.
            steps: gradient steps of a task, about.
            found: whether only records that there are count; nothing is measured.
        """

        def read() -> list[Record]:
            finished = fits.records() if fits else {}
            return [finished[task.name] for task in tasks if task.name in finished]

        records = self._records[title] if title in self._records else read()
        if not found and title not in self.asked:
            names = {record["name"] for record in records}
            missing = [task for task in tasks if task.name not in names]
            if fits and missing and self.run:
                self._measure(title, fits, measure, missing, steps)
                records = read()
            self.asked[title] = len(tasks), len(records)
        self._records[title] = records
        return records

    def _measure(self, title: str, fits: Fits, measure: Measure, tasks: list[Task], steps: int) -> None:
        """Measure tasks; the progress counts gradient steps."""
        name, each = f"{name_of(self.app)} {title}", steps + 1
        quiet = self.plan.options.quiet
        with progress("evaluate", each * len(tasks), long=True, quiet=quiet) as bar, threads(threads_of(self.app)):
            bar.at(0, each * len(tasks), name)
            for i, (task, (record, tensors)) in enumerate(zip(tasks, measure(tasks), strict=False), 1):
                fits.write({**record, "content": content_of(task)}, tensors)
                bar.at(each * i, each * len(tasks), f"{name} {task.name}")

    def kept(self, kind: str, settings: Record, entries: Collection[str], *, of_fits: bool = False) -> Fits:
        """Where records are kept that are no fits: <out>/<app>/<kind>, with what is not the default.

        Args:
            kind: of records.
            settings: everything that their figures depend on.
            entries: of records, beside the name.
            of_fits: whether they are of fits of several paradigms: with the rule.
        """
        path = self.plan.path(self.label, kind, self.plan.paradigm.rule_name if of_fits else "")
        return Fits(path, settings, entries, self.plan.origin(()))

    def draw(self, kind: str, fits: Mapping[str, list[Record]]) -> Path | None:
        """Draw fits of several methods side by side, of the tasks that all have; None where there are none."""
        by_method = {name: {record["name"]: record for record in records} for name, records in fits.items() if records}
        common = [task for task in self.tasks if all(task.name in records for records in by_method.values())]
        if not by_method or not common:
            return None
        options, columns = self.plan.options, []
        with progress(f"pictures of {self.title}", len(common[:COMPARED]), quiet=options.quiet) as bar:
            for task in common[:COMPARED]:
                shown = [(name, self.app, records[task.name]) for name, records in by_method.items()]
                columns.append(column_of(task, shown))
                bar.advance()
        words = [kind, self.label, options.recipe, f"seed{options.seed}", *filter(None, [self.app.protocol])]
        return write_compared(self.app, columns, options.out / self.app.name / f"{'-'.join(words)}.png")

    def command(self, which: str) -> str:
        """The command that fills a table for this application."""
        options, plan = self.plan.options, self.plan
        given = {
            "which": which,
            "out": options.out,
            "recipe": options.recipe,
            "observe": plan.app.protocol,
            "checkpoint": options.checkpoint,
            "seed": str(options.seed),
            "data": options.data,
            "rule": plan.paradigm.rule_name if plan.paradigm.rule_name != plan.recipe.rule else "",
        }
        words = [word for name, value in given.items() if value for word in (f"--{name}", str(value))]
        return shlex.join(["metapp", "evaluate", self.app.name, *words, *["--whole"] * self.whole])


def evenly(tasks: list[Task], count: int) -> list[Task]:
    """Up to so many of the tasks, evenly spaced."""
    size = min(count, len(tasks))
    return [tasks[i * len(tasks) // size] for i in range(size)]
