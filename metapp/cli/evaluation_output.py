"""The work of `metapp evaluate`: tables and pictures made of records, and printed.

Fits without a record are run by :class:`metapp.evaluation.evaluation_run.EvaluationRun`; here is what a terminal shows.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import typer
from rich.table import Table as RichTable
from rich.text import Text

from metapp.cli.command_process import state_what_interruption_keeps
from metapp.cli.console import escape_control_characters, print_json, standard_output
from metapp.cli.evaluation_options import ALL_TABLES, EvaluateOptions
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.table import Table, filled_columns, flatten_row, format_csv, format_tables
from metapp.options import BadOption, options_by_name
from metapp.registry import registry
from metapp.runs.reporter import say
from metapp.runs.spec import RunOptions, Spec, application_named, check_observation, parse_fit_options

MIN_COLUMNS = 3  # columns that are shown however narrow the terminal is
# options of fits that `metapp evaluate` has, too; observation and recipe are chosen for each application
SHARED_OPTIONS = (
    (options_by_name(Spec).keys() | options_by_name(RunOptions).keys()) & options_by_name(EvaluateOptions).keys()
) - {"observe", "recipe"}


def evaluate(options: EvaluateOptions, apps: list[str], which: str, form: str) -> None:
    """Print tables of applications, and write the pictures, figures and the report that are asked for.

    Args:
        options: the options of the command.
        apps: names of applications; [] for all.
        which: the name of the table, or ALL_TABLES.
        form: one of TABLE_FORMATS.

    Raises:
        BadParameter, BadOption: an unknown application, observation or checkpoint was named.
        ValueError: a checkpoint of a named application is missing, or records cannot be read.
    """
    state_what_interruption_keeps("the same command goes on: fits that are done are kept")
    if not (options.quiet or options.no_run):
        say("evaluate: looking for records")
    names = [*registry().tables]
    shown_names = names if which == ALL_TABLES else [which]
    tables_by_name: dict[str, list[Table]] = {
        name: [] for name in (names if options.report and not options.which else shown_names)
    }
    evaluations, notes = evaluation_runs_of(options, apps), list[str]()
    for name, tables in tables_by_name.items():
        for evaluation in evaluations:
            tables.append(evaluation.table(name))
            if form == "rich" and name in shown_names and tables[-1].rows:
                print_table(tables[-1], notes)
    print_notes(notes)
    if form != "rich":
        print_in_format({name: tables_by_name[name] for name in shown_names}, form, which)
    for name in () if options.quiet else shown_names:
        for evaluation in evaluations:
            if picture := evaluation.draw_fits(name, evaluation.table(name).fits):
                say(f"picture: {picture}")
    if options.no_run:
        say_missing_records(evaluations)
    for evaluation in evaluations:
        evaluation.is_measuring = False  # figures show what has been measured
    if options.figures or options.report:
        from metapp.evaluation.figures import write_figures, write_report  # imported here, since matplotlib takes 0.3 s

        for file in write_figures(evaluations, options.figures) if options.figures else ():
            say(f"figures: {file}")
        if options.report:
            say(f"report: {write_report(evaluations, options.report, tables_by_name)}")


def print_in_format(tables: Mapping[str, Sequence[Table]], form: str, which: str) -> None:
    """Print tables of several applications in a format other than rich.

    Args:
        tables: the tables of all applications, by the table's name.
        form: "markdown", "latex", "csv" or "json".
        which: the name of the table that was asked for, which JSON states.
    """
    if form in ("json", "csv"):
        pairs = [(name, row) for name, app_tables in tables.items() for table in app_tables for row in table.rows]
        rows = [flatten_row(row) | ({"table": name} if len(tables) > 1 else {}) for name, row in pairs]
        if form == "json":
            print_json({"which": which, "rows": rows})
        else:
            standard_output().print(format_csv(rows), soft_wrap=True)
        return
    for app_tables in filter(None, tables.values()):
        standard_output().print(format_tables(app_tables, form), soft_wrap=True)


def print_table(table: Table, notes: list[str]) -> None:
    """Print the table of one application below its title and findings.

    Args:
        table: a table with rows.
        notes: the notes of earlier tables, to which new ones are appended; the title has the numbers of this table's.
    """
    notes += [note for note in table.notes if note not in notes]
    numbers = ", ".join(str(1 + notes.index(note)) for note in table.notes)
    standard_output().print(f"{table.full_title} [{numbers}]", *table.findings, sep="\n")
    standard_output().print(make_rich_table(table))


def print_notes(notes: Sequence[str]) -> None:
    """Print the numbered notes on tables, below all of them: each is cited by the title of a table above."""
    lines = [
        line for i, note in enumerate(notes, 1) for line in textwrap.wrap(f"[{i}] {note}", standard_output().width)
    ]
    if lines:
        standard_output().print("\n".join(lines))


def make_rich_table(table: Table, width: int | None = None) -> RichTable:
    """Lay out the table of one application for a terminal: the columns, from the left, that have room on it.

    Args:
        table: a table with rows.
        width: the width of the terminal, in characters; None takes the width of standard output.
    """
    rich_table = RichTable()
    free_width, columns = (width or standard_output().width) - 1, list[list[str]]()
    for column in filled_columns([table]):
        lines = [
            part for part in column.title.rpartition(" ")[::2] if part
        ]  # a title takes two lines, as most columns hold short numbers
        cells = [escape_control_characters(column.text(row)) for row in table.rows]
        free_width -= max(map(len, [*lines, *cells])) + 3
        if free_width < 0 and len(columns) >= MIN_COLUMNS:
            break
        is_number = bool(column.form)
        rich_table.add_column("\n".join(lines), justify="right" if is_number else "left", no_wrap=is_number)
        columns.append(cells)
    for row in zip(*columns, strict=True):
        rich_table.add_row(*map(Text, row))
    return rich_table


def evaluation_runs_of(options: EvaluateOptions, apps: list[str]) -> list[EvaluationRun]:
    """Return an evaluation of each application, for each of the things that fits may see.

    An application that was not named is left out if a checkpoint of it is missing.

    Args:
        options: the options of the command.
        apps: names of applications; [] for all.

    Raises:
        BadParameter, BadOption: an unknown application, observation or checkpoint was named.
        ValueError: a checkpoint of a named application is missing.
    """
    names = apps or sorted(registry().applications)
    if options.checkpoint and not (len(names) == 1 and options.checkpoint.is_file()):
        found = f"{len(names)} applications" if options.checkpoint.is_file() else "no file"
        raise typer.BadParameter(
            f"--checkpoint {options.checkpoint}: {found}, expected one APP and the file of its trained checkpoints, "
            "such as runs/brdf/checkpoints/....safetensors"
        )
    applications = [application_named(name) for name in names]
    for application in [application for application in applications if application.observations] or applications:
        check_observation(options.observe, application)
    evaluations = []
    for application in applications:
        recipe = options.recipe if apps or options.recipe in application.recipes_observing() else "quick"
        observations = application.observations[: None if options.whole else 1] or ("",)
        for observation in [options.observe] if options.observe and any(observations) else observations:
            values = {
                "observe": observation,
                "recipe": recipe,
                **{name: getattr(options, name) for name in SHARED_OPTIONS},
            }
            spec, run_options = parse_fit_options(application.name, "general", **values)
            try:  # all checkpoints are read before the first fit
                evaluations.append(
                    EvaluationRun(spec, run_options, is_measuring=not options.no_run, whole=options.whole)
                )
            except BadOption:
                raise
            except ValueError as error:
                if apps:
                    raise
                say(f"{application.title} is left out: {error}")
    return evaluations


def say_missing_records(evaluations: list[EvaluationRun]) -> None:
    """Print how many records of each application are missing, and how to measure them."""
    remedy = ""
    for evaluation in evaluations:
        requested = evaluation.requested.items()
        if incomplete := [title for title, (tasks, records) in requested if not tasks or len(records) < len(tasks)]:
            total, existing = (sum(len(pair[i]) for pair in evaluation.requested.values()) for i in (0, 1))
            missing = f"{total - existing:,} of {total:,}" if total else "all"
            say(f"{evaluation.app.full_name}: {missing} records missing: {', '.join(incomplete)}")
            remedy = "the same command without --no-run measures them"
    if remedy:
        say(remedy)
