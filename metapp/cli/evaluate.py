"""`metapp evaluate`: the paper's tables and figures, from records; what has no record yet is run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metapp.cli.console import out, print_json, say
from metapp.cli.options import Json
from metapp.evaluation.tables import NAMES, STUDIES, load_table
from metapp.runs.reporter import progress

if TYPE_CHECKING:
    from metapp.evaluation.study import Budget
    from metapp.evaluation.tables.subject import Cell, Subject
    from metapp.evaluation.tables.table import Table
    from metapp.runs.session import Options

FORMATS = ("rich", "markdown", "latex", "csv", "json")
ALL = "all"


def command(
    apps: Annotated[
        list[str] | None, typer.Argument(metavar="[APP]...", help="Applications; default: all there are.")
    ] = None,
    table: Annotated[
        bool,
        typer.Option("--table/--no-table", help="Print the tables, or only write figures and report."),
    ] = True,
    which: Annotated[str, typer.Option(help=f"Which table: {', '.join((*NAMES, ALL, *STUDIES))}.")] = "results",
    format_name: Annotated[str, typer.Option("--format", help=f"One of {', '.join(FORMATS)}.")] = "rich",
    no_run: Annotated[
        bool, typer.Option("--no-run", help="Print what there is; name the commands for the rest.")
    ] = False,
    figures: Annotated[Path | None, typer.Option(help="Draw the figures there, as PNG and PDF.")] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write one HTML page there: all tables, figures, pictures, records.")
    ] = None,
    overfit_share: Annotated[
        float, typer.Option(help="Share of the recipe's steps that Overfit takes; tables say so.", min=1e-4, max=1.0)
    ] = 1.0,
    steps: Annotated[
        list[int] | None, typer.Option(help="rules: numbers of gradient steps, 5 10 20 40 unless given.", min=1)
    ] = None,
    train_steps: Annotated[
        int | None, typer.Option(help="rules: outer steps of each training, 500 unless given.", min=1)
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="rules: seeds of training from --seed on, 3.", min=1)] = None,
    start: Annotated[
        str, typer.Option(help="rules: random, mean (of General's predictions) or encoder (General's own); encoder.")
    ] = "",
    rule: Annotated[
        str, typer.Option(help="Meta's learned rule, default: the recipe's; rules: this one alone, default: all.")
    ] = "",
    observe: Annotated[
        str,
        typer.Option(help="What fits may see, where an application has both: reference or photo; default: each."),
    ] = "",
    data: Annotated[Path | None, typer.Option(help="Folder of task shards; default: the embedded set.")] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="Where runs are kept.")] = Path("runs"),
    recipe: Annotated[
        str,
        typer.Option(
            help="quick, full or paper; brdf: also measured; texture: also paper-vgg19. Where no APP is named, "
            "quick for those that have no such recipe."
        ),
    ] = "quick",
    seed: Annotated[int, typer.Option(help="Seed of all random draws.", min=0, max=2**63 - 1)] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Print the paper's tables of your data beside the paper's figures; run what has no record yet.

    Example: metapp evaluate brdf --which quickft
    """
    if which not in (*NAMES, ALL, *STUDIES):
        raise typer.BadParameter(f"--which '{which}': expected one of {', '.join((*NAMES, ALL, *STUDIES))}.")
    if format_name not in FORMATS:
        raise typer.BadParameter(f"--format '{format_name}': expected one of {', '.join(FORMATS)}.")
    for option, given in (("--steps", steps), ("--train-steps", train_steps), ("--seeds", seeds), ("--start", start)):
        if given and which not in STUDIES:
            raise typer.BadParameter(f"{option}: only with --which {' or '.join(STUDIES)}.")
    from metapp.apps import app_names, protocols_of, recipes_of
    from metapp.evaluation.study import STARTS, Budget
    from metapp.runs.session import check_name, check_protocol, options_of

    if start and start not in STARTS:
        raise typer.BadParameter(f"--start '{start}': expected one of {', '.join(STARTS)}.")
    found = apps or app_names()
    for name in found:
        check_name(name)
    for name in [name for name in found if protocols_of(name)] or found:
        check_protocol(observe, name)
    planned: list[Options] = []
    for name in found:
        protocols = protocols_of(name)
        for protocol in (observe,) if observe and protocols else protocols or ("",):
            planned.append(
                options_of(
                    name,
                    observe=protocol,
                    rule=rule,
                    recipe=recipe if apps or recipe in recipes_of(name) else "quick",
                    data=data,
                    out=out_folder,
                    seed=seed,
                    device=device,
                    quiet=quiet,
                )
            )
    asked: dict[str, Any] = {"outer": train_steps, "steps": tuple(steps or ()), "seeds": seeds, "start": start}
    asked["rules"] = (rule,) if rule else ()
    budget = Budget(**{key: value for key, value in asked.items() if value})
    strict = bool(apps) and not no_run
    subjects = find_subjects(planned, run=not no_run, strict=strict, share=overfit_share, budget=budget)
    tables = [load_table(name) for name in (NAMES if which == ALL else (which,))]
    measured = list(tables)
    if report or (figures and which not in STUDIES):
        measured += [load_table(name) for name in NAMES if name != which]
    if any(each.name not in STUDIES for each in measured):
        # all checkpoints before the first fit: a missing one should not be found after an hour; applications that
        # nobody named have empty cells where a checkpoint is missing
        for subject in subjects:
            subject.find_checkpoints()
    cells = [cell for each in measured for subject in subjects for cell in each.cells(subject)]
    fill(cells, run=not no_run, quiet=quiet)
    if not quiet and which in ("results", ALL):
        compare(subjects, quiet=quiet)
    if not quiet and which in ("baselines", ALL):
        compare_baselines(subjects)
    if table or json:
        show(tables, subjects, "json" if json else format_name)
    if figures:
        from metapp.evaluation.figures import FIGURES, write_figures

        for file in write_figures(subjects, figures, STUDIES if which in STUDIES else tuple(FIGURES)):
            say(f"figure: {file}")
    if report:
        from metapp.evaluation.report.page import write_report

        say(f"report: {write_report(subjects, report)}")


