"""Execute a plan and show what came of it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from data_tools.formats import exports_of
from metapp import door
from metapp.cli.console import Exit, out, print_json
from metapp.cli.streams import escaped, one_line
from metapp.runs.reporter import number, say
from metapp.storage import Document

if TYPE_CHECKING:
    from rich.table import Table

    from metapp.learning.app import App
    from metapp.runs.fits.execution import Run
    from metapp.runs.requests.plan import Plan

NARROWEST = 50  # columns of a table, so that titles stay on a line
LISTED = 20  # tasks in the table of a run that lists what failed


def fit(plan: Plan, *, json: bool) -> None:
    """Fit what a plan asks for; the exit code is 1 if something was not fitted.

    Args:
        plan: what to do.
        json: print an object in place of tables.
    """
    from metapp.runs.fits.execution import execute

    run = execute(plan)
    if run is None:
        return
    _show(run, json=json)
    counted = [failure for failure in run.failures if failure.counted]
    unwritten = sum(failure.kept for failure in counted)
    if failed := len(counted) - unwritten:
        say(f"error: {failed} of {failed + len(run.records)} inputs were not fitted.")
    if unwritten:
        say(f"error: {unwritten} export{'s were' if unwritten > 1 else ' was'} not written; all fits are kept.")
    if counted:
        raise typer.Exit(Exit.FAILED)


def _show(run: Run, *, json: bool) -> None:
    """Print the table of a run, or its object, and say where everything is and what failed."""
    from metapp.runs.outputs.files import listed

    plan, paradigm = run.plan, run.plan.paradigm.name
    if not plan.request.quiet:
        if not json:
            resumes = plan.request.resumes
            most, rate = (LISTED, run.tasks_per_second) if resumes else (None, None)
            out().print(table_of(plan.app, paradigm, run.records, run.made, rate=rate, most=most))
        folder, names = run.folder.path, [record["name"] for record in run.records]
        made = f"\nmade: {listed(run.made, names)}" if run.made else ""
        say(f"picture: {run.picture}\nrecords: {run.folder.file}\nfit: {listed(folder / 'params', names)}{made}")
        if any(offer.name == "view" for offer in door.offers(door.Command)):
            say(f"to look at: metapp view {shlex.quote(str(folder))}")
        if others := [kind for kind in exports_of(plan.app.name) if kind not in plan.request.exports]:
            say(f"other forms ({', '.join(others)}): metapp export {shlex.quote(str(folder))} {others[0]}")
        for line in run.remarks:
            say(line)
    for failure in run.failures:
        what = "failed" if failure.counted else "warning: skipped"
        say(f"{what}: {one_line(failure.reason)}")
    if json:
        print_json(run.document())


def table_of(
    app: App,
    paradigm: str,
    records: Sequence[Document],
    made: Path | None = None,
    *,
    rate: float | None = None,
    most: int | None = None,
) -> Table:
    """One line a task, and their mean; of more than `most` those of the largest errors.

    Where there is no error, as of photos, it says how many files were made instead.

    Args:
        app: the application.
        paradigm: its name.
        records: of all tasks.
        made: the folder of what fits made for their user, if any.
        rate: tasks that were fitted in a second, if that is to be said.
        most: lines, None for all.
    """
    from rich.table import Table
    from rich.text import Text

    from metapp.evaluation.notes import warned
    from metapp.runs.requests.naming import caption_of, factor_of, title_of
    from metapp.storage.records import file_name, guarded, summary

    remarks = warned([{"paradigm": paradigm, "tasks": len(records), "guarded": guarded(records)}])
    listed = records
    if most is not None and len(records) > most:
        listed = sorted(records, key=lambda record: -(record["error"] or 0.0))[:most]
        remarks.insert(0, f"{most} of {len(records)} tasks, those of the largest errors")
    if rate is not None:
        remarks.insert(0, f"{rate:.4g} tasks/s, reading and pictures included")
    total = summary(records)
    measured = total["error"] is not None
    caption = "\n".join([caption_of(app, measured), *remarks])
    table = Table(title=f"{title_of(app)}: {paradigm}", show_footer=True, caption=caption, min_width=NARROWEST)
    table.add_column("task", "mean error; other columns: median" if measured else "median")
    if measured:
        table.add_column(f"error{factor_of(app)}", number(total["error"], ".3f"), justify="right")
    table.add_column("seconds", number(total["seconds"], ".4f"), justify="right")
    if not measured and made:
        table.add_column("files", justify="right")
    for record in listed:
        cells = [number(record["error"], ".3f")] if measured else []
        cells.append(number(record.get("seconds"), ".4f"))
        cells += [f"{sum(1 for _ in (made / file_name(record['name'])).glob('*'))}"] if made and not measured else []
        table.add_row(Text(escaped(record["name"])), *cells)
    return table
