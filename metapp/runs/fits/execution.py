"""Execute a plan: one loop for files, data sets, lines of standard input, batches, shards and ranks."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.learning.task import Params, Task
from metapp.paradigms import ranks
from metapp.runs.checkpoints.finding import find_checkpoint, tuned_by
from metapp.runs.checkpoints.training import train_checkpoint
from metapp.runs.fits.batch_size import BatchSize, alike, check_batch
from metapp.runs.fits.fitter import Fitter
from metapp.runs.inputs.sources import Source, content_of, numbered, sources_to_fit
from metapp.runs.outputs.files import OUTPUTS, export_fit, listed, write_files, write_outputs
from metapp.runs.outputs.pictures import COMPARED, Column, column_of_fit, picture_of_run, write_gallery, write_thumbnail
from metapp.runs.reporter import Reporter, number, progress, reporting, say
from metapp.runs.requests.choosing import chosen_recipe
from metapp.runs.requests.naming import name_of, observe_of
from metapp.runs.requests.options import outputs_of
from metapp.runs.requests.plan import Plan
from metapp.runs.requests.plan import plan as plan_of
from metapp.runs.requests.request import Request, portion_of
from metapp.runs.surroundings import make_folder, threads_of
from metapp.runs.torch_state import threads
from metapp.storage import Document
from metapp.storage.files import named
from metapp.storage.records import FIT, RunFolder, file_name, guarded, summary

FORESEEN = (ValueError, OSError, FloatingPointError, MemoryError)  # what is wrong with inputs and fits


class Failure(NamedTuple):
    """A source that was not fitted, or not exported, and why.

    Attributes:
        source: its place.
        error: why.
        named: whether the user named it, so that it should have been good.
        kept: whether its fit is kept and a form of --export was not written.
    """

    source: str
    error: Exception
    named: bool = True
    kept: bool = False

    @property
    def reason(self) -> str:
        """The error, with the source named."""
        return str(named(self.error, Path(self.source)))


class Run(NamedTuple):
    """Fits by a plan, and where they are.

    Attributes:
        plan: with its checkpoint.
        label: the data's name.
        records: of all fits, those of earlier calls among them.
        folder: where records and parameters are.
        made: the folder of what fits made for their user; None where nothing.
        failures: what was not fitted.
        remarks: what outputs say of themselves.
        tasks_per_second: of what was fitted now, all that takes time counted: reading, fitting, keeping, pictures; None
            where there was nothing left to fit.
        picture: of up to 20 fits beside their references.
        gallery: the page of all fits of the folder, of runs that are resumed.
    """

    plan: Plan
    label: str
    records: list[Document]
    folder: RunFolder
    made: Path | None
    failures: list[Failure]
    remarks: list[str]
    tasks_per_second: float | None
    picture: Path
    gallery: Path | None

    @property
    def counted_failures(self) -> list[Failure]:
        """The failures that make the run fail: of what was named; where failures are listed, all."""
        return [failure for failure in self.failures if failure.named or self.plan.request.resumes]

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
            "data": self.label,
            **plan.app.conditions(),
            **{key: settings[key] for key in ("precision",) if key in settings},
            **summary(self.records),
            "guarded": guarded(self.records),
            "tasks": [{key: record[key] for key in fields if key in record} for record in self.records],
            "out": str(self.folder.path),
        }
        if self.gallery:
            failures = [{"source": failure.source, "reason": failure.reason} for failure in self.failures]
            document |= {"tasks_per_second": self.tasks_per_second, "gallery": str(self.gallery), "failures": failures}
        return document


def execute(plan: Plan, lines: Iterable[Request] | None = None) -> Iterator[Run | Failure]:
    """Train the checkpoint, if that is asked for, then fit all inputs as one run, or each line as a run of its own.

    Of several ranks only the first one fits.

    Args:
        plan: what to do.
        lines: requests of other inputs, else alike, as they come; what fails does not stop the others.

    Yields:
        Each run when it is done.

    Raises:
        ValueError: bad inputs, no checkpoint, a folder that cannot be written to; nothing could be fitted.
        FloatingPointError: a fit is not finite.
    """
    if ranks.number() > 0:
        if plan.request.train:
            with reporting(Reporter()):
                with_checkpoint(replace(plan, request=replace(plan.request, quiet=True)))
        return
    make_folder(plan.request.out)
    # with lines, what is missing is said before the first one
    fitters = {} if lines is None else {plan.request.recipe: Fitter(with_checkpoint(plan), warns=True)}
    for request in [plan.request] if lines is None else lines:
        done: Run | Failure
        try:
            one = plan if lines is None else _plan_of_line(plan, request)
            with threads(threads_of(one.app)):
                sources, label = sources_to_fit(one)
                recipe = one.request.recipe
                fitter = fitters[recipe] = fitters.get(recipe) or Fitter(with_checkpoint(one), warns=True)
                fitter.plan = replace(one, checkpoint=fitter.plan.checkpoint)
                folder = _folder(fitter.plan, label)
                done = _run(fitter, sources, label, folder)
        except Exception as error:  # whatever it is, the next line is not to blame
            if lines is None:
                raise
            done = Failure(str(request.inputs[0]), error)
        yield done


def _plan_of_line(plan: Plan, request: Request) -> Plan:
    """The plan of a line, by the recipe that its inputs have; training was done for the plan of all."""
    recipe = request.recipe or chosen_recipe(request)
    if recipe == plan.request.recipe:
        return replace(plan, request=replace(plan.request, inputs=request.inputs))
    return plan_of(replace(request, recipe=recipe, train=False, train_steps=None))


def with_checkpoint(plan: Plan) -> Plan:
    """The plan with its checkpoint, trained first if that is asked for, by all ranks together."""
    with threads(threads_of(plan.app)):
        if plan.request.train:
            with ranks.joined(plan.device):
                trained = train_checkpoint(plan, plan.request.train_steps)
            if plan.paradigm.name == "quickft" and trained.general:  # which may ship
                return replace(plan, checkpoint=tuned_by(trained.general, trained.prepared.phi, trained.path))
            plan = replace(plan, request=replace(plan.request, checkpoint=trained.path))
        return find_checkpoint(plan) if ranks.number() == 0 else plan


def _run(fitter: Fitter, sources: list[Source], label: str, folder: RunFolder) -> Run:
    """Fit the sources that have no record yet; where all have one and the run is not to be resumed, fit all anew."""
    plan, request = fitter.plan, fitter.plan.request
    mine = portion_of(request.shard).of(sources)
    if not mine:
        few = f"none of {len(sources)} inputs, expected some; take {len(sources)} parts at most"
        raise ValueError(f"--shard {request.shard}: {few}.")
    loop = _Loop(fitter, folder)
    finished = loop.known(mine)
    if not request.resumes and len(finished) == len(mine):
        finished, loop.anew = {}, True  # a finished run is run anew, one that was cut off is completed
    if not request.quiet:
        _announce(plan, folder, len(sources), len(mine), len(finished) if request.resumes else 0)
    begin = time.perf_counter()
    with progress(plan.paradigm.name, len(mine), done=len(finished), quiet=request.quiet) as bar:
        for done in loop.fit([source for source in mine if source.place not in finished]):
            if isinstance(done, Failure):
                bar.advance(f"failed: {Path(done.source).name}")
            else:
                bar.advance(f"{done['name']} {number(done['error'], '.3f')}".removesuffix(" -"))
    rate = loop.count / (time.perf_counter() - begin) if loop.count else None
    records = loop.known(mine)
    if not records:
        raise _first_error(loop.failures, len(mine))
    for form, names in loop.exported.items():
        say(f"written as {form}: {listed(folder.path / form, names)}")
    made = folder.path / OUTPUTS if (folder.path / OUTPUTS).is_dir() else None
    picture, gallery = loop.sheet(mine, records), None
    if request.resumes:
        failures = [(failure.source, failure.reason) for failure in loop.failures]
        gallery = write_gallery(plan.app, plan.paradigm.name, folder, failures)
    rows = list(records.values())
    return Run(plan, label, rows, folder, made, loop.failures, loop.remarks, rate, picture, gallery)


def _first_error(failures: Sequence[Failure], count: int) -> Exception:
    """The error of a run that fitted nothing: of one input its own."""
    if count == 1:
        return named(failures[0].error, Path(failures[0].source))
    return ValueError(f"none of {count} inputs could be fitted; the first: {failures[0].reason}")


def is_batched(plan: Plan) -> bool:
    """True if inputs are fitted side by side."""
    return plan.request.batch not in ("", "1")


def _folder(plan: Plan, label: str) -> RunFolder:
    """The folder of a run; seconds of fits side by side are shares: those have one of their own."""
    settings, path = plan.settings(label), plan.path(label)
    if is_batched(plan):
        settings, path = settings | {"batched": True}, path.with_name(f"{path.name}-batch")
    return RunFolder(path, settings, FIT, plan.origin())


def _announce(plan: Plan, folder: RunFolder, total: int, mine: int, finished: int) -> None:
    assert plan.checkpoint is not None
    number, parts = portion_of(plan.request.shard)
    what = f"{name_of(plan.app)} {plan.paradigm.name}: {total} input{'s' * (total != 1)}"
    what += f", part {number} of {parts}: {mine}" if parts > 1 else ""
    what += f", {finished} fitted before" if finished else ""
    say(f"{what}; {plan.steps} steps, from {plan.checkpoint.source}")


class _Loop:
    """Reads, fits and keeps sources, batch by batch.

    Attributes:
        anew: whether inputs are fitted although there is a record of the same content.
        count: how many were fitted.
        exported: the names of fits by the form that they were written in.
        failures: what was not fitted, or not exported.
        remarks: what outputs say of themselves.
    """

    def __init__(self, fitter: Fitter, folder: RunFolder) -> None:
        plan = fitter.plan
        self.fitter, self.folder, self.presentation = fitter, folder, plan.presentation
        self.outputs = outputs_of(plan.app.name, plan.options)
        self.size = BatchSize(check_batch(plan.request.batch or "1"), plan.device)
        self.failures: list[Failure] = []
        self.remarks: list[str] = []
        self.anew, self.count = False, 0
        self.exported: dict[str, list[str]] = {}
        self._columns: dict[str, Column] = {}
        self._places: dict[str, str] = {}  # of tasks by name: sources of different stems may hold tasks of one name
        self._touched: set[str] = set()  # places of files with another time, and the content of their record

    def _finished(self) -> dict[str, Document]:
        """All records of the folder, by the places of their sources."""
        return {record.get("source", name): record for name, record in self.folder.finished().items()}

    def known(self, sources: Sequence[Source]) -> dict[str, Document]:
        """Records of sources that have not changed since, by their places."""
        finished = self._finished()
        there = [source for source in sources if source.place in finished]
        return {
            source.place: finished[source.place]
            for source in there
            if source.place in self._touched or finished[source.place].get("stamp", "") == source.stamp
        }

    def fit(self, sources: Sequence[Source]) -> Iterator[Document | Failure]:
        """Fit sources and keep each fit; what has a record is whole."""
        first = 0
        while first < len(sources):
            some, first = sources[first : first + self.size.now], first + self.size.now
            failed = len(self.failures)
            for group in alike(self._read(some)):
                yield from self._fitted(group)
            yield from self.failures[failed:]

    def sheet(self, sources: Sequence[Source], records: Mapping[str, Document]) -> Path:
        """Write the picture of the first fits beside their references."""
        first = [source for source in sources if source.place in records][:COMPARED]
        for source in first:
            if source.place not in self._columns:  # fitted by an earlier call
                self._keep_column(source, source.task(), self.folder.theta(records[source.place]["name"]))
        columns = [(self._columns[source.place], records[source.place]) for source in first]
        plan = self.fitter.plan
        return picture_of_run(plan.app, plan.paradigm.name, columns, list(records.values()), self.folder.path)

    def _keep_column(self, source: Source, task: Task, theta: Params) -> None:
        with torch.no_grad():
            self._columns[source.place] = column_of_fit(self.presentation, task, theta)

    def _fail(self, source: Source, error: Exception) -> None:
        if not (self.fitter.plan.request.resumes or isinstance(error, FORESEEN)):
            raise error
        # frames hold what was read: of thousands of failures that is all memory
        error.__context__ = error.__cause__ = None
        self.failures.append(Failure(source.place, error.with_traceback(None), source.named))

    def _read(self, sources: Sequence[Source]) -> Iterator[tuple[Source, Task]]:
        finished = {} if self.anew else self._finished()
        self._places |= {record["name"]: place for place, record in finished.items()}
        for source in sources:
            try:
                task = source.task()
                task = task._replace(name=numbered(task.name, source.place, self._places))
                content = finished.get(source.place, {}).get("content")
                if content and content == content_of([task]):
                    self._touched.add(source.place)
                    continue
                self.fitter.check([task])
                yield source, task
            except (ValueError, OSError) as error:
                self._fail(source, error)

    def _fitted(self, pairs: list[tuple[Source, Task]]) -> Iterator[Document]:
        """Fits of tasks side by side; where that fails, of each half, so that one that fails is soon alone."""
        try:
            results = self.fitter.fit([task for _, task in pairs])
        except (ValueError, FloatingPointError, MemoryError, RuntimeError) as error:
            if len(pairs) == 1:
                return self._fail(pairs[0][0], error)
            if not isinstance(error, ValueError | FloatingPointError):
                self.size.failed()
            middle = len(pairs) // 2
            yield from self._fitted(pairs[:middle])
            yield from self._fitted(pairs[middle:])
            return
        self.size.note(len(pairs), sum(result.record["seconds"] for result in results))
        for (source, task), result in zip(pairs, results, strict=True):
            theta = {key: value.detach().cpu() for key, value in result.theta.items()}
            try:
                yield self._keep(source, task, theta, result.record, len(pairs))
            except ValueError as error:
                self._fail(source, error)
            else:
                self._export(task, theta)

    def _export(self, task: Task, theta: Params) -> None:
        """Write a fit that is kept in each form of --export."""
        run = self.folder.path
        for form in self.fitter.plan.request.exports:
            path = run / form / file_name(task.name)
            try:
                with torch.no_grad():
                    export_fit(self.presentation, task, theta, path, form, self.folder.settings)
            except (ValueError, OSError) as error:
                why = getattr(error, "strerror", None) or str(error).removesuffix(".")
                line = f"{path}: not written as {form}: {why}; the fit is kept, write it by metapp export {run} {form}"
                self.failures.append(Failure(str(path), ValueError(f"{line} --out FOLDER."), kept=True))
            else:
                self.exported.setdefault(form, []).append(task.name)

    def _keep(self, source: Source, task: Task, theta: Params, record: Document, beside: int) -> Document:
        """Write the pictures, the parameters and the record of a fit, in this order."""
        plan = self.fitter.plan
        with torch.no_grad():
            write_files(self.presentation, task, theta, self.folder.path / OUTPUTS)
            self.remarks += write_outputs(self.presentation, self.outputs, self.folder, task, theta)
            if plan.request.resumes:
                write_thumbnail(plan.app, task, theta, self.folder.path)
            if len(self._columns) < COMPARED:
                self._keep_column(source, task, theta)
        record = record | ({"batch": beside} if is_batched(plan) else {})
        of_file = {"source": source.place, "stamp": source.stamp, "content": content_of([task])}
        record |= of_file if source.stamp else {}
        self.folder.add(record, theta)
        self.count += 1
        return record
