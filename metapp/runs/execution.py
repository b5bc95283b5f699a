"""Execute a plan: one loop for files, data sets, lines of standard input, batches, shards and ranks."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.apps import presentation_of
from metapp.learning.task import Task
from metapp.paradigms import ranks
from metapp.runs.batch_size import BatchSize, alike, check_batch
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.checks import default_recipe
from metapp.runs.fits import Fitter, Result
from metapp.runs.inputs import SOURCED, Source, former_label, sources_read, sources_to_fit
from metapp.runs.naming import name_of, observe_of
from metapp.runs.outputs import OUTPUTS, write_fit
from metapp.runs.pictures import write_gallery, write_thumbnail
from metapp.runs.plan import Plan
from metapp.runs.plan import plan as plan_of
from metapp.runs.reporter import Reporter, number, progress, reporting, say
from metapp.runs.request import Request, portion_of
from metapp.runs.surroundings import make_folder, threads, threads_of
from metapp.runs.training import train_checkpoint
from metapp.runs.watching import Watched
from metapp.storage import Document
from metapp.storage.files import named
from metapp.storage.records import FIT, RunFolder, guarded, summary
from metapp.viewer.live import Live


class Failure(NamedTuple):
    """A source that was not fitted, and why."""

    source: str
    error: Exception

    @property
    def reason(self) -> str:
        """The error, with the source named."""
        return str(named(self.error, Path(self.source)))


class Run(NamedTuple):
    """Fits by a plan, and where they are.

    Attributes:
        plan: with its checkpoint.
        label: the data's name.
        tasks: what was fitted; () where inputs are read when their turn comes.
        records: of all fits, those of earlier calls among them.
        folder: where records and parameters are.
        made: the folder of what fits made for their user; None where nothing.
        failures: what was not fitted.
        tasks_per_second: of what was fitted now, all that takes time counted: reading, fitting, keeping, pictures; None
            where there was nothing left to fit.
        gallery: the page of all fits of the folder, of inputs that are read when their turn comes.
    """

    plan: Plan
    label: str
    tasks: Sequence[Task]
    records: list[Document]
    folder: RunFolder
    made: Path | None
    failures: list[Failure]
    tasks_per_second: float | None
    gallery: Path | None

    def document(self) -> Document:
        """What --json prints."""
        plan, settings = self.plan, self.folder.settings
        fields = ("name", "error", "seconds", "steps", "counts", "note", "warning")
        document = {
            "app": plan.app.name,
            **observe_of(plan.app),
            "paradigm": settings["paradigm"],
            "rule": settings["rule"],
            "steps": settings["steps"],
            **({"budget": plan.budget} if plan.budget is not None else {}),
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
                sources, label = _sources(one)
                recipe = one.request.recipe
                fitter = fitters[recipe] = fitters.get(recipe) or Fitter(with_checkpoint(one), warns=True)
                fitter.plan = replace(one, checkpoint=fitter.plan.checkpoint)
                done = _run(fitter, sources, label)
        except Exception as error:  # whatever it is, the next line is not to blame
            if lines is None:
                raise
            done = Failure(str(request.inputs[0]), error)
        yield done


def _plan_of_line(plan: Plan, request: Request) -> Plan:
    """The plan of a line, by the recipe that its inputs have; training was done for the plan of all."""
    recipe = request.recipe or default_recipe(request)
    if recipe == plan.request.recipe:
        return replace(plan, request=replace(plan.request, inputs=request.inputs))
    return plan_of(replace(request, recipe=recipe, train=False, train_steps=None))


def with_checkpoint(plan: Plan) -> Plan:
    """The plan with the best checkpoint, trained first if that is asked for, by all ranks together."""
    with threads(threads_of(plan.app)):
        if plan.request.train:
            with ranks.joined(plan.device):
                train_checkpoint(plan, plan.request.train_steps)
            plan = replace(plan, request=replace(plan.request, checkpoint=None))  # where training began
        return find_checkpoint(plan) if ranks.number() == 0 else plan


def _sources(plan: Plan) -> tuple[list[Source], str]:
    if plan.request.lazy:
        sources, label = sources_to_fit(plan.app, plan.request)
        former = former_label(label)
        return sources, former if _path(plan, former).is_dir() else label
    return sources_read(plan.app, plan.request)


def _run(fitter: Fitter, sources: list[Source], label: str) -> Run:
    """Fit the sources that have no record yet, or all anew where all have one and are fitted one by one."""
    plan, request, lazy = fitter.plan, fitter.plan.request, fitter.plan.request.lazy
    folder, mine = _folder(plan, label), portion_of(request.shard).of(sources)
    if not mine:
        few = f"none of {len(sources)} inputs, expected some; take {len(sources)} parts at most"
        raise ValueError(f"--shard {request.shard}: {few}.")
    loop = _Loop(fitter, folder, lazy=lazy)
    known = loop.known(mine)
    if not lazy and len(known) == len(mine):
        known = {}  # a finished run is run anew, one that was cut off is completed
    if not request.quiet:
        _announce(plan, folder, len(sources), len(mine), len(known) if lazy else 0, loop.live)
    begin = time.perf_counter()
    with progress(plan.paradigm.name, len(mine), done=len(known), quiet=request.quiet) as bar:
        for done in loop.fit([source for source in mine if source.place not in known]):
            if isinstance(done, Failure):
                bar.advance(f"failed: {Path(done.source).name}")
            else:
                bar.advance(f"{done['name']} {number(done['error'], '.3f')}".removesuffix(" -"))
    rate = loop.count / (time.perf_counter() - begin) if loop.count else None
    records = loop.known(mine)
    if not records:
        raise ValueError(f"none of {len(mine)} inputs could be fitted; the first: {loop.failures[0].reason}")
    tasks = () if lazy else [source.task() for source in mine]
    for task in tasks:
        write_fit(loop.presentation, folder, task, folder.theta(task.name), request.exports)
    for form in request.exports if tasks else ():
        say(f"{len(tasks)} fit{'s' * (len(tasks) != 1)} written as {form}: {folder.path / form}")
    made = folder.path / OUTPUTS if (folder.path / OUTPUTS).is_dir() else None
    gallery = None
    if lazy:
        failures = [(failure.source, failure.reason) for failure in loop.failures]
        gallery = write_gallery(plan.app, plan.paradigm.name, folder, failures)
    return Run(plan, label, tasks, list(records.values()), folder, made, loop.failures, rate, gallery)


def _folder(plan: Plan, label: str) -> RunFolder:
    """The folder of a run; seconds of fits side by side are shares: those have one of their own."""
    settings, form = plan.settings(label), FIT
    if plan.request.lazy:
        settings, form = settings | {"batched": True}, FIT | SOURCED
    return RunFolder(_path(plan, label), settings, form, plan.origin())


def _path(plan: Plan, label: str) -> Path:
    path = plan.path(label)
    return path.with_name(f"{path.name}-batch") if plan.request.lazy else path


def _announce(plan: Plan, folder: RunFolder, total: int, mine: int, known: int, live: Live | None) -> None:
    assert plan.checkpoint is not None
    what = f"{name_of(plan.app)} {plan.paradigm.name}: {total} "
    if plan.request.lazy:
        number, parts = portion_of(plan.request.shard)
        what += f"inputs{f', part {number} of {parts}: {mine}' if parts > 1 else ''}"
        what += f"{f', {known} fitted before' if known else ''}; {plan.steps} steps"
    else:
        what += f"task{'s' * (total != 1)}, {plan.steps} steps"
    say(f"{what}, from {plan.checkpoint.source}")
    if live:
        say(f"watch: {folder.path / 'watch.png'}; the time that it takes to draw is not part of the seconds")
        say(f"watch: {live.address} shows the same in a browser of this machine, until the fits are over")


class _Loop:
    """Reads, fits and keeps sources, batch by batch.

    Attributes:
        count: how many were fitted.
        failures: what was not; only of a lazy loop, else what fails is raised.
        live: the page that follows, where fits are watched and messages are not left out.
    """

    def __init__(self, fitter: Fitter, folder: RunFolder, *, lazy: bool = False) -> None:
        plan = fitter.plan
        file, self.live = folder.path / "watch.png", Live() if plan.request.watch and not plan.request.quiet else None
        fitter.watched = Watched(plan.app, plan.paradigm.name, file, self.live) if plan.request.watch else None
        self.fitter, self.folder, self.lazy = fitter, folder, lazy
        self.presentation = presentation_of(plan.app, plan.size)
        self.size = BatchSize(check_batch(plan.request.batch or "1"), plan.device)
        self.failures: list[Failure] = []
        self.count = 0

    def known(self, sources: Sequence[Source]) -> dict[str, Document]:
        """Records of sources that have not changed since, by their places; else the folder's name is of the content."""
        finished = self.folder.finished()
        if self.lazy:
            finished = {record["source"]: record for record in finished.values()}
            sources = [each for each in sources if finished.get(each.place, {}).get("stamp") == each.stamp]
        return {source.place: finished[source.place] for source in sources if source.place in finished}

    def fit(self, sources: Sequence[Source]) -> Iterator[Document | Failure]:
        """Fit sources and keep each fit; what has a record is whole. The page that follows ends, whatever fails."""
        try:
            yield from self._fits(sources)
            self.fitter.finish(self.count)
        finally:
            if self.live:
                self.live.close()

    def _fits(self, sources: Sequence[Source]) -> Iterator[Document | Failure]:
        if not self.lazy:
            self.fitter.check([source.task() for source in sources])
        first = 0
        while first < len(sources):
            some, first = sources[first : first + self.size.now], first + self.size.now
            failed = len(self.failures)
            for group in alike(self._read(some)):
                yield from self._fitted(group)
            yield from self.failures[failed:]

    def _fail(self, source: Source, error: Exception) -> None:
        if not self.lazy:
            raise error
        # frames hold what was read: of thousands of failures that is all memory
        error.__context__ = error.__cause__ = None
        self.failures.append(Failure(source.place, error.with_traceback(None)))

    def _read(self, sources: Sequence[Source]) -> Iterator[tuple[Source, Task]]:
        for source in sources:
            try:
                yield source, source.task()
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
            try:
                yield self._keep(source, task, result, len(pairs))
            except ValueError as error:
                self._fail(source, error)

    def _keep(self, source: Source, task: Task, result: Result, beside: int) -> Document:
        """Write all that a fit makes, then its record."""
        record, theta = result
        if self.lazy:
            theta = {key: value.detach().cpu() for key, value in theta.items()}
            with torch.no_grad():
                write_thumbnail(self.fitter.plan.app, task, theta, self.folder.path)
                write_fit(self.presentation, self.folder, task, theta, self.fitter.plan.request.exports)
            record = record | {"batch": beside, "source": source.place, "stamp": source.stamp}
        elif source.file:
            record = record | {"source": source.file, "stamp": source.stamp}
        self.folder.add(record, theta)
        self.count += 1
        return record
