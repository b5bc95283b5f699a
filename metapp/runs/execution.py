"""Fits of a run, kept: its inputs are read and fitted, and each fit is written to a folder of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.apps import full_name
from metapp.learning.task import Params, Task
from metapp.paradigms import ranks
from metapp.runs.checkpoint_selection import attach_checkpoint
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fitting import FITTED_TIME_SHARE, BadInput, EarlierFit, fit_sources
from metapp.runs.inputs.run_inputs import Input, find_inputs, task_digest
from metapp.runs.outputs.contact_sheet import MAX_SHEET_ROWS, Tiles, add_to_sheet, tiles_of_fit
from metapp.runs.outputs.fit_files import export_fit, export_path, file_to_open, render_outputs, write_pictures
from metapp.runs.reporter import Bar, Reporter, progress, say, use_reporter
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.files import error_about_file
from metapp.storage.fit_folders import RunFolder, summary
from metapp.storage.parameters import read_checked_params

ERROR_RECORD_KEYS = ("error", "photo_error")  # of a record, the first that there is
DRAWN_TIME_SHARE = 0.9  # share of an input's time until its pictures are drawn, about
FORESEEN_ERRORS = (ValueError, OSError, FloatingPointError, MemoryError)  # errors of inputs and fits


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


class Outcome(NamedTuple):
    """What became of a source of a run.

    Attributes:
        place: of the source.
        record: of its fit; None if there is none.
        is_earlier: whether --resume kept an earlier fit.
        replaces: whether the fit replaced an earlier one.
        exported: the files that the fit was written to in other forms, each with the form.
        remarks: of outputs.
        failures: why the source was not fitted, or which exports were not written.
        tiles: its pictures in the picture of the run, of the first ROWS fits.
    """

    place: str
    record: Document | None = None
    is_earlier: bool = False
    replaces: bool = False
    exported: Sequence[tuple[str, Path]] = ()
    remarks: Sequence[str] = ()
    failures: Sequence[Failure] = ()
    tiles: Tiles | None = None


class RunReport(NamedTuple):
    """What became of all sources of a run.

    Attributes:
        run: with its checkpoint.
        folder: of the run.
        outcomes: in the order of the sources.
        tasks_per_second: fits of now in a second, all that takes time counted: reading, fitting, keeping, pictures;
            None if there was nothing left to fit.
    """

    run: Run
    folder: RunFolder
    outcomes: Sequence[Outcome]
    tasks_per_second: float | None

    @property
    def records(self) -> list[Document]:
        """The records of all fits, of now and of before."""
        return [outcome.record for outcome in self.outcomes if outcome.record]

    @property
    def failures(self) -> list[Failure]:
        """The inputs that were not fitted, and the exports that were not written."""
        return [failure for outcome in self.outcomes for failure in outcome.failures]

    @property
    def path(self) -> Path:
        """The folder of the run; of a single fit the task's."""
        return Path(self.records[0]["folder"]) if len(self.records) == 1 else self.folder.path


def execute_run(run: Run, provide: Callable[[Run], Run] = attach_checkpoint) -> RunReport | None:
    """Get the checkpoint of a run, then fit all inputs and keep each fit in its folder.

    Args:
        run: without its checkpoint.
        provide: gives the run its checkpoint; of --train it is `metapp.runs.checkpoint_training.train_run`, which few runs need.

    Returns:
        What became of the inputs; None on all but the first of several ranks, which train alone.

    Raises:
        ValueError: bad inputs, no checkpoint, a folder that cannot be written to; nothing could be fitted.
        FloatingPointError: training is not finite.
    """
    with torch_defaults(single=run.app.single_threaded):
        if ranks.rank_number() > 0:
            if run.options.train:
                with use_reporter(Reporter()):
                    provide(replace(run, options=replace(run.options, quiet=True)))
            return None
        make_folder(run.options.out)
        sources, label = find_inputs(run)
        run = replace(run, checkpoint=provide(run).checkpoint)
        assert run.checkpoint is not None
        if not run.options.quiet:
            count = f"{len(sources)} input{'s' * (len(sources) != 1)}"
            size = "; files of {:,} rows, {:,} columns".format(*run.presenter.size) if run.presenter.size else ""
            steps = f"{run.paradigm.steps} steps, from {run.checkpoint.source}"
            say(f"{full_name(run.app)} {run.paradigm.name}: {count}; {steps}{size}")
        begin, folder = time.perf_counter(), run.folder(label)
        outcomes = list(keep_fits(run, folder, sources))
        fitted = sum(outcome.record is not None and not outcome.is_earlier for outcome in outcomes)
        rate = fitted / (time.perf_counter() - begin) if fitted else None
        order = {source.place: number for number, source in enumerate(sources)}
        report = RunReport(run, folder, sorted(outcomes, key=lambda outcome: order[outcome.place]), rate)
        if not report.records:
            several = f"none of {len(sources)} inputs could be fitted; the first: " if len(sources) > 1 else ""
            raise ValueError(f"{several}{report.failures[0].reason}")
        _draw(report)
        return report