def find_subjects(
    planned: list[Options], *, run: bool, strict: bool, share: float, budget: Budget | None = None
) -> list[Subject]:
    """What tables are about."""
    from metapp.evaluation.tables.subject import Subject

    return [Subject(options, run=run, strict=strict, share=share, budget=budget) for options in planned]


def fill(cells: list[Cell], *, run: bool, quiet: bool) -> None:
    """Measure what cells lack, or name the commands that do."""
    from metapp.evaluation.tables.running import run_cells

    if run:
        run_cells(cells, quiet=quiet)
        return
    groups: dict[str, list[Cell]] = {}
    for cell in {cell.title: cell for cell in cells}.values():
        groups.setdefault(cell.title.partition(": ")[0], []).append(cell)
    for title, each in groups.items():
        count, total = (sum(map(len, lists)) for lists in zip(*((c.missing(), c.tasks) for c in each), strict=True))
        if count or not total:
            say(f"{title}: {f'{count} of {total}' if count else 'all'} tasks missing: {each[0].command}")


def show(tables: list[Table], subjects: list[Subject], form: str) -> None:
    """Print tables in a format."""
    from metapp.cli.show import rich_table
    from metapp.evaluation.tables.formats import csv_of, text_table

    several = len(tables) > 1
    found = {table.name: [(each, rows) for each in subjects if (rows := table.rows(each))] for table in tables}
    if form in ("json", "csv"):
        rows = [row | ({"table": name} if several else {}) for name in found for _, each in found[name] for row in each]
        if form == "csv":
            out.print(csv_of(rows), markup=False, soft_wrap=True)
        else:
            print_json({"which": ALL if several else tables[0].name, "rows": rows})
        return
    for table in tables:
        if form == "rich":
            for subject, rows in found[table.name]:
                out.print(rich_table(table, subject, rows))
        else:
            out.print(text_table(table, found[table.name], form), markup=False, soft_wrap=True)


def compare(subjects: list[Subject], *, quiet: bool) -> None:
    """Draw the fits of all paradigms that are complete, side by side, one picture an application."""
    from metapp.runs.pictures import COMPARED, picture_of_table

    for subject in subjects:
        options, complete = subject.options, []
        for name, fit in subject.fits.items():
            cell = subject.cell(name)
            if cell.folder and name == fit.paradigm.name and cell.tasks and not cell.missing():
                complete.append((name, cell.folder.path, cell.records()))
        if complete:
            name = f"comparison-{subject.label}-{options.recipe}-seed{options.seed}"
            name += f"-{options.app.protocol}" if options.app.protocol else ""
            file = options.out / options.app.name / f"{name}.png"
            with progress(f"pictures of {subject.title}", len(subject.tasks[:COMPARED]), quiet=quiet) as bar:
                made = picture_of_table(options.app, subject.tasks, complete, file, bar.advance)
            say(f"picture: {made}")


def compare_baselines(subjects: list[Subject]) -> None:
    """Draw Meta's fits and those of baselines that are pictures, side by side, one picture an application."""
    from metapp.evaluation.tables.baselines import baselines_with_pictures
    from metapp.runs.pictures import picture_of_table

    for subject in subjects:
        meta, drawn = subject.cell("meta"), baselines_with_pictures(subject)
        if meta.folder and drawn and subject.tasks and not meta.missing():
            runs = [("meta", meta.folder.path, meta.records()), *drawn]
            file = subject.options.out / subject.app.name / f"baselines-{subject.label}-{subject.options.recipe}.png"
            say(f"picture: {picture_of_table(subject.app, subject.tasks, runs, file)}")
