"""Execute a plan: one run that reads, fits and keeps its inputs, batch by batch."""

from __future__ import annotations

import itertools
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
from metapp.runs.inputs.sources import Source, content_of, sources_to_fit
from metapp.runs.naming import name_of, observe_of
from metapp.runs.outputs.files import export_fit, export_path, outputs_of, write_outputs, write_pictures
from metapp.runs.outputs.pictures import COMPARED, Column, column_of_fit, picture_of_run
from metapp.runs.plan import Plan
from metapp.runs.reporter import Bar, Reporter, number, progress, reporting, say
from metapp.runs.surroundings import make_folder, threads_of
from metapp.runs.torch_state import threads
from metapp.storage import Document
from metapp.storage.files import named
from metapp.storage.fits import Fits, find_fit, read_params
from metapp.storage.records import guarded, summary

FORESEEN = (ValueError, OSError, FloatingPointError, MemoryError)  # what is wrong with inputs and fits


class Failure(NamedTuple):
    """An input that was not fitted, or a form that a fit was not written in.

    Attributes:
        source: its place.
        reason: the error, with the source named.
        counted: whether the run fails by it; not by a damaged file that was found in a folder.
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
        records: of all fits, those of before among them that are skipped.
        fits: where they are.
        replaced: how many replace fits of before.
        skipped: how many are fits of before.
        failures: what was not fitted, or not exported.
        remarks: what outputs say of themselves.
        tasks_per_second: of what was fitted now, all that takes time counted: reading, fitting, keeping, pictures; None
            where there was nothing left to fit.
    """

    plan: Plan
    records: list[Document]
    fits: Fits
    replaced: int
    skipped: int
    failures: list[Failure]
    remarks: list[str]
    tasks_per_second: float | None

    @property
    def folder(self) -> Path:
        """The folder of the run; of a single fit the task's."""
        return Path(self.records[0]["folder"]) if len(self.records) == 1 else self.fits.path

    def document(self) -> Document:
        """The object that --json prints."""
        plan, settings = self.plan, self.fits.settings
        fields = ("name", "error", "seconds", "counts", "note", "warning", "folder")
        return {
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
            "tasks_per_second": self.tasks_per_second,
            "failures": [{"source": failure.source, "reason": failure.reason} for failure in self.failures],
            "out": str(self.fits.path),
        }


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
        return _run(plan, sources, Fits(plan.path(label), plan.settings(label)))


def _with_checkpoint(plan: Plan) -> Plan:
    """The plan with its checkpoint, trained first if that is asked for, by all ranks together."""
    if plan.options.train:
        with ranks.joined(plan.device):
            trained = train_checkpoint(plan, plan.options.train_steps)
        if plan.paradigm.name == "quickft" and trained.general:  # which may ship
            plan = replace(plan, options=replace(plan.options, checkpoint=trained.path))
            return replace(plan, checkpoint=tuned_by(trained.general, trained.state.phi, trained.path))
        plan = replace(plan, options=replace(plan.options, checkpoint=trained.path))
    return find_checkpoint(plan) if ranks.number() == 0 else plan


def _run(plan: Plan, sources: list[Source], fits: Fits) -> Run:
    loop = _Loop(plan, sources, fits)
    if not plan.options.quiet:
        assert plan.checkpoint is not None
        count = f"{len(sources)} input{'s' * (len(sources) != 1)}"
        say(f"{name_of(plan.app)} {plan.paradigm.name}: {count}; {plan.steps} steps, from {plan.checkpoint.source}")
    begin = time.perf_counter()
    with progress(plan.paradigm.name, len(sources), quiet=plan.options.quiet) as bar:
        loop.fit(bar)
    fitted = len(loop.records) - loop.skipped
    rate = fitted / (time.perf_counter() - begin) if fitted else None
    if not loop.records:
        reason = loop.failures[0].reason
        several = f"none of {len(sources)} inputs could be fitted; the first: " if len(sources) > 1 else ""
        raise ValueError(f"{several}{reason}")
    loop.draw()
    records = list(loop.records.values())
    return Run(plan, records, fits, loop.replaced, loop.skipped, loop.failures, loop.remarks, rate)


