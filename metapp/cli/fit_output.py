"""The work of `metapp general|overfit|finetune|quickft|meta APP`, and what it prints.

The fits themselves are made and kept by :mod:`metapp.runs.execution`; here is how a person and a script hear of them.
"""

from __future__ import annotations

import shlex
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.text import Text

from metapp.appearance.presenter import Presenter
from metapp.cli.command_process import Exit, command_seconds, state_what_interruption_keeps
from metapp.cli.console import escape_control_characters, print_json, shorten_to_line, standard_output
from metapp.registry import registry
from metapp.runs.choice import find_and_choose
from metapp.runs.execution import RunReport, execute
from metapp.runs.fit_options import FitOptions
from metapp.runs.reporter import format_number, say
from metapp.storage import Document
from metapp.storage.fit_records import FitRecord, count_guarded, summary

if TYPE_CHECKING:
    from rich.table import Table

# degrees; at this mean tilt of normals a relief and its inverse differ by 0.02 of display values under other lights:
# the median over 20 synthetic materials (2.9 over 20 further ones)
VISIBLE_TILT_DEGREES = 3.0
MIN_TABLE_CHARACTERS = 50  # least width of a table, so that its title stays on one line
PHOTO_ERROR_TEXT = "mean |fit - photo| of display values where the photo does not clip"
LEFT_OUT_FIGURE = "left_out_db"  # PSNR of photographs that others predict, which fits state that can be relit
MAX_LISTED_PATHS = 5  # exported files of one format, up to which each is listed
MAX_LISTED_TASKS = 20  # tasks in the table of a run


def fit_and_print(options: FitOptions, *, json: bool) -> None:
    """Fit the inputs of options and print the results; the exit code is 1 if an input was not fitted.

    Args:
        options: the options of the fits.
        json: whether an object is printed in place of tables.

    Raises:
        Exit: an input was not fitted, or a file was not written.
        ValueError: inputs are bad, or nothing could be fitted.
    """
    training = "the same command goes on with training where it stopped, and " if options.train else "the same command "
    state_what_interruption_keeps(f"{training}with --resume fits only the inputs that have no fit yet")
    choice = find_and_choose(options)
    if options.train:
        from metapp.runs.checkpoint_training import train_and_load  # imported here, since most runs train nothing

        report = execute(choice, train_and_load)
    else:
        report = execute(choice)
    _print_report(report, json=json)
    counted_failures = [failure for failure in report.failures if failure.fails_run]
    unwritten = sum(failure.is_fit_kept for failure in counted_failures)
    if failed := len(counted_failures) - unwritten:
        say(f"error: {failed} of {failed + len(report.records)} inputs were not fitted.")
    if unwritten:
        say(f"error: {unwritten} export{'s were' if unwritten > 1 else ' was'} not written; all fits are kept.")
    if counted_failures:
        raise typer.Exit(Exit.FAILED)


def _print_report(report: RunReport, *, json: bool) -> None:
    """Print the table of a run or its object, its folder, and its failures."""
    choice, records = report.fitter.choice, report.records
    presenter, paradigm = choice.presenter, choice.paradigm.name
    if not choice.options.quiet:
        if not json:
            if len(records) > 1:
                rate = report.tasks_per_second
                standard_output().print(fits_table(presenter, paradigm, records, rate=rate, most=MAX_LISTED_TASKS))
            else:
                standard_output().print(fit_line(presenter, records[0]), soft_wrap=True)
                for remark in _describe_guard(paradigm, records):
                    say(remark)
        is_relief_changed = "relief" in choice.options.app_options.non_default_values()
        for line in (*report.remarks, *relief_lines(records, changed=is_relief_changed)):
            say(line)
        if skipped := report.earlier_count:
            line = f"{skipped} of {len(records)} inputs are skipped, since they have a fit by equal settings"
            has_file_options = choice.options.exports or presenter.size
            say(f"{line}; metapp export writes other files of these fits" if has_file_options else line)
        if replaced := report.replaced_count:
            fits = f"{replaced} of {len(records)} fits and their pictures"
            say(f"{fits} replace earlier ones; --resume keeps earlier fits")
        for line in _describe_exports(report.exports):
            say(line)
        say(f"fits: {report.path}")
        if "view" in registry().commands:
            say(f"to look at: metapp view {shlex.quote(str(report.path))}")
    for failure in report.failures:
        prefix = "failed" if failure.fails_run else "warning: skipped"
        say(f"{prefix}: {shorten_to_line(failure.reason)}")
    if json:
        print_json(_make_document(report))


def _make_document(report: RunReport) -> Document:
    """Make the object that --json prints."""
    settings, records = report.store.settings.document(), report.records
    setting_keys = ("app", "observe", "paradigm", "rule", "steps", "device", "data", "precision")
    conditions = report.fitter.choice.app.recorded_conditions()
    return {
        **{key: settings[key] for key in (*setting_keys, *conditions) if key in settings},
        **summary(records),
        "scale": report.fitter.choice.app.error_measure.scale,
        "guarded": count_guarded(records),
        "tasks": [_task_document(record) for record in records],
        "tasks_per_second": report.tasks_per_second,
        "failures": [{"source": failure.place, "reason": failure.reason} for failure in report.failures],
        "out": str(report.store.path),
    }


def _task_document(record: FitRecord) -> Document:
    """Return what --json prints of a fit."""
    stored = record.document()
    shown: Document = {key: stored[key] for key in ("name", "error", "photo_error") if key in stored}
    shown |= {key: record.figures[key] for key in ("mean_tilt_degrees", LEFT_OUT_FIGURE) if key in record.figures}
    shown |= {key: stored[key] for key in ("seconds", "counts", "note", "warning") if key in stored}
    return shown | {"folder": record.folder}