def keep_fits(run: Run, folder: RunFolder, sources: Sequence[Input]) -> Iterator[Outcome]:
    """Fit sources and keep each fit, with progress.

    Args:
        run: with its checkpoint.
        folder: of the run.
        sources: to fit, one or more.

    Yields:
        What became of each source, as soon as it is known.
    """
    drawn, count = 0, len(sources)
    with progress(run.paradigm.name, count, long=count > 1, quiet=run.options.quiet) as bar:
        bar.name(f"{Path(sources[0].place).name}: reading")
        for source, fit in fit_sources(run, sources, folder, bar):
            if isinstance(fit, Exception):
                if count == 1 and not isinstance(fit, FORESEEN_ERRORS):
                    raise fit
                outcome = _failed(source, fit, bar)
            else:
                try:
                    outcome = _kept(folder, source, fit, bar, is_shown=drawn < MAX_SHEET_ROWS)
                    drawn += 1
                except ValueError as error:
                    outcome = _failed(source, error, bar)
            yield outcome


def _failed(source: Input, error: Exception, bar: Bar) -> Outcome:
    """Return the outcome of a source that was not fitted, by its error."""
    bar.advance(f"failed: {Path(source.place).name}")
    counted = source.named or not isinstance(error, BadInput)
    return Outcome(
        source.place, failures=[Failure(source.place, str(error_about_file(error, Path(source.place))), counted)]
    )


def _kept(folder: RunFolder, source: Input, fit: Fit | EarlierFit, bar: Bar, *, is_shown: bool) -> Outcome:
    """Write the parameters, the pictures and the record of a fit, in this order, then its exports.

    Args:
        folder: of the run.
        source: that was fitted.
        fit: of now, or an earlier one, which stays as it is.
        bar: of the run.
        is_shown: whether the picture of the run shows the fit.
    """
    run, task = fit.run, fit.task
    if isinstance(fit, EarlierFit):
        tiles = _tiles(run, task, read_checked_params(fit.record, run.app), fit.record) if is_shown else None
        bar.advance(f"{task.name}: fitted before")
        return Outcome(source.place, fit.record, is_earlier=True, tiles=tiles)
    bar.name(f"{fit.name}: pictures", FITTED_TIME_SHARE)
    remarks: list[str] = []

    def draw(place: Path) -> None:
        with torch.no_grad():
            files, lines = render_outputs(run, task, fit.parameters)
            write_pictures(run.presenter.pictures(fit.parameters, task) | files, place)
            remarks.extend(f"{fit.name}: {line}" for line in lines)

    origin = run.origin(source.given)
    record = fit.record | {"source": source.place, "content": task_digest(task), "origin": origin}
    replaces = folder.earlier(task.name, source.place) is not None
    kept = folder.write(record, fit.parameters, draw)
    tiles = _tiles(run, task, fit.parameters, kept) if is_shown else None
    exported, failures = _export(fit, kept, bar)
    errors = [f"{key.replace('_', ' ')} {kept[key]:.3f}" for key in ERROR_RECORD_KEYS if kept.get(key) is not None]
    bar.advance(", ".join([kept["name"], *errors[:1], f"{kept['seconds']:.4f} s"]))
    return Outcome(source.place, kept, False, replaces, exported, remarks, failures, tiles)


def _export(fit: Fit, record: Document, bar: Bar) -> tuple[list[tuple[str, Path]], list[Failure]]:
    """Write a fit that is kept in the forms of --export; return the files that were written, and which were not."""
    exported, failures = [], []
    for form in fit.run.options.exports:
        bar.name(f"{fit.name}: {form}", DRAWN_TIME_SHARE)
        path = export_path(record, form)
        try:
            with torch.no_grad():
                export_fit(fit.run, fit.task, fit.parameters, path, form, record["settings"])
            exported.append((form, file_to_open(path)))
        except (ValueError, OSError) as error:
            why = getattr(error, "strerror", None) or str(error).removesuffix(".")
            again = f"metapp export {record['folder']} {form}"
            line = f"{path}: not written as {form}: {why}; the fit is kept, write it by {again} --out FOLDER."
            failures.append(Failure(str(path), line, kept=True))
    return exported, failures


def _tiles(run: Run, task: Task, theta: Params, record: Document) -> Tiles:
    with torch.no_grad():
        return tiles_of_fit(run.presenter, task, theta, record)


def _draw(report: RunReport) -> None:
    """Write `pictures.png`: the first of these fits beside their photos or references, then fits of before."""
    app, records = report.run.app, report.records
    mean = summary(records)["error"]
    title = f"{report.run.presenter.title}, {report.run.paradigm.name}"
    if mean is not None and len(records) > 1:
        title += f": mean error{app.error_measure.factor} {mean:.3f} of {len(records)} fits"
    tiles = {
        Path(outcome.record["folder"]).name: outcome.tiles
        for outcome in report.outcomes
        if outcome.record and outcome.tiles
    }
    add_to_sheet(tiles, title, report.folder.path)