class _Loop:
    """Reads, fits and keeps the inputs of a run.

    Attributes:
        records: of inputs that are fitted, by their places, in the order of these once all are.
        replaced: how many replace fits of before.
        skipped: how many are fits of before.
        failures: what was not fitted, or not exported.
        remarks: what outputs say of themselves.
    """

    def __init__(self, plan: Plan, sources: list[Source], fits: Fits) -> None:
        self.plan, self.sources, self.fits = plan, sources, fits
        self.records: dict[str, Document] = {}
        self.replaced = self.skipped = 0
        self.failures: list[Failure] = []
        self.remarks: list[str] = []
        self._fitter = Fitter(plan, warns=True)
        self._outputs = outputs_of(plan.options)
        self._columns: dict[str, Column] = {}
        self._bar = Bar()

    def fit(self, bar: Bar) -> None:
        """Fit inputs and keep each fit; a bar shows each."""
        self._bar, pairs = bar, self._read()
        while some := list(itertools.islice(pairs, self.plan.options.batch or 1)):
            for group in alike(some):
                self._fit(group)
        places = [source.place for source in self.sources]
        self.records = {place: self.records[place] for place in places if place in self.records}

    def draw(self) -> None:
        """Write the picture of the first fits beside their references."""
        first = [source for source in self.sources if source.place in self.records][:COMPARED]
        for source in first:
            if source.place not in self._columns:  # fitted before
                self._add_column(source, source.task(), read_params(self.records[source.place]["folder"]))
        columns = [(self._columns[source.place], self.records[source.place]) for source in first]
        picture_of_run(self.plan.app, self.plan.paradigm.name, columns, list(self.records.values()), self.fits.path)

    def _add_column(self, source: Source, task: Task, theta: Params) -> None:
        with torch.no_grad():
            self._columns[source.place] = column_of_fit(self.plan.app, task, theta)

    def _fail(self, source: Source, error: Exception, *, counted: bool = True) -> None:
        if not isinstance(error, FORESEEN) and len(self.sources) == 1:
            raise error
        self.failures.append(Failure(source.place, str(named(error, Path(source.place))), counted))
        self._bar.advance(f"failed: {Path(source.place).name}")

    def _read(self) -> Iterator[tuple[Source, Task]]:
        for source in self.sources:
            try:
                task = source.task()
                if self.plan.options.resume and (record := self._record_of(source, task)):
                    self.records[source.place] = record
                    self.skipped += 1
                    self._bar.advance(f"{task.name}: fitted before")
                    continue
                self._fitter.check([task])
                yield source, task
            except (ValueError, OSError) as error:
                self._fail(source, error, counted=source.named)

    def _record_of(self, source: Source, task: Task) -> Document | None:
        """The record of a fit of the same settings, of an input of the same content."""
        record = find_fit(self.fits.path, task.name, source.place)
        same = record and self.fits.hold(record) and record.get("content") == content_of(task)
        return record if same else None

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
                record = self._keep(source, task, theta, result.record, len(pairs))
            except ValueError as error:
                self._fail(source, error)
            else:
                self._export(task, theta, record)

    def _keep(self, source: Source, task: Task, theta: Params, record: Document, beside: int) -> Document:
        """Write the parameters, the pictures and the record of a fit, in this order."""

        def draw(folder: Path) -> None:
            with torch.no_grad():
                write_pictures(self.plan.app.pictures(theta, task), folder)
                self.remarks += write_outputs(self.plan.app, self._outputs, folder, task, theta)

        record = record | {
            "source": source.place,
            "content": content_of(task),
            "origin": self.plan.origin(source.given),
        }
        record |= {"batch": beside} if beside > 1 else {}
        self.replaced += find_fit(self.fits.path, task.name, source.place) is not None
        kept = self.fits.write(record, theta, draw)
        if len(self._columns) < COMPARED:
            self._add_column(source, task._replace(name=kept["name"]), theta)
        self.records[source.place] = kept
        self._bar.advance(f"{kept['name']} {number(kept['error'], '.3f')}".removesuffix(" -"))
        return kept

    def _export(self, task: Task, theta: Params, record: Document) -> None:
        """Write a fit that is kept in each form of --export."""
        for form in self.plan.options.exports:
            path = export_path(record, form)
            try:
                with torch.no_grad():
                    export_fit(self.plan.app, task, theta, path, form, self.fits.settings)
            except (ValueError, OSError) as error:
                why = getattr(error, "strerror", None) or str(error).removesuffix(".")
                again = f"metapp export {record['folder']} {form}"
                line = f"{path}: not written as {form}: {why}; the fit is kept, write it by {again} --out FOLDER."
                self.failures.append(Failure(str(path), line, kept=True))


def alike(pairs: Iterable[tuple[Source, Task]]) -> list[list[tuple[Source, Task]]]:
    """Groups of tasks whose tensors are of the same sizes, which can be fitted side by side."""
    groups: dict[tuple[tuple[str, torch.Size], ...], list[tuple[Source, Task]]] = {}
    for source, task in pairs:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault(sizes, []).append((source, task))
    return list(groups.values())
