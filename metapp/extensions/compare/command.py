"""`metapp compare`: two runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import escaped, out, print_json
from metapp.cli.options import FittedData, Json, Overwrite, Quiet, RunPath, check_new
from metapp.runs.reporter import number, say

if TYPE_CHECKING:
    from rich.table import Table

    from metapp.extensions.compare.compare import Comparison


def command(
    first: RunPath,
    second: Annotated[Path, typer.Argument(metavar="RUN", help="Another run of the same application.")],
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[INPUT]...", help="Original input, if it has moved; needed for the picture."),
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
    """Compare two runs: errors and seconds of each task, the ratio of errors with its interval, and a picture.

    Example: metapp compare RUN OTHER_RUN
    """
    from metapp.extensions.compare.compare import compare, draw

    check_new(out_file, overwrite)
    compared = compare(first, second, task, inputs or [], data)
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
    """One line a task, and the means."""
    from rich.table import Table

    from metapp.evaluation.statistics import FEWEST

    one, other = compared.sides
    overall, app = compared.ratio, one.app
    said = [app.caption()]
    if overall:
        few = overall.groups < FEWEST
        ahead = f"{one.label} has the lower error on {overall.ahead} of {overall.tasks}"
        said = [f"error of {one.label} over {other.label}'s: {overall}; {ahead}", *said]
        said[0] += f"; {overall.groups} different tasks are too few to call a win" if few else ""
        if overall.kind == "difference":
            said[0] = said[0].replace(" over ", " minus ")
    for title, (means, pair) in compared.measures.items():
        said.append(f"{title}: {means[0]:.3f} and {means[1]:.3f}" + (f", ratio {pair}" if pair else ""))
    table = Table(title=f"{app.full_title}: {one.label} and {other.label}", caption="\n".join(said), show_footer=True)
    table.add_column("task", "mean error, median time")
    for side in compared.sides:
        table.add_column(f"error, {side.label}", number(side.mean(), ".3f"), justify="right")
    table.add_column("ratio", justify="right")
    for side in compared.sides:
        table.add_column(f"seconds, {side.label}", number(side.seconds(), ".4f"), justify="right")
    for a, b in zip(one.records, other.records, strict=True):
        errors = (a["error"], b["error"])
        both = None not in errors and b["error"] > 0 and overall is not None and overall.kind == "ratio"
        ratio = f"{a['error'] / b['error']:.3f}" if both else "-"
        seconds = (number(each.get("seconds"), ".4f") for each in (a, b))
        table.add_row(escaped(a["name"]), *(number(each, ".3f") for each in errors), ratio, *seconds)
    return table
