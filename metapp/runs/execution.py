"""The execution of a run: its checkpoint is provided, its inputs are fitted, and each fit is written to its folder.

What became of each input is returned as plain data, which the command line prints. Nothing here prints: messages and
progress go to the reporter.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.paradigms import ranks
from metapp.runs.checkpoint_selection import Checkpoint, find_checkpoint
from metapp.runs.choice import Choice
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fitter import FIT_ERRORS, FITTED_TIME_SHARE, BadInput, Fitter, fit_inputs
from metapp.runs.inputs.run_inputs import Input, find_inputs
from metapp.runs.memory_errors import describe_short_memory
from metapp.runs.outputs.contact_sheet import MAX_SHEET_ROWS, Tiles, tiles_of_fit, write_run_sheet
from metapp.runs.outputs.fit_files import export_fit, export_path, file_to_open, render_outputs, write_pictures
from metapp.runs.reporter import Bar, Reporter, progress, say, use_reporter
from metapp.storage.files import DISK_FULL_ERRNOS, error_about_file, error_text
from metapp.storage.fit_records import FitRecord, summary
from metapp.storage.fit_store import FitStore

DRAWN_TIME_SHARE = 0.9  # about the share of an input's time that has passed once its pictures are drawn and written
# Errors that may happen without a mistake in the code. An input that cannot be fitted by one of these is reported in a
# line, whether the run has one input or several. A RuntimeError of a fit may be a mistake: a run of one input raises
# it, while a run of several inputs reports it in a line and fits the others. Other errors of a fit end any run.
FORESEEN_ERRORS = (ValueError, OSError, FloatingPointError, MemoryError)


class Failure(NamedTuple):
    """An input that was not fitted, or a file format that a fit could not be written in.

    Attributes:
        place: the place of the input, or the path of the file that was not written.
        reason: the error message, which names the place.
        fails_run: whether the run counts as failed; a damaged file that was found in a folder does not count.
        is_fit_kept: whether the fit is kept, and only an export was not written.
    """

    place: str
    reason: str
    fails_run: bool = True
    is_fit_kept: bool = False


@dataclass
class RunReport:
    """What became of the inputs of a command.

    Attributes:
        fitter: what fitted the inputs.
        store: the folder of the fits.
        records: the records of all fits, both new ones and earlier ones that --resume kept, in the order of the inputs.
        earlier_count: the number of fits that --resume kept.
        replaced_count: the number of new fits that replaced earlier ones.
        exports: pairs of a file format and the file that a user opens.
        remarks: lines about outputs, such as renderings.
        failures: inputs that were not fitted, and exports that were not written.
        tiles: the pictures of the first fits, for the contact sheet.
        tasks_per_second: the number of new fits, divided by the seconds in which all inputs were read and fitted, and
            fits drawn, written and exported; None if there was no new fit. What comes before the first input, such as
            a training, does not count, nor does the writing of the contact sheet.
    """

    fitter: Fitter
    store: FitStore
    records: list[FitRecord] = field(default_factory=list)
    earlier_count: int = 0
    replaced_count: int = 0
    exports: list[tuple[str, Path]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    tiles: list[Tiles] = field(default_factory=list)
    tasks_per_second: float | None = None

    @property
    def path(self) -> Path:
        """The folder of the run, or the folder of the task if the run has a single fit."""
        return Path(self.records[0].folder) if len(self.records) == 1 else self.store.path


def execute(choice: Choice, provide: Callable[[Choice], Checkpoint] = find_checkpoint) -> RunReport:
    """Provide the checkpoint of a choice, then fit all inputs and keep each fit in its folder.

    Args:
        choice: the recipe, the paradigm and the sources of the inputs.
        provide: a function that returns the checkpoint. The default reads it from a file. With --train the caller
            passes :func:`metapp.runs.checkpoint_training.train_and_load`, whose module most runs need not import.

    Returns:
        The report on all inputs.

    Raises:
        ValueError: inputs are bad, there is no checkpoint, a folder cannot be written to, or nothing could be fitted.
        OSError: a file of the only fit cannot be written, for example to a full disk.
        FloatingPointError: training is not finite.
        Exception: an error that ends the fits, see :func:`_keep_fits`.
    """
    options = choice.options
    if not options.train:
        ranks.end_other_ranks()
    silence = use_reporter(Reporter()) if ranks.rank_number() > 0 else contextlib.nullcontext()
    with torch_defaults(single=choice.app.small_tensors), silence:
        make_folder(options.out)
        inputs, label = find_inputs(choice)
        checkpoint = provide(choice)
        fitter = Fitter(choice, checkpoint, label)
        if not options.quiet:
            count = f"{len(inputs)} input{'s' * (len(inputs) != 1)}"
            size = choice.presenter.size
            files = "; files of {:,} rows, {:,} columns".format(*size) if size else ""
            steps = f"{choice.paradigm.steps} steps, from {checkpoint.source}"
            say(f"{choice.app.full_name} {choice.paradigm.name}: {count}; {steps}{files}")
        report = RunReport(fitter, fitter.store)
        begin = time.perf_counter()
        _keep_fits(report, inputs)
        if new_count := len(report.records) - report.earlier_count:
            report.tasks_per_second = new_count / (time.perf_counter() - begin)
        if not report.records:
            introduction = f"none of {len(inputs)} inputs could be fitted; the first: " if len(inputs) > 1 else ""
            raise ValueError(f"{introduction}{report.failures[0].reason}")
        # fits come as inputs are done, in another order than the inputs where several are fitted side by side
        order = {run_input.place: number for number, run_input in enumerate(inputs)}
        report.records.sort(key=lambda record: order.get(record.source, len(order)))
        _write_contact_sheet(report)
        return report


def _keep_fits(report: RunReport, inputs: Sequence[Input]) -> None:
    """Fit inputs, keep each fit in the folder of the run, add what became of it to the report, and show progress.

    If an input cannot be read or fitted by an error that :func:`fit_inputs` returns, or its fit cannot be drawn or
    written, the report says so, and the other inputs are fitted. Once the disk is full, no other is.

    Args:
        report: the report.
        inputs: the inputs to fit, one or more.

    Raises:
        Exception: an error that the report cannot state: an error of a run of one input that is none of
            FORESEEN_ERRORS, an error that :func:`fit_inputs` raises, or an error other than ValueError, OSError and
            RuntimeError by which pictures are not drawn.
    """
    choice, input_count = report.fitter.choice, len(inputs)
    remaining = {run_input.place: run_input for run_input in inputs}
    with progress(choice.paradigm.name, input_count, long=input_count > 1, quiet=choice.options.quiet) as bar:
        bar.set_label(f"{Path(inputs[0].place).name}: reading")
        for run_input, fit in fit_inputs(report.fitter, inputs, report.store, bar):
            remaining.pop(run_input.place)
            if isinstance(fit, Exception):
                error = _name_short_memory(choice, fit)
                if input_count == 1 and not isinstance(error, FORESEEN_ERRORS):
                    raise error
                _add_failure(report, run_input, error, bar)
                continue
            try:
                _keep_fit(report, run_input, fit, bar)
            except FIT_ERRORS as writing_error:
                error = _name_short_memory(choice, writing_error)
                if input_count == 1 and not isinstance(error, ValueError):
                    raise
                _add_failure(report, run_input, error, bar)
                if isinstance(error, OSError) and error.errno in DISK_FULL_ERRNOS:
                    break
        for run_input in remaining.values():
            _add_failure(report, run_input, ValueError(f"not fitted, since the disk is full: {report.store.path}"), bar)


def _name_short_memory(choice: Choice, error: Exception) -> Exception:
    """Return an error, or a ValueError that says so if memory did not suffice."""
    line = describe_short_memory(error, choice.presenter.size)
    return ValueError(line) if line else error


def _add_failure(report: RunReport, run_input: Input, error: Exception, bar: Bar) -> None:
    """Add to a report that the fit of an input failed by an error, and show the failure in the progress.

    A bad input that the user did not name, but that was found in a folder, does not fail the run.
    """
    bar.advance(f"failed: {Path(run_input.place).name}")
    fails_run = run_input.is_named or not isinstance(error, BadInput)
    reason = str(error_about_file(error, Path(run_input.place)))
    report.failures.append(Failure(run_input.place, reason, fails_run))


def _keep_fit(report: RunReport, run_input: Input, fit: Fit, bar: Bar) -> None:
    """Write the parameters, the pictures and the record of a fit, in this order, then its exports.

    An earlier fit, which the store holds, stays as it is.

    Args:
        report: the report, to which the fit is added.
        run_input: the input that was fitted.
        fit: the fit.
        bar: the progress of the run.

    Raises:
        ValueError: the parameters of an earlier fit are damaged, or the fit cannot be drawn or written.
        OSError: a file of the fit cannot be written, for example to a full disk.
    """
    choice, task, store = fit.choice, fit.task, report.store
    is_shown = len(report.tiles) < MAX_SHEET_ROWS
    if fit.record.folder:
        tiles = [_draw_tiles(fit, fit.record)] if is_shown else []
        bar.advance(f"{task.name}: fitted before")
        report.earlier_count += 1
        report.tiles += tiles
        report.records.append(fit.record)
        return
    bar.set_label(f"{fit.name}: pictures", FITTED_TIME_SHARE)
    remarks: list[str] = []

    def draw(fit_folder: Path) -> None:
        with torch.no_grad():
            renders, lines = render_outputs(choice, task, fit.parameters)
            write_pictures(choice.presenter.pictures(fit.parameters, task) | renders, fit_folder)
            remarks.extend(f"{fit.name}: {line}" for line in lines)

    replaces_earlier = store.holds(task.name, run_input.place)
    record = store.write(fit.record, fit.parameters, draw)
    tiles = [_draw_tiles(fit, record)] if is_shown else []
    _write_exports(report, fit, record, bar)
    report.tiles += tiles
    report.replaced_count += replaces_earlier
    report.remarks += remarks
    report.records.append(record)
    errors = {"error": record.error, "photo error": record.photo_error}
    texts = [f"{name} {value:.3f}" for name, value in errors.items() if value is not None]
    bar.advance(", ".join([record.name, *texts[:1], f"{fit.seconds:.4f} s"]))


def _write_exports(report: RunReport, fit: Fit, record: FitRecord, bar: Bar) -> None:
    """Write a fit in the file formats of --export, and add to a report what was written and what was not.

    Args:
        report: the report.
        fit: the fit.
        record: its record as it is kept, with the folder of the fit.
        bar: the progress of the run.
    """
    for form in fit.choice.options.exports:
        bar.set_label(f"{fit.name}: {form}", DRAWN_TIME_SHARE)
        path = export_path(record, form)
        try:
            with torch.no_grad():
                export_fit(fit.choice, fit.task, fit.parameters, path, form, record.settings)
            report.exports.append((form, file_to_open(path)))
        except (ValueError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error).removesuffix(".")
            command = f"metapp export {record.folder} {form}"
            line = f"{path}: not written as {form}: {reason}; the fit is kept, write it by {command} --out FOLDER."
            report.failures.append(Failure(str(path), line, is_fit_kept=True))


def _draw_tiles(fit: Fit, record: FitRecord) -> Tiles:
    with torch.no_grad():
        return tiles_of_fit(fit.choice.presenter, fit.task, fit.parameters, record)


def _write_contact_sheet(report: RunReport) -> None:
    """Write the contact sheet `pictures.png` of a run into its folder.

    The sheet shows those MAX_SHEET_ROWS fits of the run that were done first, each beside its photo or reference. A
    sheet that cannot be written is said, and the report of the run goes on.
    """
    choice, records = report.fitter.choice, report.records
    mean = summary(records)["error"]
    title = f"{choice.presenter.title}, {choice.paradigm.name}"
    if mean is not None and len(records) > 1:
        title += f": mean error{choice.app.error_measure.factor} {mean:.3f} of {len(records)} fits"
    try:
        write_run_sheet(report.tiles, title, report.store.path)
    except OSError as error:
        say(f"warning: {error_text(error)}")
