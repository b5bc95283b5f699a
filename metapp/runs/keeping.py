"""The fits of a command: inputs are fitted, and each fit is written to its folder in the folder of the run.

What becomes of each input is yielded, for the command line to print. Nothing here prints: messages and progress go to
the reporter.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from metapp.runs.environment import torch_defaults
from metapp.runs.fit import Fit, read_fit
from metapp.runs.fit_tables import mean_error
from metapp.runs.fitting import FIT_ERRORS, FORESEEN_ERRORS, Failure, Fitter, fit_each, say_doubts
from metapp.runs.inputs.finding import Input
from metapp.runs.outputs.contact_sheet import MAX_SHEET_ROWS, SHEET_FILE_NAME, write_run_sheet
from metapp.runs.outputs.fit_files import export_path
from metapp.runs.reporter import Bar, progress, say
from metapp.runs.spec import RunOptions, Spec
from metapp.storage.files import DISK_FULL_ERRNOS, error_text
from metapp.storage.fit_folders import find_fit_folder

FITTED_TIME_SHARE, DRAWN_TIME_SHARE = 0.5, 0.9  # about the shares of an input's time when it is fitted, and when drawn


def fit_and_keep(
    fitters: Sequence[Fitter], inputs: Sequence[Input], run_folder: Path, options: RunOptions
) -> Iterator[Fit | Failure]:
    """Fit inputs, keep each fit in the folder of the run, and write the contact sheet of the first ones.

    If an input cannot be read or fitted, or its fit cannot be drawn or written, a failure says so, and the other inputs
    are fitted. Once the disk is full, no other is.

    Args:
        fitters: what fits each input.
        inputs: the inputs, one or more.
        run_folder: the folder of the run.
        options: the options of the command.

    Yields:
        What became of each input, in the order in which fits end: a fit in its folder, or a failure. A failure for each
        export that could not be written follows its fit.

    Raises:
        Exception: an error of a run of one input that is none of FORESEEN_ERRORS.
    """

    def find_earlier(one: Input, spec: Spec) -> Fit | None:
        """Return the fit of an input by its specification that the run holds, if it is asked for."""
        folder = find_fit_folder(run_folder, one.name, one.place) if options.resume else None
        with contextlib.suppress(ValueError, FileNotFoundError):
            fit = read_fit(folder) if folder else None
            return fit if fit and fit.spec.document() == spec.document() else None
        return None

    fits: list[Fit] = []
    remaining = {id(one): one for one in inputs}
    with progress(fitters[0].spec.paradigm, len(inputs), long=len(inputs) > 1, quiet=options.quiet) as bar:
        bar.set_label(f"{Path(inputs[0].place).name}: reading")
        for one, result in fit_each(fitters, inputs, batch=options.batch, find_earlier=find_earlier, bar=bar):
            del remaining[id(one)]
            outcome, failures = result, list[Failure]()
            if isinstance(result, Fit) and not result.is_earlier:
                outcome, failures = _keep(one, result, run_folder, options, bar, on_sheet=len(fits) < MAX_SHEET_ROWS)
            if isinstance(outcome, Fit):
                fits.append(outcome)
                state = "fitted before" if outcome.is_earlier else f"{outcome.seconds:.4f} s"
                bar.advance(", ".join(filter(None, (outcome.name, outcome.error_text("error "), state))))
            else:
                bar.advance(f"failed: {Path(one.place).name}")
                if len(inputs) == 1 and not isinstance(outcome.error, FORESEEN_ERRORS):
                    raise outcome.error
            yield from (outcome, *failures)
            if isinstance(outcome, Failure) and getattr(outcome.error.__cause__, "errno", None) in DISK_FULL_ERRNOS:
                break
        for one in remaining.values():
            yield Failure.of(one, ValueError(f"not fitted, since the disk is full: {run_folder}"))
    shown = fits[:MAX_SHEET_ROWS]
    if any(not fit.is_earlier for fit in shown) or (shown and not (run_folder / SHEET_FILE_NAME).is_file()):
        _write_contact_sheet(fits, run_folder)


def _keep(
    one: Input, fit: Fit, run_folder: Path, options: RunOptions, bar: Bar, *, on_sheet: bool
) -> tuple[Fit | Failure, list[Failure]]:
    """Write a fit and its exports, and draw it for the contact sheet.

    Args:
        one: the input.
        fit: its fit.
        run_folder: the folder of the run.
        options: the options of the command.
        bar: the progress of the run.
        on_sheet: whether the contact sheet shows the fit.

    Returns:
        The fit, or a failure in its place; and a failure for each export that could not be written.
    """
    failures: list[Failure] = []
    try:
        with torch_defaults(single=fit.app.small_tensors):
            bar.set_label(f"{fit.name}: pictures", FITTED_TIME_SHARE)
            say_doubts(fit)
            remarks: list[str] = []
            fit.keep(run_folder, lambda folder: remarks.extend(fit.draw(folder)))
            for line in remarks:
                say(line)
            _ = fit.tiles if on_sheet else None  # drawn now, while the task is in memory
            for form in options.exports:
                bar.set_label(f"{fit.name}: {form}", DRAWN_TIME_SHARE)
                path = export_path(fit.folder, form)
                try:
                    fit.write_export(form, path)
                except (ValueError, OSError) as error:
                    reason = getattr(error, "strerror", None) or str(error).removesuffix(".")
                    command = f"metapp export {fit.folder} {form}"
                    line = (
                        f"{path}: not written as {form}: {reason}; the fit is kept, write it by {command} --out FOLDER."
                    )
                    failures.append(Failure(str(path), ValueError(line), is_fit_kept=True))
    except FIT_ERRORS as error:
        return Failure.of(one, error, size=fit.presenter.size), []
    fit.forget()
    return fit, failures


def _write_contact_sheet(fits: Sequence[Fit], run_folder: Path) -> None:
    """Write the contact sheet of a run into its folder, with those MAX_SHEET_ROWS fits that were done first.

    A sheet that cannot be written is said, and the report of the run goes on.
    """
    title, mean = f"{fits[0].presenter.title}, {fits[0].spec.paradigm}", mean_error(fits)
    if mean is not None and len(fits) > 1:
        title += f": mean error{fits[0].app.error_measure.factor} {mean:.3f} of {len(fits)} fits"
    try:
        write_run_sheet([fit.tiles for fit in fits[:MAX_SHEET_ROWS]], title, run_folder)
    except (OSError, ValueError) as error:
        say(f"warning: {error_text(error)}")
