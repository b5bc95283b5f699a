"""`metapp plan`: what to measure."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json
from metapp.runs.reporter import say


def command(
    app: Annotated[str, typer.Argument(metavar="APP", help="brdf.")],
    samples: Annotated[int, typer.Option(min=1, max=256, help="Pairs of directions to measure.")] = 16,
    out: Annotated[
        Path, typer.Option(dir_okay=False, help="The CSV file to fill in; a PNG of the directions lies beside it.")
    ] = Path("plan.csv"),
    after: Annotated[
        Path | None,
        typer.Option(metavar="CSV|RUN", help="What was measured before: its rows go on top of the new ones."),
    ] = None,
    grazing: Annotated[
        float, typer.Option(min=10, max=89, help="Light and detector are no further from the normal, degrees.")
    ] = 80.0,
    apart: Annotated[float, typer.Option(min=0, max=90, help="Nor nearer to each other than this, degrees.")] = 5.0,
    detector: Annotated[
        float | None,
        typer.Option(min=0, max=89, help="A camera that stays: its angle from the normal, degrees; default: free."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all random draws.")] = 0,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No messages.")] = False,
) -> None:
    """Choose the pairs of light and detector directions that say most of an isotropic BRDF.

    They are chosen by the model that fits of few samples have, each where the expected error falls most, then all
    together by the gradient of that error. Measure them, fill in the BRDF (r, g, b in 1/sr), then fit the file.

    Examples:
      metapp plan brdf --samples 16 --out paint.csv
      metapp meta brdf paint.csv
      metapp plan brdf --samples 8 --after paint.csv --out more.csv
    """
    from data_tools.readers.gonio import write_pairs
    from metapp.apps.brdf.design import Limits
    from metapp.evaluation.figures.directions import directions
    from metapp.evaluation.figures.style import save
    from metapp.runs.planning import plan_brdf

    if app != "brdf":
        raise typer.BadParameter(f"'{app}': expected brdf; of other applications a fit takes whole pictures.")
    if out.exists():
        raise typer.BadParameter(f"--out {out}: is there already, and may be filled in; name another file.")
    limits = Limits(math.radians(grazing), math.radians(apart), None if detector is None else math.radians(detector))
    planned = plan_brdf(samples, limits, after, seed)
    write_pairs(out, planned.wi, planned.wo, planned.before)
    before = (planned.before.wi, planned.before.wo)
    picture = save(directions(planned.wi, planned.wo, before, planned.maps).figure, out.with_suffix(".png"))
    low = f"{planned.expected[0]:.2f} to {planned.expected[1]:.2f}"
    if not quiet:
        say(f"{out}: {samples} pairs of directions to measure; the expected error x100 falls from {low}")
        say(f"picture: {picture}\nfill in r, g, b; then: metapp meta brdf {out}")
    if json:
        names = ("before", "after")
        expected = dict(zip(names, planned.expected, strict=True))
        print_json({"samples": samples, "out": str(out), "picture": str(picture), "expected_error": expected})
