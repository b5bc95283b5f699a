"""The work of `metapp evaluate`: tables and pictures made of records, and printed; fits without a record are run."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import typer
from rich.table import Table as RichTable
from rich.text import Text

from metapp.apps import full_name
from metapp.cli.console import escape_control_characters, print_json, standard_output
from metapp.cli.evaluation_options import ALL_TABLES, EvaluateOptions
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Table, flatten_row, format_csv, format_tables
from metapp.names import app_names, protocols_of, recipe_entries
from metapp.registry import registry
from metapp.runs.fit_options import check_app_name, check_protocol, fit_options
from metapp.runs.reporter import say
from metapp.runs.run import Run

MAX_NOTE_LINES = 10  # below all tables of a terminal
MIN_COLUMNS = 3  # are shown however narrow the terminal
FIT_OPTION_NAMES = ("rule", "data", "checkpoint", "out", "seed", "device", "quiet")  # options of fits


def evaluate(options: EvaluateOptions, apps: list[str], which: str, form: str) -> None:
    """Print tables of applications, and write the pictures, figures and the report that are asked for.

    Args:
        options: of the command.
        apps: names of applications; [] for all.
        which: name of the table, or ALL.
        form: one of FORMATS.

    Raises:
        BadParameter, BadOption: an application, a protocol or a checkpoint that there is not.
        ValueError: a checkpoint of a named application is missing; records that cannot be read.
    """
    if not (options.quiet or options.no_run):
        say("evaluate: looking for records")
    names = [*registry().tables]
    shown = names if which == ALL_TABLES else [which]
    made: dict[str, list[Table]] = {name: [] for name in (names if options.report and not options.which else shown)}
    subjects, notes = evaluation_runs_of(options, apps), list[str]()
    for name, tables in made.items():
        for subject in subjects:
            tables.append(subject.table(name))
            if form == "rich" and name in shown and tables[-1].rows:
                print_table(tables[-1], notes)
    print_notes(notes)
    if form != "rich":
        print_in_format({name: made[name] for name in shown}, form, which)
    for name in () if options.quiet else shown:
        for subject in subjects:
            if picture := subject.draw(name, subject.table(name).fits):
                say(f"picture: {picture}")
    if options.no_run:
        say_missing_records(subjects)
    for subject in subjects:
        subject.measuring = False  # figures show what has been measured
    if options.figures or options.report:
        from metapp.evaluation.figures import write_figures, write_report  # here: matplotlib takes 0.3 s

        for file in write_figures(subjects, options.figures) if options.figures else ():
            say(f"figures: {file}")
        if options.report:
            say(f"report: {write_report(subjects, options.report, made)}")


def print_in_format(tables: Mapping[str, Sequence[Table]], form: str, which: str) -> None:
    """Print tables of several applications, by name, in a format other than rich; `which` was asked for."""
    if form in ("json", "csv"):
        pairs = [(name, row) for name, some in tables.items() for table in some for row in table.rows]
        rows = [flatten_row(row) | ({"table": name} if len(tables) > 1 else {}) for name, row in pairs]
        if form == "json":
            print_json({"which": which, "rows": rows})
        else:
            standard_output().print(format_csv(rows), soft_wrap=True)
        return
    for some in filter(None, tables.values()):
        standard_output().print(format_tables(some, form), soft_wrap=True)


def print_table(table: Table, notes: list[str]) -> None:
    """Print the table of one application below its title and findings.

    Args:
        table: with rows.
        notes: of the tables before, to which new ones are appended; the title has the numbers of its own.
    """
    notes += [note for note in table.notes if note not in notes]
    numbers = ", ".join(str(1 + notes.index(note)) for note in table.notes)
    standard_output().print(f"{table.whole_title} [{numbers}]", *table.findings, sep="\n")
    standard_output().print(rich_table(table))


def print_notes(notes: Sequence[str]) -> None:
    """Print numbered notes on tables, in at most NOTE_LINES lines."""
    wrapped = [textwrap.wrap(f"[{i}] {note}", standard_output().width) for i, note in enumerate(notes, 1)]
    while (lines := [line for some in wrapped for line in some]) and len(lines) > MAX_NOTE_LINES - (
        len(wrapped) < len(notes)
    ):
        del wrapped[-1]
    if rest := len(notes) - len(wrapped):
        lines.append(f"{rest} further notes: --format markdown")
    if lines:
        standard_output().print("\n".join(lines))


def rich_table(table: Table, width: int | None = None) -> RichTable:
    """Lay out the table of one application for a terminal: as many columns, from the left, as it has room for.

    Args:
        table: with rows.
        width: of the terminal, in characters; None for that of standard output.
    """
    grid = RichTable()
    room, columns = (width or standard_output().width) - 1, list[list[str]]()
    for column in table.columns:
        lines = [part for part in column.title.rpartition(" ")[::2] if part]  # two: most columns are of short numbers
        cells = [escape_control_characters(column.text(row)) for row in table.rows]
        room -= max(map(len, [*lines, *cells])) + 3
        if room < 0 and len(columns) >= MIN_COLUMNS:
            break
        right = bool(column.form)
        grid.add_column("\n".join(lines), justify="right" if right else "left", no_wrap=right)
        columns.append(cells)
    for row in zip(*columns, strict=True):
        grid.add_row(*map(Text, row))
    return grid


def evaluation_runs_of(options: EvaluateOptions, apps: list[str]) -> list[EvaluationRun]:
    """Each application under each protocol; one that was not named is left out if a checkpoint of it is missing."""
    names = apps or app_names()
    if options.checkpoint and not (len(names) == 1 and options.checkpoint.is_dir()):
        found = f"{len(names)} applications" if options.checkpoint.is_dir() else "no folder"
        raise typer.BadParameter(
            f"--checkpoint {options.checkpoint}: {found}, expected one APP and the folder of its trained checkpoints, "
            "such as runs/brdf/checkpoints/..."
        )
    for name in names:
        check_app_name(name)
    for name in [name for name in names if protocols_of(name)] or names:
        check_protocol(options.observe, name)
    given, runs = {name: getattr(options, name) for name in FIT_OPTION_NAMES}, []
    for name in names:
        recipe = options.recipe if apps or options.recipe in recipe_entries(name) else "quick"
        protocols = protocols_of(name)[: None if options.whole else 1] or ("",)
        for protocol in [options.observe] if options.observe and any(protocols) else protocols:
            runs.append(Run.from_options(fit_options(name, "general", observe=protocol, recipe=recipe, **given)))
    subjects = []
    for run in runs:  # all checkpoints before the first fit
        try:
            subjects.append(EvaluationRun(run, measuring=not options.no_run, whole=options.whole))
        except ValueError as error:
            if apps:
                raise
            say(f"{run.presenter.title} is left out: {error}")
    return subjects


def say_missing_records(subjects: list[EvaluationRun]) -> None:
    """Say how much has no record yet of each application."""
    remedy = ""
    for subject in subjects:
        asked = subject.asked.items()
        if empty := [title for title, (tasks, records) in asked if not tasks or len(records) < len(tasks)]:
            total, there = (sum(len(pair[i]) for pair in subject.asked.values()) for i in (0, 1))
            missing = f"{total - there:,} of {total:,}" if total else "all"
            say(f"{full_name(subject.app)}: {missing} records missing: {', '.join(empty)}")
            remedy = "the same command without --no-run measures them"
    if remedy:
        say(remedy)
