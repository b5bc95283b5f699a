"""Execution of a run: its inputs are read and fitted, and each fit is kept in a folder of its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.learning.task import Params, Task
from metapp.paradigms import ranks
from metapp.runs.checkpoints import with_checkpoint
from metapp.runs.fit import Fit
from metapp.runs.fitting import BadInput, fit_sources
from metapp.runs.inputs.sources import Source, content_of, sources_to_fit
from metapp.runs.outputs.files import export_fit, export_path, opened_file, rendered, write_pictures
from metapp.runs.outputs.pictures import ROWS, Tiles, add_to_sheet, tiles_of_fit
from metapp.runs.reporter import Bar, Reporter, progress, reporting, say
from metapp.runs.run import Run
from metapp.runs.surroundings import make_folder, threads
from metapp.storage import Document
from metapp.storage.files import named
from metapp.storage.fits import Fits, find_fit, guarded, summary
from metapp.storage.parameters import params_of

ERRORS = ("error", "photo_error")  # of a record, the first that there is
READ, FITTED, DRAWN = 0.2, 0.5, 0.9  # shares of an input's time, about
FORESEEN = (ValueError, OSError, FloatingPointError, MemoryError)  # errors of inputs and fits


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


class Execution:
    """Fits of the sources of a run, and the folder that they are kept in.

    Attributes:
        run: with its checkpoint.
        fits: their folder and settings.
        records: of all fits, in the order of the sources, those of before among them that are skipped.
        replaced: the number of fits that replace fits of before.
        skipped: the number of fits of before.
        failures: inputs that were not fitted, and exports that were not written.
        exported: the files that fits of now were written to in other forms, each with the form.
        remarks: of outputs.
        tasks_per_second: of the fits of now, all that takes time counted: reading, fitting, keeping, pictures; None
            if there was nothing left to fit.
    """

    def __init__(self, run: Run, sources: list[Source], label: str) -> None:
        self.run, self.fits = run, Fits(run.path(label), run.settings(label))
        self.replaced = self.skipped = 0
        self.failures: list[Failure] = []
        self.exported: list[tuple[str, Path]] = []
        self.remarks: list[str] = []
        self.tasks_per_second: float | None = None
        self._sources = sources
        self._records: dict[str, Document] = {}  # by the sources' places
        self._earlier: set[str] = set()  # places of fits of before
        self._tiles: dict[str, Tiles] = {}
        self._bar = Bar()

    @property
    def records(self) -> list[Document]:
        """As the attributes say."""
        return [self._records[source.place] for source in self._sources if source.place in self._records]

    @property
    def folder(self) -> Path:
        """The folder of the run; of a single fit the task's."""
        return Path(self.records[0]["folder"]) if len(self._records) == 1 else self.fits.path

    def document(self) -> Document:
        """The object that --json prints."""
        settings, records = self.fits.settings, self.records
        stated = ("app", "observe", "paradigm", "rule", "steps", "device", "data", "precision")
        fields = ("name", "error", "photo_error", "mean_tilt_degrees", "seconds", "counts", "note", "warning", "folder")
        return {
            **{key: settings[key] for key in (*stated, *self.run.app.conditions()) if key in settings},
            **summary(records),
            "guarded": guarded(records),
            "tasks": [{key: record[key] for key in fields if key in record} for record in records],
            "tasks_per_second": self.tasks_per_second,
            "failures": [{"source": failure.source, "reason": failure.reason} for failure in self.failures],
            "out": str(self.fits.path),
        }

    def fit(self) -> None:
        """Fit the sources, keep each fit, and draw the picture of the run.

        Raises:
            ValueError: nothing could be fitted.
        """
        begin, options = time.perf_counter(), self.run.options
        count = len(self._sources)
        with progress(self.run.paradigm.name, count, long=count > 1, quiet=options.quiet) as self._bar:
            self._bar.name(f"{Path(self._sources[0].place).name}: reading")
            for source, fit in fit_sources(self.run, self._sources, self._is_fitted):
                try:
                    if isinstance(fit, Fit):
                        self._keep(source, fit)
                    else:
                        self._fail(source, fit)
                except ValueError as error:
                    self._fail(source, error)
        if fitted := len(self._records) - self.skipped:
            self.tasks_per_second = fitted / (time.perf_counter() - begin)
        if not self._records:
            several = f"none of {count} inputs could be fitted; the first: " if count > 1 else ""
            raise ValueError(f"{several}{self.failures[0].reason}")
        self._draw()

    def _is_fitted(self, source: Source, task: Task) -> bool:
        """True if --resume skips a source: there is a fit of these settings, of an input of this content."""
        record = find_fit(self.fits.path, task.name, source.place)
        if record:
            self._earlier.add(source.place)
        same = record and self.fits.hold(record) and record.get("content") == content_of(task)
        if not (record and same and self.run.options.resume):
            self._bar.name(f"{task.name}: fitting", READ)
            return False
        self.skipped += 1
        self._finish(source, record, task, lambda: params_of(record, self.run.app))
        self._bar.advance(f"{task.name}: fitted before")
        return True

    def _fail(self, source: Source, error: Exception) -> None:
        if not isinstance(error, FORESEEN) and len(self._sources) == 1:
            raise error
        counted = source.named or not isinstance(error, BadInput)
        self.failures.append(Failure(source.place, str(named(error, Path(source.place))), counted))
        self._bar.advance(f"failed: {Path(source.place).name}")

    def _keep(self, source: Source, fit: Fit) -> None:
        """Write the parameters, the pictures and the record of a fit, in this order, then its exports."""
        theta = fit.parameters
        self._bar.name(f"{fit.name}: pictures", FITTED)

        def draw(folder: Path) -> None:
            with torch.no_grad():
                files, lines = rendered(self.run, fit.task, theta)
                write_pictures(self.run.presenter.pictures(theta, fit.task) | files, folder)
                self.remarks += [f"{fit.name}: {line}" for line in lines]

        origin = self.run.origin(source.given)
        record = fit.record | {"source": source.place, "content": content_of(fit.task), "origin": origin}
        kept = self.fits.write(record, theta, draw)
        self.replaced += source.place in self._earlier
        self._finish(source, kept, fit.task, lambda: theta)
        for form in self.run.options.exports:
            self._bar.name(f"{fit.name}: {form}", DRAWN)
            self._export(fit, kept, form)
        errors = [f"{key.replace('_', ' ')} {kept[key]:.3f}" for key in ERRORS if kept.get(key) is not None]
        self._bar.advance(", ".join([kept["name"], *errors[:1], f"{kept['seconds']:.4f} s"]))

    def _export(self, fit: Fit, record: Document, form: str) -> None:
        """Write a fit that is kept in a form of --export."""
        path = export_path(record, form)
        try:
            with torch.no_grad():
                export_fit(self.run, fit.task, fit.parameters, path, form, self.fits.settings)
            self.exported.append((form, opened_file(path)))
        except (ValueError, OSError) as error:
            why = getattr(error, "strerror", None) or str(error).removesuffix(".")
            again = f"metapp export {record['folder']} {form}"
            line = f"{path}: not written as {form}: {why}; the fit is kept, write it by {again} --out FOLDER."
            self.failures.append(Failure(str(path), line, kept=True))

    def _finish(self, source: Source, record: Document, task: Task, theta: Callable[[], Params]) -> None:
        """Take over the record of a fit; of the first ones tiles of the run's picture."""
        self._records[source.place] = record
        if len(self._tiles) < ROWS:
            with torch.no_grad():
                self._tiles[source.place] = tiles_of_fit(self.run.presenter, task, theta(), record)

    def _draw(self) -> None:
        """Write `pictures.png`: the first of these fits beside their photos or references, then fits of before."""
        app, mean = self.run.app, summary(self.records)["error"]
        title = f"{self.run.presenter.title}, {self.run.paradigm.name}"
        count = len(self._records)
        title += "" if mean is None or count == 1 else f": mean error{app.factor} {mean:.3f} of {count} fits"
        tiles = {
            Path(self._records[source.place]["folder"]).name: self._tiles[source.place]
            for source in self._sources
            if source.place in self._tiles
        }
        add_to_sheet(tiles, title, self.fits.path)


