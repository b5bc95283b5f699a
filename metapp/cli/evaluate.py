"""`metapp evaluate`: the tables, from records; what has no record yet is run."""

from __future__ import annotations

import csv
import io
import json as json_module
import math
import shlex
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metapp.cli.console import number, out, print_json, say

if TYPE_CHECKING:
    from metapp.cli.session import Options, Start
    from metapp.paradigms import Paradigm
    from metapp.task import App, Task

FORMATS = ("rich", "markdown", "latex", "csv", "json")
TABLES = ("results",)


def command(
    apps: Annotated[
        list[str] | None, typer.Argument(metavar="[APP]...", help="Applications; default: all there are.")
    ] = None,
    table: Annotated[bool, typer.Option("--table", help="Print the table (the default).")] = True,
    which: Annotated[str, typer.Option(help=f"Which table: {', '.join(TABLES)}.")] = "results",
    format_name: Annotated[str, typer.Option("--format", help=f"One of {', '.join(FORMATS)}.")] = "rich",
    no_run: Annotated[
        bool, typer.Option("--no-run", help="Print what there is; name the commands for the rest.")
    ] = False,
    rule: Annotated[str, typer.Option(help="Meta's learned rule; default: the recipe's.")] = "",
    observe: Annotated[
        str,
        typer.Option(help="What fits may see, where an application has both: reference or photo; default: each."),
    ] = "",
    data: Annotated[Path | None, typer.Option(help="Folder of task shards; default: the embedded set.")] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="Where runs are kept.")] = Path("runs"),
    recipe: Annotated[str, typer.Option(help="quick or paper; texture: also paper-vgg19.")] = "quick",
    seed: Annotated[int, typer.Option(help="Seed of all random draws.", min=0, max=2**63 - 1)] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    json: Annotated[bool, typer.Option("--json", help="One JSON object as last line of standard output.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Print error and time of all five paradigms beside the paper's; run what has no record yet.

    Example: metapp evaluate brdf --table
    """
    if which not in TABLES:
        raise typer.BadParameter(f"--which '{which}': expected one of {', '.join(TABLES)}.")
    if format_name not in FORMATS:
        raise typer.BadParameter(f"--format '{format_name}': expected one of {', '.join(FORMATS)}.")
    from metapp.apps import app_names
    from metapp.cli.session import Options, check_protocol, check_recipe, check_rule, find_app, find_device

    found = [find_app(name) for name in apps or app_names()]
    for app in [app for app in found if app.protocols] or found:
        check_protocol(observe, app)
    planned: list[tuple[Options, list[Planned]]] = []
    for app in found:
        check_recipe(recipe, app)
        for protocol in (observe,) if observe and app.protocols else app.protocols or ("",):
            placed = app.at(app.recipes[recipe], protocol)
            options = Options(
                placed,
                recipe,
                check_rule(rule, placed, recipe),
                None,
                data,
                out_folder,
                None,
                seed,
                find_device(device, app),
                quiet,
            )
            # all starts before the first fit: a missing one should not be found after an hour
            planned.append((options, find_starts(options, run=not no_run)))
    rows = [row for options, runs in planned for row in app_rows(options, runs, run=not no_run)]
    shown = {(options.app.name, options.app.protocol): options.app for options, _ in planned}
    if json or format_name == "json":
        print_json({"which": which, "rows": rows})
    elif format_name == "rich":
        for key, app in shown.items():
            out.print(rich_table(app, [row for row in rows if _key(row) == key]))
    else:
        out.print(text_table(rows, shown, format_name), markup=False, soft_wrap=True)


Planned = tuple["Options", "Paradigm", "Start | None"]


def find_starts(options: Options, *, run: bool) -> list[Planned]:
    """What the rows of one application are fitted from: the paradigms, then Meta by further rules that have a start.

    Raises:
        ValueError: a start is missing that a row must have; it is said, and None, where nothing is to be run.
    """
    from metapp.cli.starts import find_start, trained_path
    from metapp.paradigms import paradigms

    each = paradigms()
    others = [rule for rule in options.job.recipe.meta if rule != options.rule]
    if options.data:  # beside starts of this data, none that was trained on other data
        others = [rule for rule in others if trained_path(options, rule).is_file()]
    runs: list[Planned] = []
    for paradigm in each.values():
        try:
            runs.append((options, paradigm, find_start(options, paradigm)))
        except ValueError as error:
            if run:
                raise
            say(f"{error}")
            runs.append((options, paradigm, None))
    for rule in others:
        with suppress(ValueError):  # nobody trained this rule
            of = options._replace(rule=rule)
            runs.append((of, each["meta"], find_start(of, each["meta"])))
    return runs


def app_rows(options: Options, runs: list[Planned], *, run: bool) -> list[dict[str, Any]]:
    """A row for each of the runs, from their records; what has no record yet is run, unless told otherwise."""
    from metapp.cli.inputs import tasks_to_fit
    from metapp.cli.session import make_folder

    make_folder(options.out)
    tasks, label = tasks_to_fit(options.app, [], options.data, options.quiet)
    rows, complete = [], []
    for of, paradigm, start in runs:
        row, folder, records = _row(of, paradigm, start, tasks, label, run)
        if of.rule == options.rule and len(records) == len(tasks):
            complete.append((paradigm.name, folder, records))
        if of.rule != options.rule:
            row |= {"paradigm": f"meta:{of.rule}", "paper_error": None, "paper_seconds": None}
        rows.append(row)
    if complete and not options.quiet:
        from metapp.cli.pictures import picture_of_table

        name = f"comparison-{label}-{options.recipe}-seed{options.seed}"
        name += f"-{options.app.protocol}" if options.app.protocol else ""
        file = options.out / options.app.name / f"{name}.png"
        say(f"picture: {picture_of_table(options.app, tasks, complete, file)}")
    return rows


def _key(row: dict[str, Any]) -> tuple[str, str]:
    """The application and the protocol of a row: what makes a table."""
    return row["app"], row.get("observe", "")


def _row(
    options: Options, paradigm: Paradigm, start: Start | None, tasks: list[Task], label: str, run: bool
) -> tuple[dict[str, Any], Path, list[dict[str, Any]]]:
    """A row of the table, and the run's folder and records it was made of."""
    from metapp.cli.fit import run_path, run_tasks, summary
    from metapp.cli.session import is_first_protocol, observe_of, settings_of
    from metapp.records import RunFolder

    records: list[dict[str, Any]] = []
    path = Path()
    if start is not None:
        settings = settings_of(options, paradigm, start, label)
        path = run_path(options, settings, label)
        folder = RunFolder(path, settings)
        if run:
            records = run_tasks(options, paradigm, start, tasks, folder)
        else:
            finished = folder.finished()
            records = [finished[task.name] for task in tasks if task.name in finished]
    if len(records) < len(tasks):
        say(f"{len(tasks) - len(records)} of {len(tasks)} tasks missing: {_command_for(options, paradigm, start)}")
    groups = {task.name: task.group or task.name for task in tasks}
    low, high = (None, None)
    known = [record for record in records if record["error"] is not None]
    if known:
        low, high = bootstrap([r["error"] for r in known], [groups[r["name"]] for r in known])
    # the paper's fits see what those of the first protocol see
    paper = paper_figures() if is_first_protocol(options.app) else {"error": {}, "seconds": {}}
    row = {
        "app": options.app.name,
        **observe_of(options.app),
        "paradigm": paradigm.name,
        "rule": options.rule if paradigm.name == "meta" else None,
        "steps": paradigm.count(options.job),
        **(summary(records) if records else {"error": None, "seconds": None}),
        "worst": max((record["error"] for record in known), default=None),
        "tasks": len(records),
        "low": low,
        "high": high,
        "paper_error": paper["error"].get(options.app.name, {}).get(paradigm.name),
        "paper_seconds": paper["seconds"].get(options.app.name, {}).get(paradigm.name),
        **options.app.conditions(),
    }
    return row, path, records


def _command_for(options: Options, paradigm: Paradigm, start: Start | None) -> str:
    """The command that makes what is missing."""
    words = ["metapp", paradigm.name, options.app.name, "--out", str(options.out), "--recipe", options.recipe]
    words += ["--observe", options.app.protocol] if options.app.protocol else []
    words += ["--seed", str(options.seed)] + (["--data", str(options.data)] if options.data else [])
    words += (["--rule", options.rule] if paradigm.name == "meta" else []) + (["--train"] if start is None else [])
    return shlex.join(words)


def paper_figures() -> dict[str, Any]:
    """The paper's errors and seconds, by application and paradigm."""
    return json_module.loads((resources.files("metapp") / "paper.json").read_text())


def bootstrap(errors: list[float], groups: list[str], draws: int = 4000) -> tuple[float, float]:
    """95 % interval of the mean over tasks, by resampling groups of tasks that show the same, with a fixed seed."""
    import numpy as np

    order = {group: index for index, group in enumerate(dict.fromkeys(groups))}
    rows = [order[group] for group in groups]
    total, count = np.bincount(rows, errors), np.bincount(rows)
    drawn = np.random.default_rng(0).integers(len(order), size=(draws, len(order)))
    low, high = np.quantile(total[drawn].sum(1) / count[drawn].sum(1), (0.025, 0.975))
    return float(low), float(high)


def carried(rows: list[dict[str, Any]], error: str, seconds: str) -> tuple[float | None, float | None]:
    """The two figures that carry across data sets and machines: Meta's gap closed, and its speed-up over Overfit."""
    by = {row["paradigm"]: row for row in rows}
    general, overfit, meta = (by[name] for name in ("general", "overfit", "meta"))
    gap = speed = None
    if None not in (general[error], overfit[error], meta[error]):
        gap = (general[error] - meta[error]) / ((general[error] - overfit[error]) or math.nan)
    if None not in (overfit[seconds], meta[seconds]):
        speed = overfit[seconds] / meta[seconds]
    return gap, speed


COLUMNS = ("paradigm", "error", "seconds", "paper error", "paper seconds", "steps", "95 % interval", "worst")
NARROW = 5  # so many of them fit into 80 columns


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """A row as text, in the order of COLUMNS."""
    interval = "-" if row["low"] is None else f"{row['low']:.3f} .. {row['high']:.3f}"
    return (
        row["paradigm"],
        number(row["error"], ".3f"),
        number(row["seconds"], ".4f"),
        number(row["paper_error"], ".3f"),
        number(row["paper_seconds"], ".3f"),
        str(row["steps"]),
        interval,
        number(row["worst"], ".3f"),
    )


def closing(app: App, rows: list[dict[str, Any]]) -> str:
    """Gap closed and speed-up beside the paper's.

    Under a further protocol Overfit fits less than errors are measured on: Meta is compared with General and QuickFT.
    """
    from metapp.cli.session import is_first_protocol

    gap, speed = carried(rows, "error", "seconds")
    if not is_first_protocol(app):
        floor = f"Overfit sees the {app.protocol} alone and is no floor"
        return f"{_changes(rows)}{floor}, speed-up of Meta over it {number(speed, '.0f')}"
    paper_gap, paper_speed = carried(rows, "paper_error", "paper_seconds")
    return (
        f"gap closed {number(gap, '.2f')} (paper {number(paper_gap, '.2f')}), "
        f"speed-up of Meta over Overfit {number(speed, '.0f')} (paper {number(paper_speed, '.0f')})"
    )


def _changes(rows: list[dict[str, Any]]) -> str:
    """How far Meta's error is from General's and QuickFT's, in percent, as far as there are such errors."""
    by = {row["paradigm"]: row["error"] for row in rows}
    changes = []
    for other, title in (("general", "General"), ("quickft", "QuickFT")):
        if by["meta"] is not None and by[other]:
            change = 100 * (by["meta"] / by[other] - 1)
            changes.append(f"{abs(change):.0f} % {'above' if change > 0 else 'below'} {title}'s")
    return f"Meta's error is {', '.join(changes)}; " if changes else ""


def rich_table(app: App, rows: list[dict[str, Any]]) -> Any:
    """The table for a terminal."""
    from rich.table import Table

    from metapp.cli.fit import caption_of
    from metapp.cli.session import is_first_protocol, title_of

    factor = f" x{app.scale:g}" if app.scale != 1 else ""
    rule = next(row["rule"] for row in rows if row["paradigm"] == "meta")
    count = max(row["tasks"] for row in rows)
    table = Table(
        title=f"{title_of(app)}, {count} unseen tasks: mean error{factor}, median seconds of inference",
        caption=f"{closing(app, rows)}\nmeta: {rule}; {caption_of(app)}"
        + ("\nthe paper's figures are of its own data and machine" if is_first_protocol(app) else ""),
    )
    shown = len(COLUMNS) if out.width >= 110 else NARROW
    for column in COLUMNS[:shown]:
        table.add_column(column, justify="left" if column == "paradigm" else "right", no_wrap=column != "paradigm")
    for row in rows:
        table.add_row(*cells(row)[:shown])
    return table


def text_table(rows: list[dict[str, Any]], apps: dict[tuple[str, str], App], form: str) -> str:
    """The table as markdown, LaTeX (booktabs) or CSV."""
    header = ("app", *COLUMNS)
    body = [(" ".join(_key(row)).rstrip(), *cells(row)) for row in rows]
    if form == "csv":
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return buffer.getvalue().rstrip("\n")
    from metapp.cli.fit import caption_of
    from metapp.cli.session import name_of

    notes = [
        f"{name_of(app)}: {closing(app, [row for row in rows if _key(row) == key])}; {caption_of(app)}"
        for key, app in apps.items()
    ]
    if form == "markdown":
        lines = [header, ("---",) * len(header), *body]
        return "\n".join([*("| " + " | ".join(line) + " |" for line in lines), "", *notes])
    escape = str.maketrans({"_": r"\_", "%": r"\%"})
    tex = [" & ".join(line).translate(escape) + r" \\" for line in (header, *body)]
    top = [r"\begin{tabular}{ll" + "r" * (len(header) - 2) + "}", r"\toprule", tex[0], r"\midrule"]
    return "\n".join([*top, *tex[1:], r"\bottomrule", r"\end{tabular}", *(f"% {note}" for note in notes)])
