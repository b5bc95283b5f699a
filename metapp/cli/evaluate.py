"""`metapp evaluate`: the paper's tables and figures, from records; what has no record yet is run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli import completion
from metapp.cli.options import Json, Overwrite, check_new, takes
from metapp.evaluation.tables import ALL, load_table, table_names
from metapp.registry import WITHOUT, did_you_mean, left_out_with
from metapp.runs.options import check_name, check_protocol, fit_options
from metapp.runs.reporter import say

if TYPE_CHECKING:
    from metapp.evaluation.rows import Table
    from metapp.evaluation.subject import Subject

NAMES = table_names()
WHICH = (*NAMES, ALL)
FORMATS = ("rich", "markdown", "latex", "csv")
Figures = Annotated[Path | None, typer.Option(metavar="DIR", help="Draw the figures there, as PNG and PDF.")]
Report = Annotated[Path | None, typer.Option(metavar="DIR", help="Write tables there, as Markdown, and the figures.")]


@dataclass(frozen=True)
class Evaluation:
    """The options of `metapp evaluate`."""

    apps: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[APP]...", autocompletion=completion.applications, help="Applications; default: all there are."
        ),
    ] = None
    which: Annotated[
        str,
        typer.Option(
            autocompletion=completion.tables,
            metavar="NAME",
            help=f"Which table: {', '.join(WHICH)}; default: results, in a report all.",
        ),
    ] = ""
    form: Annotated[str, typer.Option("--format", help=f"One of {', '.join(FORMATS)}.")] = "rich"
    no_run: Annotated[
        bool, typer.Option("--no-run", help="Print what there is, and the commands that make the rest.")
    ] = False
    table: Annotated[bool, typer.Option("--table", help="Print the tables, as is done without it.")] = True
    whole: Annotated[
        bool, typer.Option("--whole", help="Overfit and Finetune on all test tasks, not on three; both protocols.")
    ] = False
    rule: Annotated[
        str,
        typer.Option(
            autocompletion=completion.rules,
            help="Meta's learned rule; default: the recipe's.",
        ),
    ] = ""
    observe: Annotated[
        str,
        typer.Option(
            autocompletion=completion.observations,
            help="What fits may see, where an application has both: reference or photo; default: reference, with "
            "--whole each.",
        ),
    ] = ""
    data: Annotated[Path | None, typer.Option(help="Folder of task shards; default: the embedded set.")] = None
    checkpoint: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of trained checkpoints of one APP; default: those that ship."),
    ] = None
    out: Annotated[Path, typer.Option(help="Where runs are kept.")] = Path("runs")
    recipe: Annotated[
        str,
        typer.Option(
            autocompletion=completion.recipes,
            help="quick, full, paper, or another of APP; quick for those that lack it.",
        ),
    ] = "quick"
    seed: Annotated[int, typer.Option(help="Seed of all random draws.", min=0, max=2**63 - 1)] = 0
    device: Annotated[str, typer.Option(autocompletion=completion.devices, help="auto, cpu or cuda.")] = "auto"
    json: Json = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False


@takes(Evaluation)
def command(options: Evaluation, overwrite: Overwrite = False, figures: Figures = None, report: Report = None) -> None:
    """Print the paper's tables of your data beside the paper's figures; run what has no record yet.

    Example: metapp evaluate brdf --which quickft
    """
    if not (options.quiet or options.no_run):
        say("evaluate: looking for records")
    from metapp.cli.show import show
    from metapp.evaluation.cell import run_cells

    reported = NAMES if options.which in ("", ALL) else [options.which]
    for folder in filter(None, (figures, report)):
        for file in (*folder.glob("*-*.p[nd][gf]"), *folder.glob("index.md")):
            check_new(file, overwrite)
    options = check(options)
    subjects = subjects_of(options)
    names = NAMES if options.which == ALL else [options.which]
    measured = [load_table(name) for name in (reported if report else names)]
    if options.no_run:
        say_missing(subjects, measured, options.which)
    else:
        run_cells([cell for table in measured for one in subjects for cell in table.cells(one)], quiet=options.quiet)
    if not options.quiet:
        draw(subjects, names)
    show([load_table(name) for name in names], subjects, "json" if options.json else options.form)
    if figures:
        from metapp.evaluation.figures import write_figures

        for file in write_figures(subjects, figures):
            say(f"figures: {file}")
    if report:
        from metapp.evaluation.report import write_report

        say(f"report: {write_report(subjects, report, measured)}")


def check(options: Evaluation) -> Evaluation:
    """The options, with the default table.

    Raises:
        BadParameter: there is no such table or format.
    """
    options = replace(options, which=options.which or "results")
    if extension := left_out_with("tables", options.which):
        raise typer.BadParameter(
            f"--which {options.which}: a table of the extension {extension}, which {WITHOUT} leaves out; unset it."
        )
    for option, value, names in (("--which", options.which, WHICH), ("--format", options.form, FORMATS)):
        if value not in names:
            expected = f"expected one of {', '.join(names)}.{did_you_mean(value, names)}"
            raise typer.BadParameter(f"{option} '{value}': {expected}")
    return options


def subjects_of(options: Evaluation) -> list[Subject]:
    """Each application under each protocol."""
    from metapp.apps import recipes_of
    from metapp.evaluation.subject import Subject
    from metapp.registry import app_names, protocols_of
    from metapp.runs.run import Run

    run = not options.no_run
    names = options.apps or app_names()
    if options.checkpoint and not (len(names) == 1 and options.checkpoint.is_dir()):
        found = f"{len(names)} applications" if options.checkpoint.is_dir() else "no folder"
        raise typer.BadParameter(
            f"--checkpoint {options.checkpoint}: {found}, expected one APP and the folder of its trained checkpoints, "
            "such as runs/brdf/checkpoints/..."
        )
    for name in names:
        check_name(name)
    for name in [name for name in names if protocols_of(name)] or names:
        check_protocol(options.observe, name)
    first = None if options.whole else 1
    plans = [
        Run.of(
            fit_options(
                name,
                "general",  # by the application's own network; rows make the plans of other paradigms of it
                observe=protocol,
                rule=options.rule,
                recipe=options.recipe if options.apps or options.recipe in recipes_of(name) else "quick",
                data=options.data,
                checkpoint=options.checkpoint,
                out=options.out,
                seed=options.seed,
                device=options.device,
                quiet=options.quiet,
            )
        )
        for name in names
        for protocol in (protocols_of(name) and (options.observe,) * bool(options.observe))
        or protocols_of(name)[:first]
        or ("",)
    ]
    strict = bool(options.apps) and run
    subjects = [Subject(one, run=run, strict=strict, whole=options.whole) for one in plans]
    # all checkpoints before the first fit: a missing one should not be found after an hour
    return [subject for subject in subjects if not run or has_general(subject, options)]


def has_general(subject: Subject, options: Evaluation) -> bool:
    """False where General has no checkpoint, so that nothing can be compared: the application is left out.

    Raises:
        ValueError: the same, of an application that was named.
    """
    from metapp.runs.checkpoints import with_checkpoint

    try:
        return bool(with_checkpoint(subject.plan))
    except ValueError as error:
        if options.apps:
            raise
        say(f"{subject.title} is left out: {error}")
        return False


def say_missing(subjects: list[Subject], tables: Sequence[Table], which: str) -> None:
    """Say how much has no record yet of each application, and which command measures it."""
    from metapp.runs.naming import name_of

    commands = []
    for subject in subjects:
        name = name_of(subject.app)
        found = [cell for table in tables for cell in table.cells(subject)]
        cells = {cell.title.removeprefix(f"{name} "): cell for cell in found}
        empty = list(dict.fromkeys(title.partition(": ")[0] for title, cell in cells.items() if not cell.whole))
        total, missing = sum(len(c.tasks) for c in cells.values()), sum(len(c.missing()) for c in cells.values())
        if empty:
            say(f"{name}: {f'{missing:,} of {total:,}' if total else 'all'} records missing: {', '.join(empty)}")
            commands.append(subject.command(which))
    if commands:
        say(f"made by{' the same command without --no-run, or of one alone' * (len(commands) > 1)}: {commands[0]}")


def draw(subjects: list[Subject], names: Sequence[str]) -> None:
    """Draw fits side by side, as tables of these names compare them."""
    for name in names:
        for file in filter(None, map(load_table(name).picture, subjects)):
            say(f"picture: {file}")
