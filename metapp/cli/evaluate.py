"""`metapp evaluate`: the paper's tables and figures, from records; what has no record yet is run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metapp.cli.console import out, print_json, say
from metapp.cli.options import Json, takes
from metapp.evaluation.tables import NAMES, STUDIES, load_table

if TYPE_CHECKING:
    from metapp.evaluation.cell import Cell
    from metapp.evaluation.rows import Table
    from metapp.evaluation.study import Budget
    from metapp.evaluation.subject import Subject

FORMATS = ("rich", "markdown", "latex", "csv", "json")
ALL = "all"
WHICH = (*NAMES, ALL, *STUDIES)


@dataclass(frozen=True)
class Evaluation:
    """The options of `metapp evaluate`."""

    apps: Annotated[
        list[str] | None, typer.Argument(metavar="[APP]...", help="Applications; default: all there are.")
    ] = None
    table: Annotated[
        bool, typer.Option("--table/--no-table", help="Print the tables, or only write figures and report.")
    ] = True
    which: Annotated[str, typer.Option(help=f"Which table: {', '.join(WHICH)}.")] = "results"
    form: Annotated[str, typer.Option("--format", help=f"One of {', '.join(FORMATS)}.")] = "rich"
    no_run: Annotated[
        bool, typer.Option("--no-run", help="Print what there is, and the commands that make the rest.")
    ] = False
    figures: Annotated[Path | None, typer.Option(help="Draw the figures there, as PNG and PDF.")] = None
    report: Annotated[
        Path | None, typer.Option(help="Write one HTML page there: all tables, figures, pictures, records.")
    ] = None
    overfit_share: Annotated[
        float, typer.Option(help="Share of the recipe's steps that Overfit takes; tables say so.", min=1e-4, max=1.0)
    ] = 1.0
    steps: Annotated[
        list[int] | None, typer.Option(help="rules: numbers of gradient steps, 5 10 20 40 unless given.", min=1)
    ] = None
    train_steps: Annotated[
        int | None, typer.Option(help="rules: outer steps of each training, 500 unless given.", min=1)
    ] = None
    seeds: Annotated[int | None, typer.Option(help="rules: seeds of training from --seed on, 3.", min=1)] = None
    initialisation: Annotated[
        str,
        typer.Option(
            help="rules: what each training begins at: random, mean (of General's predictions) or encoder (General's "
            "own); encoder."
        ),
    ] = ""
    start: Annotated[str, typer.Option(hidden=True)] = ""  # what --initialisation was called
    rule: Annotated[
        str, typer.Option(help="Meta's learned rule, default: the recipe's; rules: this one alone, default: all.")
    ] = ""
    observe: Annotated[
        str, typer.Option(help="What fits may see, where an application has both: reference or photo; default: each.")
    ] = ""
    data: Annotated[Path | None, typer.Option(help="Folder of task shards; default: the embedded set.")] = None
    out: Annotated[Path, typer.Option(help="Where runs are kept.")] = Path("runs")
    recipe: Annotated[
        str,
        typer.Option(
            help="quick, full or paper; brdf: also measured; texture: also paper-vgg19. Where no APP is named, "
            "quick for those that have no such recipe."
        ),
    ] = "quick"
    seed: Annotated[int, typer.Option(help="Seed of all random draws.", min=0, max=2**63 - 1)] = 0
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto"
    json: Json = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False


@takes(Evaluation)
def command(options: Evaluation) -> None:
    """Print the paper's tables of your data beside the paper's figures; run what has no record yet.

    Example: metapp evaluate brdf --which quickft
    """
    given = check(options)
    subjects = subjects_of(given)
    names = NAMES if given.which == ALL else (given.which,)
    drawn = NAMES if given.report or (given.figures and given.which not in STUDIES) else ()
    fill([load_table(name) for name in dict.fromkeys((*names, *drawn))], subjects, given)
    if not given.quiet:
        draw(subjects, names)
    if given.table or given.json:
        show([load_table(name) for name in names], subjects, "json" if given.json else given.form)
    if given.figures:
        from metapp.evaluation.figures import FIGURES, write_figures

        for file in write_figures(subjects, given.figures, STUDIES if given.which in STUDIES else tuple(FIGURES)):
            say(f"figure: {file}")
    if given.report:
        from metapp.evaluation.report.page import write_report

        say(f"report: {write_report(subjects, given.report)}")


def check(given: Evaluation) -> Evaluation:
    """The options with their older names replaced.

    Raises:
        BadParameter: there is no such table or format, or an option is of another table.
    """
    given = replace(
        given,
        which={"peers": "baselines"}.get(given.which, given.which),
        initialisation=given.initialisation or given.start,
    )
    for option, value, known in (("--which", given.which, WHICH), ("--format", given.form, FORMATS)):
        if value not in known:
            raise typer.BadParameter(f"{option} '{value}': expected one of {', '.join(known)}.")
    of_studies: dict[str, object] = {
        "--steps": given.steps,
        "--train-steps": given.train_steps,
        "--seeds": given.seeds,
        "--initialisation": given.initialisation,
    }
    for option, of_study in of_studies.items():
        if of_study and given.which not in STUDIES:
            raise typer.BadParameter(f"{option}: only with --which {' or '.join(STUDIES)}.")
    return given


def budget_of(given: Evaluation) -> Budget:
    """How much the rule study trains.

    Raises:
        BadParameter: there is no such initialisation.
    """
    from metapp.evaluation.study import STARTS, Budget

    if given.initialisation and given.initialisation not in STARTS:
        raise typer.BadParameter(f"--initialisation '{given.initialisation}': expected one of {', '.join(STARTS)}.")
    values: dict[str, Any] = {
        "outer": given.train_steps,
        "steps": tuple(given.steps or ()),
        "seeds": given.seeds,
        "start": given.initialisation,
        "rules": (given.rule,) if given.rule else (),
    }
    return Budget(**{key: value for key, value in values.items() if value})


def subjects_of(given: Evaluation) -> list[Subject]:
    """Each application under each protocol."""
    from metapp.apps import app_names, protocols_of, recipes_of
    from metapp.evaluation.subject import Subject
    from metapp.runs.checks import check_name, check_protocol
    from metapp.runs.plan import plan
    from metapp.runs.request import Request

    budget, run = budget_of(given), not given.no_run
    names = given.apps or app_names()
    for name in names:
        check_name(name)
    for name in [name for name in names if protocols_of(name)] or names:
        check_protocol(given.observe, name)
    planned = [
        plan(
            Request(
                name,
                "general",
                observe=protocol,
                rule=given.rule,
                recipe=given.recipe if given.apps or given.recipe in recipes_of(name) else "quick",
                data=given.data,
                out=given.out,
                seed=given.seed,
                device=given.device,
                quiet=given.quiet,
            )
        )
        for name in names
        for protocol in ((given.observe,) if given.observe and protocols_of(name) else protocols_of(name) or ("",))
    ]
    strict = bool(given.apps) and run
    return [Subject(each, run=run, strict=strict, share=given.overfit_share, budget=budget) for each in planned]


def fill(tables: list[Table], subjects: list[Subject], given: Evaluation) -> None:
    """Measure what has no record yet, or name the commands that do."""
    from metapp.evaluation.cell import run_cells

    if any(table.name not in STUDIES for table in tables):
        # all checkpoints before the first fit: a missing one should not be found after an hour; applications that
        # nobody named have empty cells where a checkpoint is missing
        assert all(subject.fits for subject in subjects)
    cells = [cell for table in tables for subject in subjects for cell in table.cells(subject)]
    if not given.no_run:
        run_cells(cells, quiet=given.quiet)
        return
    groups: dict[str, list[Cell]] = {}
    for cell in {cell.title: cell for cell in cells}.values():
        groups.setdefault(cell.title.partition(": ")[0], []).append(cell)
    for title, group in groups.items():
        count, total = (sum(map(len, lists)) for lists in zip(*((c.missing(), c.tasks) for c in group), strict=True))
        if count or not total:
            say(f"{title}: {f'{count} of {total}' if count else 'all'} tasks missing: {group[0].command}")


def draw(subjects: list[Subject], names: Sequence[str]) -> None:
    """Draw fits side by side, as tables of these names compare them."""
    from metapp.evaluation.pictures import draw_baselines, draw_paradigms

    for name, draw_one in (("results", draw_paradigms), ("baselines", draw_baselines)):
        for file in filter(None, map(draw_one, subjects) if name in names else ()):
            say(f"picture: {file}")


def show(tables: list[Table], subjects: list[Subject], form: str) -> None:
    """Print tables in a format."""
    from metapp.cli.show import rich_table
    from metapp.evaluation.formats import csv_of, text_table

    several = len(tables) > 1
    found = {table.name: [(one, rows) for one in subjects if (rows := table.rows(one))] for table in tables}
    if form in ("json", "csv"):
        rows = [row | ({"table": name} if several else {}) for name in found for _, some in found[name] for row in some]
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
