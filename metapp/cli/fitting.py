"""Fit inputs and show what came of it: one by one, many, or as lines of standard input name them."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from metapp.cli.console import Exit, lines_of_input, one_line, out, print_json, say, what_failed
from metapp.runs.reporter import number

if TYPE_CHECKING:
    from metapp.learning.app import App
    from metapp.runs.run import Run
    from metapp.runs.session import Options


def fit(options: Options, name: str, inputs: list[Path], told: dict[str, Any], *, render: int, json: bool) -> None:
    """Fit inputs one by one and show what came of it; of scenes also pictures of so many px."""
    from metapp.runs.pictures import write_renders
    from metapp.runs.run import run

    done = run(options, name, inputs, **told)
    lines = write_renders(done.options.app, done.tasks, done.folder.path / "outputs", render) if render else []
    if not options.quiet:
        show(done, table=not json)
        for line in lines:
            say(line)
    if json:
        print_json(done.document())


def fit_lines(options: Options, name: str, told: dict[str, Any]) -> None:
    """Fit each input that a line of standard input names, and answer it by a line; the exit code is 1 if one failed."""
    from metapp.runs.run import run_each

    failed = count = 0
    for path, done in run_each(options, name, map(Path, lines_of_input()), **told):
        count += 1
        if isinstance(done, Exception):
            failed += 1
            print_json({"input": str(path), "failure": one_line(what_failed(done))})
        else:
            print_json({"input": str(path)} | done.document())
    if failed:
        say(f"error: {failed} of {count} inputs were not fitted.")
        raise typer.Exit(Exit.FAILED)


def fit_many(
    options: Options, name: str, inputs: list[Path], batch: str, shard: str, told: dict[str, Any], *, json: bool
) -> None:
    """Fit many inputs, show what came of it and list what failed; then the exit code is 1."""
    from metapp.runs import many
    from metapp.runs.batch_size import check_batch
    from metapp.runs.sources import shard_of

    done = many.fit_many(options, name, inputs, many.Asked(check_batch(batch or "1"), shard_of(shard)), **told)
    if not options.quiet:
        records = done.run.records
        if not json:
            out.print(table_of(done.run.options.app, name, records, rate=done.tasks_per_second, most=LISTED))
        made = f"\nmade: {done.run.made}" if done.run.made else ""
        say(f"gallery: {done.gallery}\nrecords: {done.run.folder.file}{made}")
    for failure in done.failures:
        say(f"failed: {one_line(failure.reason)}")
    if json:
        print_json(done.document())
    if done.failures:
        say(f"error: {len(done.failures)} of {len(done.failures) + len(done.run.records)} inputs were not fitted.")
        raise typer.Exit(Exit.FAILED)


LISTED = 20  # tasks in the table of many


def show(done: Run, *, table: bool) -> None:
    """Draw the picture of a run; print its table and say where everything is."""
    from metapp.runs.pictures import picture_of_run

    app, paradigm = done.options.app, done.settings["paradigm"]
    picture = picture_of_run(app, paradigm, done.tasks, done.records, done.folder.path)
    if table:
        out.print(table_of(app, paradigm, done.records))
    say(f"picture: {picture}\nrecords: {done.folder.file}" + (f"\nmade: {done.made}" if done.made else ""))


def table_of(
    app: App, paradigm: str, records: list[dict[str, Any]], *, rate: float | None = None, most: int | None = None
) -> Any:
    """One line a task, and their mean; of more than `most` those of the largest errors.

    Args:
        app: the application.
        paradigm: its name.
        records: of all tasks.
        rate: tasks that were fitted in a second, if that is to be said.
        most: lines, None for all.
    """
    from rich.table import Table
    from rich.text import Text

    from metapp.evaluation.notes import warned
    from metapp.runs.session import caption_of, title_of
    from metapp.storage.records import guarded, summary

    factor = f" x{app.traits.scale:g}" if app.traits.scale != 1 else ""
    remarks = warned([{"paradigm": paradigm, "tasks": len(records), "guarded": guarded(records)}])
    shown_records = records
    if most is not None and len(records) > most:
        shown_records = sorted(records, key=lambda record: -(record["error"] or 0.0))[:most]
        remarks.insert(0, f"{most} of {len(records)} tasks, those of the largest errors")
    if rate is not None:
        remarks.insert(0, f"{rate:.4g} tasks/s, reading and pictures included")
    table = Table(
        title=f"{title_of(app)}: {paradigm}", show_footer=True, caption="\n".join([caption_of(app), *remarks])
    )
    total = summary(records)
    table.add_column("task", "mean error, median of the rest")
    table.add_column(f"error{factor}", number(total["error"], ".3f"), justify="right")
    table.add_column("seconds", number(total["seconds"], ".4f"), justify="right")
    steps = [record["steps"] for record in records if "steps" in record]
    if steps:
        table.add_column("steps", f"{statistics.median(steps):g}", justify="right")
    for record in shown_records:
        shown = [f"{record['steps']}"] if steps else []
        table.add_row(Text(record["name"]), number(record["error"], ".3f"), f"{record['seconds']:.4f}", *shown)
    return table
