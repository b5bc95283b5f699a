"""Execute a plan: one run that reads, fits and keeps its inputs, batch by batch."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.learning.task import Params, Task
from metapp.paradigms import ranks
from metapp.runs.checkpoints.finding import find_checkpoint, tuned_by
from metapp.runs.checkpoints.training import train_checkpoint
from metapp.runs.fits.fitter import Fitter
from metapp.runs.inputs.sources import Source, content_of, numbered, sources_to_fit
from metapp.runs.naming import name_of, observe_of
from metapp.runs.outputs.files import OUTPUTS, export_fit, listed, outputs_of, write_files, write_outputs
from metapp.runs.outputs.pictures import COMPARED, Column, column_of_fit, picture_of_run
from metapp.runs.plan import Plan
from metapp.runs.reporter import Bar, Reporter, number, progress, reporting, say
from metapp.runs.surroundings import make_folder, threads_of
from metapp.runs.torch_state import threads
from metapp.storage import Document
from metapp.storage.files import named
from metapp.storage.records import FIT, RunFolder, file_name, guarded, summary

FORESEEN = (ValueError, OSError, FloatingPointError, MemoryError)  # what is wrong with inputs and fits


class Failure(NamedTuple):
    """An input that was not fitted, or a form that a fit was not written in.

    Attributes:
        source: its place.
        reason: the error, with the source named.
        counted: whether the run fails by it; not by a damaged file that was found in a folder, unless with --batch.
        kept: whether the fit is kept, and only an export was not written.
    """

    source: str
    reason: str
    counted: bool = True
    kept: bool = False


class Run(NamedTuple):
    """Fits by a plan, and where they are.

    Attributes:
        plan: with its checkpoint.
        records: of all fits, those of earlier calls among them.
        folder: where records and parameters are.
        failures: what was not fitted, or not exported.
        remarks: what outputs say of themselves.
        tasks_per_second: of what was fitted now, all that takes time counted: reading, fitting, keeping, pictures; None
            where there was nothing left to fit.
        picture: of up to 20 fits beside their references.
    """

    plan: Plan
    records: list[Document]
    folder: RunFolder
    failures: list[Failure]
    remarks: list[str]
    tasks_per_second: float | None
    picture: Path

    @property
    def made(self) -> Path | None:
        """The folder of what fits made for their user; None where nothing."""
        folder = self.folder.path / OUTPUTS
        return folder if folder.is_dir() else None

    def document(self) -> Document:
        """The object that --json prints."""
        plan, settings = self.plan, self.folder.settings
        fields = ("name", "error", "seconds", "counts", "note", "warning")
        document = {
            "app": plan.app.name,
            **observe_of(plan.app),
            "paradigm": settings["paradigm"],
            "rule": settings["rule"],
            "steps": settings["steps"],
            "device": str(plan.device),
            "data": settings["data"],
            **plan.app.conditions(),
            **{key: settings[key] for key in ("precision",) if key in settings},
            **summary(self.records),
            "guarded": guarded(self.records),
            "tasks": [{key: record[key] for key in fields if key in record} for record in self.records],
            "out": str(self.folder.path),
        }
        if plan.options.resumes:
            failures = [{"source": failure.source, "reason": failure.reason} for failure in self.failures]
            document |= {"tasks_per_second": self.tasks_per_second, "failures": failures}
        return document


def execute(plan: Plan) -> Run | None:
    """Train the checkpoint, if that is asked for, then fit all inputs as one run.

    Returns:
        The run; None on all but the first of several ranks, which train alone.

    Raises:
        ValueError: bad inputs, no checkpoint, a folder that cannot be written to; nothing could be fitted.
        FloatingPointError: training is not finite.
    """
    with threads(threads_of(plan.app)):
        if ranks.number() > 0:
            if plan.options.train:
                with reporting(Reporter()):
                    _with_checkpoint(replace(plan, options=replace(plan.options, quiet=True)))
            return None
        make_folder(plan.options.out)
        sources, label = sources_to_fit(plan)
        plan = replace(plan, checkpoint=_with_checkpoint(plan).checkpoint)
        folder = _folder(plan, label)
        return _run(plan, sources, folder)


def _with_checkpoint(plan: Plan) -> Plan:
    """The plan with its checkpoint, trained first if that is asked for, by all ranks together."""
    if plan.options.train:
        with ranks.joined(plan.device):
            trained = train_checkpoint(plan, plan.options.train_steps)
        if plan.paradigm.name == "quickft" and trained.general:  # which may ship
            return replace(plan, checkpoint=tuned_by(trained.general, trained.prepared.phi, trained.path))
        plan = replace(plan, options=replace(plan.options, checkpoint=trained.path))
    return find_checkpoint(plan) if ranks.number() == 0 else plan


def _folder(plan: Plan, label: str) -> RunFolder:
    """The folder of a run; seconds of fits side by side are shares: those have one of their own."""
    settings, path = plan.settings(label), plan.path(label)
    if _is_batched(plan):
        settings, path = settings | {"batched": True}, path.with_name(f"{path.name}-batch")
    return RunFolder(path, settings, FIT, plan.origin())


def _is_batched(plan: Plan) -> bool:
    return (plan.options.batch or 1) > 1


def _run(plan: Plan, sources: list[Source], folder: RunFolder) -> Run:
    loop = _Loop(plan, sources, folder)
    if not plan.options.quiet:
        _announce(plan, len(sources), len(loop.records) if plan.options.resumes else 0)
    begin = time.perf_counter()
    with progress(plan.paradigm.name, len(sources), done=len(loop.records), quiet=plan.options.quiet) as bar:
        loop.fit(bar)
    rate = loop.count / (time.perf_counter() - begin) if loop.count else None
    if not loop.records:
        reason = loop.failures[0].reason
        several = f"none of {len(sources)} inputs could be fitted; the first: " if len(sources) > 1 else ""
        raise ValueError(f"{several}{reason}")
    for form, names in loop.exported.items():
        say(f"written as {form}: {listed(folder.path / form, names)}")
    places = dict.fromkeys(source.place for source in sources)
    records = [loop.records[place] for place in places if place in loop.records]
    return Run(plan, records, folder, loop.failures, loop.remarks, rate, loop.picture(records))


def _announce(plan: Plan, count: int, finished: int) -> None:
    assert plan.checkpoint is not None
    what = f"{name_of(plan.app)} {plan.paradigm.name}: {count} input{'s' * (count != 1)}"
    what += f", {finished} fitted before" if finished else ""
    say(f"{what}; {plan.steps} steps, from {plan.checkpoint.source}")


class _Loop:
    """Reads, fits and keeps the inputs of a run.

    Attributes:
        records: of inputs that are fitted and have not changed since, by their places.
        count: how many were fitted now.
        exported: the names of fits by the form that they were written in.
        failures: what was not fitted, or not exported.
        remarks: what outputs say of themselves.
    """

    def __init__(self, plan: Plan, sources: list[Source], folder: RunFolder) -> None:
        self.plan, self.sources, self.folder = plan, sources, folder
        self.count = 0
        self.exported: dict[str, list[str]] = {}
        self.failures: list[Failure] = []
        self.remarks: list[str] = []
        earlier = {record.get("source", name): record for name, record in folder.finished().items()}
        self.records = {
            source.place: earlier[source.place]
            for source in sources
            if source.place in earlier and earlier[source.place].get("stamp", "") == source.stamp
        }
        if not plan.options.resumes and len(self.records) == len(sources):
            self.records, earlier = {}, {}  # a finished run is run anew, one that was cut off is completed
        self._earlier = earlier
        # of tasks by name: sources of different stems may hold tasks of one name
        self._places: dict[str, str] = {record["name"]: place for place, record in earlier.items()}
        self._fitter = Fitter(plan, warns=True)
        self._outputs = outputs_of(plan.options)
        self._columns: dict[str, Column] = {}
        self._bar = Bar()

    def fit(self, bar: Bar) -> None:
        """Fit inputs that have no record and keep each fit; a bar shows each."""
        self._bar, size = bar, self.plan.options.batch or 1
        left = [source for source in self.sources if source.place not in self.records]
        for first in range(0, len(left), size):
            for group in alike(self._read(left[first : first + size])):
                self._fit(group)

    def picture(self, records: list[Document]) -> Path:
        """Write the picture of the first fits beside their references."""
        first = [source for source in self.sources if source.place in self.records][:COMPARED]
        for source in first:
            if source.place not in self._columns:  # fitted by an earlier call
                self._add_column(source, source.task(), self.folder.theta(self.records[source.place]["name"]))
        columns = [(self._columns[source.place], self.records[source.place]) for source in first]
        return picture_of_run(self.plan.app, self.plan.paradigm.name, columns, records, self.folder.path)

    def _add_column(self, source: Source, task: Task, theta: Params) -> None:
        with torch.no_grad():
            self._columns[source.place] = column_of_fit(self.plan.app, task, theta)

    def _fail(self, source: Source, error: Exception) -> None:
        resumes = self.plan.options.resumes
        if not (resumes or isinstance(error, FORESEEN)):
            raise error
        self.failures.append(Failure(source.place, str(named(error, Path(source.place))), resumes or source.named))
        self._bar.advance(f"failed: {Path(source.place).name}")

    def _read(self, sources: list[Source]) -> Iterator[tuple[Source, Task]]:
        for source in sources:
            try:
                task = source.task()
                task = task._replace(name=numbered(task.name, source.place, self._places))
                record = self._earlier.get(source.place, {})
                if record.get("content") and record["content"] == content_of([task]):
                    self.records[source.place] = record  # a file with another time alone
                    continue
                self._fitter.check([task])
                yield source, task
            except (ValueError, OSError) as error:
                self._fail(source, error)

    def _fit(self, pairs: list[tuple[Source, Task]]) -> None:
        """Fit tasks side by side; where that fails, one by one."""
        try:
            results = self._fitter.fit([task for _, task in pairs])
        except (ValueError, FloatingPointError, MemoryError, RuntimeError) as error:
            if len(pairs) == 1:
                self._fail(pairs[0][0], error)
                return
            results = None
        if results is None:  # outside of the handler, which holds what the batch held
            for pair in pairs:
                self._fit([pair])
            return
        for (source, task), result in zip(pairs, results, strict=True):
            theta = {key: value.detach().cpu() for key, value in result.theta.items()}
            try:
                self._keep(source, task, theta, result.record, len(pairs))
            except ValueError as error:
                self._fail(source, error)
            else:
                self._export(task, theta)

    def _keep(self, source: Source, task: Task, theta: Params, record: Document, beside: int) -> None:
        """Write the pictures, the parameters and the record of a fit, in this order."""
        with torch.no_grad():
            write_files(self.plan.app, task, theta, self.folder.path / OUTPUTS)
            self.remarks += write_outputs(self.plan.app, self._outputs, self.folder, task, theta)
        if len(self._columns) < COMPARED:
            self._add_column(source, task, theta)
        record = record | ({"batch": beside} if _is_batched(self.plan) else {})
        of_file = {"source": source.place, "stamp": source.stamp, "content": content_of([task])}
        record |= of_file if source.stamp else {}
        self.folder.add(record, theta)
        self.records[source.place], self.count = record, self.count + 1
        self._bar.advance(f"{record['name']} {number(record['error'], '.3f')}".removesuffix(" -"))

    def _export(self, task: Task, theta: Params) -> None:
        """Write a fit that is kept in each form of --export."""
        run = self.folder.path
        for form in self.plan.options.exports:
            path = run / form / file_name(task.name)
            try:
                with torch.no_grad():
                    export_fit(self.plan.app, task, theta, path, form, self.folder.settings)
            except (ValueError, OSError) as error:
                why = getattr(error, "strerror", None) or str(error).removesuffix(".")
                line = f"{path}: not written as {form}: {why}; the fit is kept, write it by metapp export {run} {form}"
                self.failures.append(Failure(str(path), f"{line} --out FOLDER.", kept=True))
            else:
                self.exported.setdefault(form, []).append(task.name)


def alike(pairs: Iterable[tuple[Source, Task]]) -> list[list[tuple[Source, Task]]]:
    """Groups of tasks whose tensors are of the same sizes, which can be fitted side by side."""
    groups: dict[tuple[tuple[str, torch.Size], ...], list[tuple[Source, Task]]] = {}
    for source, task in pairs:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault(sizes, []).append((source, task))
    return list(groups.values())
