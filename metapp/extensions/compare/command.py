"""`metapp compare`: runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import escaped, out, print_json
from metapp.cli.options import FittedData, Json, Overwrite, Quiet, RunPath, check_new
from metapp.runs.reporter import number, progress, say

if TYPE_CHECKING:
    from rich.table import Table

    from metapp.extensions.compare.compare import Comparison


def command(
    first: RunPath,
    second: Annotated[Path, typer.Argument(metavar="RUN", help="Another run of the same application.")],
    others: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[RUN|INPUT]...",
            help="Further runs; original inputs, if they have moved: needed for the picture.",
        ),
    ] = None,
    task: Annotated[str, typer.Option(metavar="NAME", help="Compare this task alone; default: all in common.")] = "",
    data: FittedData = None,
    out_file: Annotated[
        Path | None,
        typer.Option("--out", dir_okay=False, help="Picture to write; default: comparison.png in the first RUN."),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare runs with the first: errors of each task, the ratio of mean errors with its interval, and a picture.

    Example: metapp compare RUN OTHER_RUN
    """
    from metapp.extensions.compare.compare import compare, draw
    from metapp.runs.outputs.recorded import holds_fits

    check_new(out_file, overwrite)
    runs = [first, second, *filter(holds_fits, others or [])]
    with progress("compare: reading what was fitted", quiet=quiet):
        compared = compare(runs, task, [path for path in others or [] if path not in runs], data)
    file = out_file or compared.sides[0].folder / "comparison.png"
    picture, compared = draw(compared, file, quiet=quiet)
    if not (quiet or json):
        out().print(_table(compared))
    if not quiet:
        for note in compared.notes:
            say(f"note: {note}")
        missing = "no picture: fits or what was fitted are not there; give what was fitted after the runs."
        say(f"picture: {picture}" if picture else missing)
    if json:
        print_json(compared.document(picture))


def _table(compared: Comparison) -> Table:
    """A column a run: errors of tasks, then their means, how these compare with the first run's, and seconds."""
    from rich.table import Table

    from metapp.evaluation.statistics import FEWEST

    sides, presenter = compared.sides, compared.sides[0].presenter
    pairs = [each.compared for each in compared.errors]
    base, known = sides[0].label, [pair for pair in pairs if pair]
    said = [presenter.caption()]
    if known and known[0].groups < FEWEST:
        said.append(f"{known[0].groups} different tasks are too few to call a win")
    for title, measured in compared.measures.items():
        of_sides = (
            f"{side.label} {number(each.mean, '.3f')}" + (f" (ratio {each.compared})" if each.compared else "")
            for side, each in zip(sides, measured, strict=True)
        )
        said.append(f"{title}: {', '.join(of_sides)}")
    table = Table(
        title=f"{presenter.title}, error{presenter.app.error_measure.factor}",
        caption="\n".join(said),
        caption_justify="left",
    )
    table.add_column("task")
    for side in sides:
        table.add_column(side.label, justify="right")
    for of_task in zip(*(side.records for side in sides), strict=True):
        table.add_row(escaped(of_task[0]["name"]), *(number(each["error"], ".3f") for each in of_task))
    table.add_section()
    table.add_row("mean error", *(number(each.mean, ".3f") for each in compared.errors))
    if known:
        form = ".3f" if known[0].kind == "ratio" else "+.3f"
        rows = {
            {"ratio": "ratio to", "difference": "difference from"}[known[0].kind] + f" {base}'s": "{0.value:%s}",
            "95 % interval": "{0.low:%s} .. {0.high:%s}",
            f"lower than {base}'s on": "{0.ahead}/{0.tasks}",
        }
        for title, text in rows.items():
            table.add_row(title, *(text.replace("%s", form).format(pair) if pair else "-" for pair in pairs))
    table.add_row("median seconds", *(number(side.seconds(), ".4f") for side in sides))
    return table
