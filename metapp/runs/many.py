"""Fit many inputs: some side by side, resumable, whatever is broken among them; a part of them on each machine."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch

from metapp.apps import presentation_of
from metapp.learning.task import Params, Task
from metapp.runs import BadOption
from metapp.runs.batch_size import BatchSize
from metapp.runs.export import export_fit
from metapp.runs.fits import Fitter
from metapp.runs.gallery import write_gallery, write_thumbnail
from metapp.runs.inputs import AS_FILES_SAY, Reading
from metapp.runs.origin import origin_of
from metapp.runs.pictures import OUTPUTS, write_files
from metapp.runs.reporter import Bar, number, progress, say
from metapp.runs.run import Run, checkpoint_of, placed, run_path
from metapp.runs.session import Options, name_of, settings_of, threads, threads_of
from metapp.runs.sources import SOURCED, Shard, Source, sources_of
from metapp.runs.watching import Watched
from metapp.storage.files import named
from metapp.storage.records import FIT, RunFolder, file_name

FORM = FIT | SOURCED
Fitted = tuple[Source, Task, dict[str, Any], Params]


class Failure(NamedTuple):
    """A source that was not fitted, and why."""

    source: str
    reason: str


class Many(NamedTuple):
    """A run of many inputs.

    Attributes:
        run: the fits, those of earlier calls among them; it holds no tasks.
        failures: what was not fitted.
        tasks_per_second: of what was fitted now, all that takes time counted: reading, fitting, keeping, pictures; None
            where there was nothing left to fit.
        gallery: the page of all fits of the run's folder.
    """

    run: Run
    failures: list[Failure]
    tasks_per_second: float | None
    gallery: Path

    def document(self) -> dict[str, Any]:
        """What --json prints."""
        return self.run.document() | {
            "tasks_per_second": self.tasks_per_second,
            "gallery": str(self.gallery),
            "failures": [failure._asdict() for failure in self.failures],
        }


class Asked(NamedTuple):
    """How many inputs are to be fitted.

    Attributes:
        batch: tasks side by side; None: what proves to be quick.
        shard: the part of the inputs.
    """

    batch: int | None
    shard: Shard


def fit_many(
    options: Options,
    paradigm_name: str,
    inputs: list[Path],
    asked: Asked,
    *,
    train: bool = False,
    train_steps: int | None = None,
    export: str = "",
    size: str = "",
    reading: Reading = AS_FILES_SAY,
) -> Many:
    """Fit all inputs that have no record yet; what fails is listed and does not stop the others.

    Args:
        options: of all paradigms.
        paradigm_name: one of the five.
        inputs: the user's files and folders; none: the test tasks of the data set.
        asked: how.
        train, train_steps, export, size, reading: as of `run.run`.

    Raises:
        BadOption: a budget for fits side by side.
        ValueError: no input, no checkpoint, a folder that cannot be written to; nothing could be fitted.
    """
    if options.budget is not None and asked.batch != 1:
        raise BadOption("--budget: the time of one fit; fits side by side have none, leave --batch out or give 1.")
    options, paradigm, sides = placed(options, paradigm_name, size)
    with threads(threads_of(options.app)):
        sources, label = sources_of(options.app, inputs, options.data, options.quiet, reading)
        checkpoint = checkpoint_of(options, paradigm, train, train_steps)
        # seconds of fits side by side are shares: a run of its own
        settings = settings_of(options, paradigm, checkpoint, label) | {"batched": True}
        path = run_path(options, settings, label)
        origin = origin_of(options, inputs, reading)
        folder = RunFolder(path.with_name(f"{path.name}-batch"), settings, FORM, origin)
        mine = asked.shard.take(sources)
        if not mine:
            first, parts = asked.shard
            few = f"none of {len(sources)} inputs, expected some; take {len(sources)} parts at most"
            raise ValueError(f"--shard {first}/{parts}: {few}.")
        watched = Watched(options.app, paradigm.name, folder.path / "watch.png") if options.watch else None
        work = _Work(Fitter(options, paradigm, checkpoint, watched), folder, asked.batch, export, sides)
        known = work.known(mine)
        if not options.quiet:
            part = f", part {asked.shard.part} of {asked.shard.parts}: {len(mine)}" if asked.shard.parts > 1 else ""
            done = f", {len(known)} fitted before" if known else ""
            what = f"{name_of(options.app)} {paradigm.name}: {len(sources)} inputs{part}{done}"
            say(f"{what}; {settings['steps']} steps, from {checkpoint.source}")
        begin = time.perf_counter()
        with progress(paradigm.name, len(mine), done=len(known), quiet=options.quiet) as bar:
            work.fit([source for source in mine if source.place not in known], bar)
        seconds = time.perf_counter() - begin
    records = work.known(mine)
    if not records:
        raise ValueError(f"none of {len(mine)} inputs could be fitted; the first: {work.failures[0].reason}")
    made = folder.path / OUTPUTS if (folder.path / OUTPUTS).is_dir() else None
    run = Run(options, settings, label, [], list(records.values()), folder, made)
    rate = work.count / seconds if work.count else None
    return Many(run, work.failures, rate, write_gallery(options.app, paradigm.name, folder, work.failures))


class _Work:
    """Reads, fits and keeps, batch by batch.

    Attributes:
        failures: what was not fitted.
        count: how many were.
    """

    def __init__(
        self, fitter: Fitter, folder: RunFolder, batch: int | None, export: str, sides: tuple[int, int] | None
    ) -> None:
        self.fitter, self.folder, self.export, self.sides = fitter, folder, export, sides
        self.size = BatchSize(batch, fitter.options.device)
        self.failures: list[Failure] = []
        self.count = 0

    def known(self, sources: Sequence[Source]) -> dict[str, dict[str, Any]]:
        """Records of sources that have not changed since, by their places."""
        found = {record["source"]: record for record in self.folder.finished().values()}
        return {
            source.place: found[source.place]
            for source in sources
            if source.place in found and found[source.place]["stamp"] == source.stamp
        }

    def fit(self, sources: list[Source], bar: Bar) -> None:
        """Fit sources and keep each fit; the bar moves on for each, also for those that fail."""
        at = 0
        while at < len(sources):
            some, at = sources[at : at + self.size.now], at + self.size.now
            failed = len(self.failures)
            for group in alike(self._read(some)):
                for source, task, record, theta in self._fitted(group):
                    self._keep(source, task, record, theta)
                    bar.advance(f"{record['name']} {number(record['error'], '.3f')}".removesuffix(" -"))
            for failure in self.failures[failed:]:
                bar.advance(f"failed: {Path(failure.source).name}")
        self.fitter.tell(self.count)
        if self.fitter.watched:
            self.fitter.watched.finish()

    def _read(self, sources: Sequence[Source]) -> Iterator[tuple[Source, Task]]:
        for source in sources:
            try:
                yield source, source.task()
            except (ValueError, OSError) as error:
                self.failures.append(Failure(source.place, str(named(error, Path(source.place)))))

    def _fitted(self, pairs: list[tuple[Source, Task]]) -> Iterator[Fitted]:
        """Fits of tasks side by side; where that fails, of each half, so that one that fails is soon alone."""
        tasks = [task for _, task in pairs]
        try:
            self.fitter.warm(tasks[0])
            found = self.fitter.fit(tasks)
        except (ValueError, FloatingPointError, MemoryError, RuntimeError) as error:
            if len(pairs) == 1:
                self.failures.append(Failure(pairs[0][0].place, str(named(error, Path(pairs[0][0].place)))))
                return
            if not isinstance(error, ValueError | FloatingPointError):
                self.size.failed()
            middle = len(pairs) // 2
            yield from self._fitted(pairs[:middle])
            yield from self._fitted(pairs[middle:])
            return
        self.size.told(len(tasks), sum(record["seconds"] for record, _ in found))
        for (source, task), (record, theta) in zip(pairs, found, strict=True):
            yield source, task, record | {"batch": len(tasks)}, theta

    def _keep(self, source: Source, task: Task, record: dict[str, Any], theta: Params) -> None:
        """Write all that a fit makes, then its record: what has one is whole."""
        app, path = self.fitter.options.app, self.folder.path
        theta = {key: value.detach().cpu() for key, value in theta.items()}
        try:
            with torch.no_grad():
                write_thumbnail(app, task, theta, path)
                shown = presentation_of(app, self.sides)
                write_files(shown, task, theta, path / OUTPUTS)
                if self.export:
                    target = path / self.export / file_name(task.name)
                    export_fit(shown, task, theta, target, self.export, self.folder.settings)
        except ValueError as error:
            self.failures.append(Failure(source.place, str(named(error, Path(source.place)))))
            return
        self.folder.add(record | {"source": source.place, "stamp": source.stamp}, theta)
        self.count += 1


def alike(pairs: Iterator[tuple[Source, Task]]) -> list[list[tuple[Source, Task]]]:
    """Groups of tasks whose tensors are of the same sizes, which can be fitted side by side."""
    groups: dict[Any, list[tuple[Source, Task]]] = {}
    for source, task in pairs:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault(sizes, []).append((source, task))
    return list(groups.values())
