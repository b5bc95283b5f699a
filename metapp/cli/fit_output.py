"""The work of `metapp general|overfit|finetune|quickft|meta APP`, and what it prints."""

from __future__ import annotations

import shlex
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.text import Text

from metapp.appearance.presenter import Presenter
from metapp.cli.console import (
    Exit,
    command_seconds,
    escape_control_characters,
    print_json,
    shorten_to_line,
    standard_output,
)
from metapp.registry import registry
from metapp.runs.execution import Outcome, RunReport, execute_run
from metapp.runs.fit_options import FitOptions
from metapp.runs.reporter import format_number, say
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.fit_folders import count_guarded, summary

if TYPE_CHECKING:
    from rich.table import Table

# Mean tilt from which a relief and its inverse differ under other lights by 0.02 of display values: the median of 20
# drawn materials; of 20 others it is 2.9.
VISIBLE_TILT_DEGREES = 3.0
MIN_TABLE_CHARACTERS = 50  # columns of a table, so that titles stay on a line
PHOTO_ERROR_TEXT = "mean |fit - photo| of display values where the photo does not clip"
MAX_LISTED_PATHS = 5  # of files of a form, of which each is named
MAX_LISTED_TASKS = 20  # tasks in the table of a run that lists what failed


def fit_and_print(options: FitOptions, *, json: bool) -> None:
    """Fit the inputs of options; the exit code is 1 if one was not fitted.

    Args:
        options: of the fits.
        json: print an object in place of tables.

    Raises:
        Exit: an input was not fitted, or a file was not written.
        ValueError: bad inputs; nothing could be fitted.
    """
    run = Run.from_options(options)
    if options.train:
        from metapp.runs.checkpoint_training import train_run  # here: most runs train nothing

        report = execute_run(run, train_run)
    else:
        report = execute_run(run)
    if report is None:
        return
    _show(report, json=json)
    counted = [failure for failure in report.failures if failure.fails_run]
    unwritten = sum(failure.is_fit_kept for failure in counted)
    if failed := len(counted) - unwritten:
        say(f"error: {failed} of {failed + len(report.records)} inputs were not fitted.")
    if unwritten:
        say(f"error: {unwritten} export{'s were' if unwritten > 1 else ' was'} not written; all fits are kept.")
    if counted:
        raise typer.Exit(Exit.FAILED)


def _show(report: RunReport, *, json: bool) -> None:
    """Print the table of a run, or its object, its folder, and failures."""
    run, records, outcomes = report.run, report.records, report.outcomes
    if not run.options.quiet:
        if not json:
            if len(records) > 1:
                rate = report.tasks_per_second
                standard_output().print(
                    fits_table(run.presenter, run.paradigm.name, records, rate=rate, most=MAX_LISTED_TASKS)
                )
            else:
                standard_output().print(fit_line(run.presenter, records[0]), soft_wrap=True)
                for remark in _of_guard(run.paradigm.name, records):
                    say(remark)
        remarks = [remark for outcome in outcomes for remark in outcome.remarks]
        for line in (*remarks, *relief_lines(records, changed="relief" in run.options.app_options.non_default_values())):
            say(line)
        if skipped := sum(outcome.is_earlier for outcome in outcomes):
            line = f"{skipped} of {len(records)} inputs have such a fit already, and are skipped"
            asked = run.options.exports or run.presenter.size
            say(f"{line}; metapp export writes other files of these" if asked else line)
        if replaced := sum(outcome.replaces_earlier for outcome in outcomes):
            fits = f"{replaced} of {len(records)} fits, and their pictures,"
            say(f"{fits} replace earlier ones; --resume keeps these")
        for line in _of_exports(outcomes):
            say(line)
        say(f"fits: {report.path}")
        if "view" in registry().commands:
            say(f"to look at: metapp view {shlex.quote(str(report.path))}")
    for failure in report.failures:
        what = "failed" if failure.fails_run else "warning: skipped"
        say(f"{what}: {shorten_to_line(failure.reason)}")
    if json:
        print_json(_document(report))


def _document(report: RunReport) -> Document:
    """Return the object that --json prints."""
    settings, records = report.folder.settings, report.records
    stated = ("app", "observe", "paradigm", "rule", "steps", "device", "data", "precision")
    fields = ("name", "error", "photo_error", "mean_tilt_degrees", "seconds", "counts", "note", "warning", "folder")
    return {
        **{key: settings[key] for key in (*stated, *report.run.app.conditions()) if key in settings},
        **summary(records),
        "guarded": count_guarded(records),
        "tasks": [{key: record[key] for key in fields if key in record} for record in records],
        "tasks_per_second": report.tasks_per_second,
        "failures": [{"source": failure.source, "reason": failure.reason} for failure in report.failures],
        "out": str(report.folder.path),
    }


