"""The execution of a run: its checkpoint is provided, its inputs are fitted, and each fit is written to its folder.

The outcome of each input is returned as plain data, which the command line prints. Nothing here prints: messages and
progress go to the reporter.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.learning.task import Params, Task
from metapp.paradigms import ranks
from metapp.runs.checkpoint_selection import attach_checkpoint
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fitting import FIT_ERRORS, FITTED_TIME_SHARE, BadInput, EarlierFit, fit_inputs
from metapp.runs.inputs.run_inputs import Input, find_inputs, task_digest
from metapp.runs.memory_errors import describe_short_memory
from metapp.runs.outputs.contact_sheet import MAX_SHEET_ROWS, Tiles, tiles_of_fit, write_run_sheet
from metapp.runs.outputs.fit_files import export_fit, export_path, file_to_open, render_outputs, write_pictures
from metapp.runs.reporter import Bar, Reporter, progress, say, use_reporter
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.files import DISK_FULL_ERRNOS, error_about_file, error_text
from metapp.storage.fit_folders import RunFolder, summary
from metapp.storage.parameters import read_checked_params

# Entries of a record that hold errors of a fit; progress shows the first of them that is not None
ERROR_RECORD_KEYS = ("error", "photo_error")
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


class Outcome(NamedTuple):
    """The outcome of one input of a run.

    Attributes:
        place: the place of the input.
        record: the record of its fit; None if it was not fitted.
        is_earlier: whether --resume kept an earlier fit.
        replaces_earlier: whether the fit replaced an earlier one.
        exports: the exports of the fit: pairs of a file format and the file that a user opens.
        remarks: lines about outputs, such as renderings.
        failures: why the input was not fitted, or which exports were not written.
        tiles: the pictures of the fit in the contact sheet of the run; None if the sheet does not show it.
    """

    place: str
    record: Document | None = None
    is_earlier: bool = False
    replaces_earlier: bool = False
    exports: Sequence[tuple[str, Path]] = ()
    remarks: Sequence[str] = ()
    failures: Sequence[Failure] = ()
    tiles: Tiles | None = None


class RunReport(NamedTuple):
    """The outcomes of all inputs of a run.

    Attributes:
        run: the run, with its checkpoint.
        folder: the folder of the run.
        outcomes: one outcome for each input, in the order of the inputs.
        tasks_per_second: the number of new fits, divided by the seconds in which all inputs were read and fitted, and
            fits drawn, written and exported; None if there was no new fit. What comes before the first input, such as
            a training, does not count, nor does the writing of the contact sheet.
    """

    run: Run
    folder: RunFolder
    outcomes: Sequence[Outcome]
    tasks_per_second: float | None

    @property
    def records(self) -> list[Document]:
        """The records of all fits, both new ones and earlier ones that --resume kept."""
        return [outcome.record for outcome in self.outcomes if outcome.record]

    @property
    def failures(self) -> list[Failure]:
        """The inputs that were not fitted, and the exports that were not written."""
        return [failure for outcome in self.outcomes for failure in outcome.failures]

    @property
    def path(self) -> Path:
        """The folder of the run, or the folder of the task if the run has a single fit."""
        return Path(self.records[0]["folder"]) if len(self.records) == 1 else self.folder.path


def execute_run(run: Run, provide: Callable[[Run], Run] = attach_checkpoint) -> RunReport | None:
    """Provide the checkpoint of a run, then fit all inputs and keep each fit in its folder.

    Args:
        run: a run without its checkpoint.
        provide: a function that returns a run with its checkpoint. The default reads it from a file. With --train the
            caller passes :func:`metapp.runs.checkpoint_training.train_run`, whose module most runs need not import.

    Returns:
        The report of all outcomes. Of several ranks (processes of one training), only the first has a report; the
        others help to train and return None.

    Raises:
        ValueError: inputs are bad, there is no checkpoint, a folder cannot be written to, or nothing could be fitted.
        OSError: a file of the only fit cannot be written, for example to a full disk.
        FloatingPointError: training is not finite.
        Exception: an error that ends the fits, see :func:`keep_fits`.
    """
    with torch_defaults(single=run.app.small_tensors):
        if ranks.rank_number() > 0:
            if run.options.train:
                with use_reporter(Reporter()):  # shows neither messages nor progress
                    provide(replace(run, options=replace(run.options, quiet=True)))
            return None
        make_folder(run.options.out)
        inputs, label = find_inputs(run)
        run = replace(run, checkpoint=provide(run).checkpoint)
        assert run.checkpoint is not None
        if not run.options.quiet:
            count = f"{len(inputs)} input{'s' * (len(inputs) != 1)}"
            size = "; files of {:,} rows, {:,} columns".format(*run.presenter.size) if run.presenter.size else ""
            steps = f"{run.paradigm.steps} steps, from {run.checkpoint.source}"
            say(f"{run.app.full_name} {run.paradigm.name}: {count}; {steps}{size}")
        begin, folder = time.perf_counter(), run.folder(label)
        outcomes = list(keep_fits(run, folder, inputs))
        new_fits = sum(outcome.record is not None and not outcome.is_earlier for outcome in outcomes)
        tasks_per_second = new_fits / (time.perf_counter() - begin) if new_fits else None
        # outcomes come as inputs are done, in another order than the inputs where several are fitted side by side
        order = {run_input.place: number for number, run_input in enumerate(inputs)}
        outcomes.sort(key=lambda outcome: order[outcome.place])
        report = RunReport(run, folder, outcomes, tasks_per_second)
        if not report.records:
            introduction = f"none of {len(inputs)} inputs could be fitted; the first: " if len(inputs) > 1 else ""
            raise ValueError(f"{introduction}{report.failures[0].reason}")
        _write_contact_sheet(report)
        return report


def keep_fits(run: Run, folder: RunFolder, inputs: Sequence[Input]) -> Iterator[Outcome]:
    """Fit inputs, keep each fit in the folder of the run, and show progress.

    Args:
        run: a run with its checkpoint.
        folder: the folder of the run.
        inputs: the inputs to fit, one or more.

    Yields:
        The outcome of each input, as soon as it is known. If an input cannot be read or fitted by an error that
        :func:`fit_inputs` returns, or its fit cannot be drawn or written, the outcome says so, and the other inputs are
        fitted. Once the disk is full, the outcomes of all others are that they were not fitted.

    Raises:
        Exception: an error that is no outcome: an error of a run of one input that is none of FORESEEN_ERRORS, an error
            that :func:`fit_inputs` raises, or an error other than ValueError, OSError and RuntimeError by which
            pictures are not drawn.
    """
    shown_count, input_count = 0, len(inputs)
    remaining = {run_input.place: run_input for run_input in inputs}
    with progress(run.paradigm.name, input_count, long=input_count > 1, quiet=run.options.quiet) as bar:
        bar.set_label(f"{Path(inputs[0].place).name}: reading")
        for run_input, fit in fit_inputs(run, inputs, folder, bar):
            remaining.pop(run_input.place)
            if isinstance(fit, Exception):
                error = _name_short_memory(run, fit)
                if input_count == 1 and not isinstance(error, FORESEEN_ERRORS):
                    raise error
                outcome = _report_failure(run_input, error, bar)
            else:
                try:
                    outcome = _keep_fit(folder, run_input, fit, bar, is_shown=shown_count < MAX_SHEET_ROWS)
                    shown_count += 1
                except FIT_ERRORS as writing_error:
                    error = _name_short_memory(run, writing_error)
                    if input_count == 1 and not isinstance(error, ValueError):
                        raise
                    outcome = _report_failure(run_input, error, bar)
                    if isinstance(error, OSError) and error.errno in DISK_FULL_ERRNOS:
                        yield outcome
                        break
            yield outcome
        for run_input in remaining.values():
            yield _report_failure(run_input, ValueError(f"not fitted, since the disk is full: {folder.path}"), bar)


def _name_short_memory(run: Run, error: Exception) -> Exception:
    """Return an error, or a ValueError that says so if memory did not suffice."""
    line = describe_short_memory(error, run.presenter.size)
    return ValueError(line) if line else error


def _report_failure(run_input: Input, error: Exception, bar: Bar) -> Outcome:
    """Return the outcome of an input whose fit failed by an error, and show the failure in the progress.

    A bad input that the user did not name, but that was found in a folder, does not fail the run.
    """
    bar.advance(f"failed: {Path(run_input.place).name}")
    fails_run = run_input.is_named or not isinstance(error, BadInput)
    reason = str(error_about_file(error, Path(run_input.place)))
    return Outcome(run_input.place, failures=[Failure(run_input.place, reason, fails_run)])


def _keep_fit(folder: RunFolder, run_input: Input, fit: Fit | EarlierFit, bar: Bar, *, is_shown: bool) -> Outcome:
    """Write the parameters, the pictures and the record of a fit, in this order, then its exports.

    The record gets entries about the input: its place as `source`, a digest of the task's values as `content`, and as
    `origin` the paths by which a later command finds it again.

    Args:
        folder: the folder of the run.
        run_input: the input that was fitted.
        fit: a new fit, or an earlier one, whose files stay as they are: nothing is written.
        bar: the progress of the run.
        is_shown: whether the contact sheet of the run shows the fit, so that its pictures are drawn for it, too.

    Returns:
        The outcome of the input, with the record as it is kept, which also states the folder and the settings. Exports
        that could not be written are among its failures.

    Raises:
        ValueError: the parameters of an earlier fit are damaged, or the fit cannot be drawn or written.
        OSError: a file of the fit cannot be written, for example to a full disk.
    """
    run, task = fit.run, fit.task
    if isinstance(fit, EarlierFit):
        tiles = _draw_tiles(run, task, read_checked_params(fit.record, run.app), fit.record) if is_shown else None
        bar.advance(f"{task.name}: fitted before")
        return Outcome(run_input.place, fit.record, is_earlier=True, tiles=tiles)
    bar.set_label(f"{fit.name}: pictures", FITTED_TIME_SHARE)
    remarks: list[str] = []

    def draw(fit_folder: Path) -> None:
        with torch.no_grad():
            renders, lines = render_outputs(run, task, fit.parameters)
            write_pictures(run.presenter.pictures(fit.parameters, task) | renders, fit_folder)
            remarks.extend(f"{fit.name}: {line}" for line in lines)

    origin = run.input_places(run_input.given_paths)
    record = fit.record | {"source": run_input.place, "content": task_digest(task), "origin": origin}
    replaces_earlier = folder.earlier_record(task.name, run_input.place) is not None
    record = folder.write(record, fit.parameters, draw)
    tiles = _draw_tiles(run, task, fit.parameters, record) if is_shown else None
    exports, failures = _write_exports(fit, record, bar)
    errors = [f"{key.replace('_', ' ')} {record[key]:.3f}" for key in ERROR_RECORD_KEYS if record.get(key) is not None]
    bar.advance(", ".join([record["name"], *errors[:1], f"{record['seconds']:.4f} s"]))
    return Outcome(run_input.place, record, False, replaces_earlier, exports, remarks, failures, tiles)


def _write_exports(fit: Fit, record: Document, bar: Bar) -> tuple[list[tuple[str, Path]], list[Failure]]:
    """Write a fit in the file formats of --export.

    Args:
        fit: the fit.
        record: its record as it is kept, with the folder of the fit.
        bar: the progress of the run.

    Returns:
        The exports, pairs of a format and the file that a user opens; and the failures of other formats.
    """
    exports, failures = [], []
    for form in fit.run.options.exports:
        bar.set_label(f"{fit.name}: {form}", DRAWN_TIME_SHARE)
        path = export_path(record, form)
        try:
            with torch.no_grad():
                export_fit(fit.run, fit.task, fit.parameters, path, form, record["settings"])
            exports.append((form, file_to_open(path)))
        except (ValueError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error).removesuffix(".")
            command = f"metapp export {record['folder']} {form}"
            line = f"{path}: not written as {form}: {reason}; the fit is kept, write it by {command} --out FOLDER."
            failures.append(Failure(str(path), line, is_fit_kept=True))
    return exports, failures


def _draw_tiles(run: Run, task: Task, theta: Params, record: Document) -> Tiles:
    with torch.no_grad():
        return tiles_of_fit(run.presenter, task, theta, record)


def _write_contact_sheet(report: RunReport) -> None:
    """Write the contact sheet `pictures.png` of a run into its folder.

    The sheet shows those MAX_SHEET_ROWS fits of the run that were done first, in the order of their inputs, each beside
    its photo or reference. A sheet that cannot be written is said, and the report of the run goes on.
    """
    app, records = report.run.app, report.records
    mean = summary(records)["error"]
    title = f"{report.run.presenter.title}, {report.run.paradigm.name}"
    if mean is not None and len(records) > 1:
        title += f": mean error{app.error_measure.factor} {mean:.3f} of {len(records)} fits"
    tiles = [outcome.tiles for outcome in report.outcomes if outcome.tiles]
    try:
        write_run_sheet(tiles, title, report.folder.path)
    except OSError as error:
        say(f"warning: {error_text(error)}")