def execute(run: Run) -> Execution | None:
    """Train the checkpoint, if that is asked for, then fit all inputs and keep each fit in its folder.

    Returns:
        The fits; None on all but the first of several ranks, which train alone.

    Raises:
        ValueError: bad inputs, no checkpoint, a folder that cannot be written to; nothing could be fitted.
        FloatingPointError: training is not finite.
    """
    with threads(single=run.app.single_threaded):
        if ranks.number() > 0:
            if run.options.train:
                with reporting(Reporter()):
                    _with_checkpoint(replace(run, options=replace(run.options, quiet=True)))
            return None
        make_folder(run.options.out)
        sources, label = sources_to_fit(run)
        run = replace(run, checkpoint=_with_checkpoint(run).checkpoint)
        assert run.checkpoint is not None
        if not run.options.quiet:
            count = f"{len(sources)} input{'s' * (len(sources) != 1)}"
            size = "; files of {:,} rows, {:,} columns".format(*run.presenter.size) if run.presenter.size else ""
            steps = f"{run.paradigm.steps} steps, from {run.checkpoint.source}"
            say(f"{run.app.full_name} {run.paradigm.name}: {count}; {steps}{size}")
        execution = Execution(run, sources, label)
        execution.fit()
        return execution


def _with_checkpoint(run: Run) -> Run:
    if not run.options.train:
        return with_checkpoint(run)
    from metapp.runs.training import trained  # here: most runs train nothing

    return trained(run)
