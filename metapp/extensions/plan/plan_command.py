"""The command `metapp plan`: choose the next directions in which to measure a BRDF.

Only arguments and help are made here; `planned_pairs`, which imports torch, does the work.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Overwrite, Quiet, Seed, check_new_file
from metapp.entries import did_you_mean
from metapp.storage.files import add_suffix


def plan_command(
    app: Annotated[str, typer.Argument(metavar="APP", autocompletion=lambda: ["brdf"], help="Application: brdf.")],
    samples: Annotated[int, typer.Option(min=1, max=256, help="Number of pairs of directions to measure.")] = 16,
    out: Annotated[
        Path, typer.Option(dir_okay=False, help="CSV file to fill in; a PNG of the directions is written beside it.")
    ] = Path("plan.csv"),
    after: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="CSV file of earlier measurements; its rows are written above the new ones.",
        ),
    ] = None,
    grazing: Annotated[
        float, typer.Option(min=10, max=89, help="Maximum angle of light and detector from the normal, degrees.")
    ] = 80.0,
    apart: Annotated[
        float, typer.Option(min=0, max=90, help="Minimum angle between light and detector, degrees.")
    ] = 5.0,
    detector: Annotated[
        float | None,
        typer.Option(min=0, max=89, help="Angle of a fixed detector from the normal, degrees; default: not fixed."),
    ] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    json: JsonFlag = False,
    quiet: Quiet = False,
) -> None:
    """Choose the pairs of light and detector directions that are most informative for an isotropic BRDF.

    They minimise the expected error of a fit by the recipe few: pairs are chosen one after another, then moved together
    along the error's gradient. Measure them, fill in the BRDF (r, g, b in 1/sr), then fit the file.

    Examples:
      metapp plan brdf --samples 16 --out paint.csv
      metapp meta brdf paint.csv
      metapp plan brdf --samples 8 --after paint.csv --out more.csv
    """
    from metapp.extensions.plan.planned_pairs import write_plan

    if app != "brdf":
        expected = f"expected brdf; other applications have no directions to choose.{did_you_mean(app, ['brdf'])}"
        raise typer.BadParameter(f"'{app}': {expected}")
    out = add_suffix(out, ".csv")  # a table of another suffix would be no input of a fit
    for path in (out, out.with_suffix(".png")):
        check_new_file(path, overwrite)
    write_plan(
        samples,
        grazing_degrees=grazing,
        apart_degrees=apart,
        detector_degrees=detector,
        out=out,
        after=after,
        seed=seed,
        json=json,
        quiet=quiet,
    )
