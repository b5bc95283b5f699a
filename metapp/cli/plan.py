"""The command `metapp plan`: choose the next directions in which to measure a BRDF."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Overwrite, Quiet, Seed, check_new_file
from metapp.cli.console import print_json
from metapp.names import did_you_mean
from metapp.runs.reporter import progress, say


def plan_measurements(
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

    They minimise the expected error of a fit by recipe few: first one by one, then jointly by the error's gradient.
    Measure them, fill in the BRDF (r, g, b in 1/sr), then fit the file.

    Examples:
      metapp plan brdf --samples 16 --out paint.csv
      metapp meta brdf paint.csv
      metapp plan brdf --samples 8 --after paint.csv --out more.csv
    """
    import torch

    from data_tools.readers.gonio import read_pairs, write_pairs
    from data_tools.readers.measured_pairs import MIN_PAIRS, MeasuredPairs
    from metapp.appearance.geometry import directions_to_rusinkiewicz
    from metapp.apps.brdf.few.design import InstrumentLimits
    from metapp.apps.brdf.presenter import describe_unseen_highlight
    from metapp.evaluation.planning import draw_directions, plan_brdf
    from metapp.evaluation.style import save_figure

    if app != "brdf":
        expected = f"expected brdf; other applications have no directions to choose.{did_you_mean(app, ['brdf'])}"
        raise typer.BadParameter(f"'{app}': {expected}")
    for path in (out, out.with_suffix(".png")):
        check_new_file(path, overwrite)
    detector = None if detector is None else math.radians(detector)
    limits = InstrumentLimits(math.radians(grazing), math.radians(apart), detector)
    no_directions = torch.zeros(0, 3, dtype=torch.float64)
    measurements = read_pairs(after) if after else MeasuredPairs(no_directions, no_directions, no_directions)
    with progress("plan", quiet=quiet):
        wi, wo, (error_before, error_after) = plan_brdf(samples, limits, measurements, seed)
    write_pairs(out, wi, wo, measurements)
    picture = save_figure(draw_directions(wi, wo, measurements), out.with_suffix(".png"))
    if not quiet:
        errors = f"from {error_before:.2f} to {error_after:.2f}"
        say(f"{out}: {samples} pairs to measure; the expected error x100 falls {errors}")
        pairs = samples + len(measurements.wi)
        next_step = (
            f"metapp meta brdf {out}"
            if pairs >= MIN_PAIRS
            else f"plan more pairs by --after {out}, since a fit takes at least {MIN_PAIRS}"
        )
        all_angles = torch.cat(
            [directions_to_rusinkiewicz(*pair) for pair in ((measurements.wi, measurements.wo), (wi, wo))]
        )
        if unseen := describe_unseen_highlight(all_angles):
            say(f"{unseen}; allow them by --apart and --grazing")
        say(f"picture: {picture}\nfill in r, g, b; then: {next_step}")
    if json:
        expected_errors = {"before": error_before, "after": error_after}
        written = {"out": str(out), "picture": str(picture)}
        print_json({"samples": samples, **written, "expected_error": expected_errors})