def relief_lines(records: Sequence[FitRecord], *, changed: bool = False) -> list[str]:
    """Return a line about normals that fits found in photographs; [] if they found none.

    If steep normals were found in one photograph, it says that dents may be bumps: both look alike under one flash.

    Args:
        records: records of the fits.
        changed: whether --relief gives exported slopes another factor.
    """
    tilts = [record.figures["mean_tilt_degrees"] for record in records if "mean_tilt_degrees" in record.figures]
    if not tilts:
        return []
    mean = f"mean tilt {statistics.median(tilts):.1f} degrees"
    mean += f", median of {len(tilts)}, up to {max(tilts):.1f}" if len(tilts) > 1 else ""
    mean += ", without --relief" if changed else ""
    of_one_photo = [record.figures for record in records if record.counts.get("photos", 1) == 1]
    if max((figures.get("mean_tilt_degrees", 0.0) for figures in of_one_photo), default=0.0) >= VISIBLE_TILT_DEGREES:
        mean += "; one photo cannot tell dents from bumps, several photos of one place do: metapp data rectify PHOTOS"
    return [f"relief: {mean}"]


def fit_line(presenter: Presenter[Any], record: FitRecord) -> str:
    """Return a sentence on a fit: the number of pictures, its error, and the seconds of the whole command."""
    app, count = presenter.app, len([*Path(record.folder).glob("*.png")])
    if record.error is not None:
        error = f"error{app.error_measure.factor} {record.error:.3f} ({app.error_measure.text})"
    elif LEFT_OUT_FIGURE in record.figures and record.photo_error is not None:
        psnr_db = record.figures[LEFT_OUT_FIGURE]
        error = f"photos that were left out are predicted to {psnr_db:.1f} dB, {record.photo_error:.2f} %"
    elif record.photo_error is not None:
        error = f"photo error {record.photo_error:.2f} % ({PHOTO_ERROR_TEXT})"
    else:
        error = presenter.caption(measured=False)
    pictures = [f"{count} picture{'s' * (count != 1)}"] if count else []
    name, seconds = escape_control_characters(record.name), f"{command_seconds():.1f} s in all"
    return f"{name}: {', '.join([*pictures, error, seconds])}"


def _describe_exports(exports: Sequence[tuple[str, Path]]) -> Iterator[str]:
    """Yield a line for each exported file; many files of one format share a line."""
    by_form: dict[str, list[Path]] = {}
    for form, file in exports:
        by_form.setdefault(form, []).append(file)
    for form, files in by_form.items():
        if len(files) > MAX_LISTED_PATHS:
            yield f"{form}: {len(files)} files, the first is {files[0]}"
        else:
            yield from (f"{form}: {file}" for file in files)


def _describe_guard(paradigm: str, records: Sequence[FitRecord]) -> list[str]:
    """Return a line about the guard of a learned rule, if it acted; else []."""
    count = count_guarded(records)
    if not count:
        return []
    from metapp.evaluation.rows import fit_remarks  # imported here, since it imports more than a table of fits needs

    return fit_remarks([{"paradigm": paradigm, "tasks": len(records), "guarded": count}])


def fits_table(
    presenter: Presenter[Any],
    paradigm: str,
    records: Sequence[FitRecord],
    *,
    rate: float | None = None,
    most: int | None = None,
) -> Table:
    """Make a table with a line for each task, or for the tasks of the largest errors, and with means in its last line.

    If tasks have no error, as photographs have none, the table says how many pictures were made instead.

    Args:
        presenter: the application's presenter.
        paradigm: the name of the paradigm.
        records: records of all tasks.
        rate: tasks that were fitted per second; None if it is not to be said.
        most: the most tasks to list; None for all.
    """
    from rich.table import Table  # imported here, as it takes 10 ms, and a single fit has no table

    remarks = _describe_guard(paradigm, records)
    listed_records = records
    if most is not None and len(records) > most:
        listed_records = sorted(records, key=lambda record: -(record.error or 0.0))[:most]
        remarks.insert(0, f"{most} of {len(records)} tasks are listed, those of the largest errors")
    if rate is not None:
        remarks.insert(0, f"{rate:.4g} tasks/s, with reading and pictures included")
    totals = summary(records)
    has_errors = totals["error"] is not None
    if "photo_error" in totals:
        remarks.insert(0, f"photo error: {PHOTO_ERROR_TEXT}")
    caption = "\n".join([presenter.caption(measured=has_errors), *remarks])
    table = Table(
        title=f"{presenter.title}: {paradigm}", show_footer=True, caption=caption, min_width=MIN_TABLE_CHARACTERS
    )
    has_means = has_errors or "photo_error" in totals
    table.add_column("task", "mean error; other columns: median" if has_means else "median")
    if has_errors:
        table.add_column(
            f"error{presenter.app.error_measure.factor}", format_number(totals["error"], ".3f"), justify="right"
        )
    if "photo_error" in totals:
        table.add_column("photo error %", format_number(totals["photo_error"], ".2f"), justify="right")
    table.add_column("seconds", format_number(totals["seconds"], ".4f"), justify="right")
    picture_counts = (
        {} if has_errors else {record.name: len([*Path(record.folder).glob("*.png")]) for record in listed_records}
    )
    if any(picture_counts.values()):
        table.add_column("pictures", justify="right")
    for record in listed_records:
        cells = [format_number(record.error, ".3f")] if has_errors else []
        cells += [format_number(record.photo_error, ".2f")] if "photo_error" in totals else []
        cells.append(format_number(record.seconds, ".4f"))
        cells += [f"{picture_counts[record.name]}"] if any(picture_counts.values()) else []
        table.add_row(Text(escape_control_characters(record.name)), *cells)
    return table