def relief_lines(records: Sequence[Document], *, changed: bool = False) -> list[str]:
    """Return a line about normals that fits found in photographs; [] if they found none.

    Of steep ones of one photograph each it says that dents may be bumps: both look the same under one flash.

    Args:
        records: of the fits.
        changed: whether exported slopes are other than these, by --relief.
    """
    tilts = [record["mean_tilt_degrees"] for record in records if "mean_tilt_degrees" in record]
    if not tilts:
        return []
    mean = f"mean tilt {statistics.median(tilts):.1f} degrees"
    mean += f", median of {len(tilts)}, up to {max(tilts):.1f}" if len(tilts) > 1 else ""
    mean += ", without --relief" if changed else ""
    of_one = [record for record in records if record.get("counts", {}).get("photos", 1) == 1]
    if max((record.get("mean_tilt_degrees", 0.0) for record in of_one), default=0.0) >= VISIBLE_TILT_DEGREES:
        mean += "; one photo cannot tell dents from bumps, several photos of one place do: metapp data rectify PHOTOS"
    return [f"relief: {mean}"]


def fit_line(presenter: Presenter[Any], record: Document) -> str:
    """What a fit made, its error, and the seconds of the whole command."""
    app, pictures = presenter.app, len([*Path(record["folder"]).glob("*.png")])
    if record["error"] is not None:
        error = f"error{app.error_measure.factor} {record['error']:.3f} ({app.error_measure.text})"
    elif "photo_error" in record:
        error = f"photo error {record['photo_error']:.2f} % ({PHOTO_ERROR_TEXT})"
    else:
        error = presenter.caption(measured=False)
    made = [f"{pictures} picture{'s' * (pictures != 1)}"] if pictures else []
    return (
        f"{escape_control_characters(record['name'])}: {', '.join([*made, error, f'{command_seconds():.1f} s in all'])}"
    )


def _of_exports(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """The paths of files in other forms, those of a form together if they are many."""
    by_form: dict[str, list[Path]] = {}
    for outcome in outcomes:
        for form, file in outcome.exports:
            by_form.setdefault(form, []).append(file)
    for form, files in by_form.items():
        if len(files) > MAX_LISTED_PATHS:
            yield f"{form}: {len(files)} of them, the first {files[0]}"
        else:
            yield from (f"{form}: {file}" for file in files)


def _of_guard(paradigm: str, records: Sequence[Document]) -> list[str]:
    """A line about the guard of a learned rule, if it acted."""
    count = count_guarded(records)
    if not count:
        return []
    from metapp.evaluation.rows import fit_remarks  # here: it imports more than a table of fits needs

    return fit_remarks([{"paradigm": paradigm, "tasks": len(records), "guarded": count}])


def fits_table(
    presenter: Presenter[Any],
    paradigm: str,
    records: Sequence[Document],
    *,
    rate: float | None = None,
    most: int | None = None,
) -> Table:
    """One line a task, and their mean; of more than `most` those of the largest errors.

    If there is no error, as of photos, it says how many pictures were made instead.

    Args:
        presenter: of the application.
        paradigm: its name.
        records: of all tasks.
        rate: tasks that were fitted in a second, if that is to be said.
        most: lines, None for all.
    """
    from rich.table import Table  # here: a fit alone has none, and it takes 10 ms

    remarks = _of_guard(paradigm, records)
    listed = records
    if most is not None and len(records) > most:
        listed = sorted(records, key=lambda record: -(record["error"] or 0.0))[:most]
        remarks.insert(0, f"{most} of {len(records)} tasks, those of the largest errors")
    if rate is not None:
        remarks.insert(0, f"{rate:.4g} tasks/s, reading and pictures included")
    total = summary(records)
    measured = total["error"] is not None
    if "photo_error" in total:
        remarks.insert(0, f"photo error: {PHOTO_ERROR_TEXT}")
    caption = "\n".join([presenter.caption(measured=measured), *remarks])
    table = Table(
        title=f"{presenter.title}: {paradigm}", show_footer=True, caption=caption, min_width=MIN_TABLE_CHARACTERS
    )
    means = measured or "photo_error" in total
    table.add_column("task", "mean error; other columns: median" if means else "median")
    if measured:
        table.add_column(
            f"error{presenter.app.error_measure.factor}", format_number(total["error"], ".3f"), justify="right"
        )
    if "photo_error" in total:
        table.add_column("photo error %", format_number(total["photo_error"], ".2f"), justify="right")
    table.add_column("seconds", format_number(total["seconds"], ".4f"), justify="right")
    pictures = {} if measured else {each["name"]: len([*Path(each["folder"]).glob("*.png")]) for each in listed}
    if any(pictures.values()):
        table.add_column("pictures", justify="right")
    for record in listed:
        cells = [format_number(record["error"], ".3f")] if measured else []
        cells += [format_number(record.get("photo_error"), ".2f")] if "photo_error" in total else []
        cells.append(format_number(record.get("seconds"), ".4f"))
        cells += [f"{pictures[record['name']]}"] if any(pictures.values()) else []
        table.add_row(Text(escape_control_characters(record["name"])), *cells)
    return table
