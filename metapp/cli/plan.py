"""`metapp plan`: the next directions to measure."""

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
    app: Annotated[str, typer.Argument(metavar="APP", autocompletion=lambda: ["brdf"], help="brdf.")],
    samples: Annotated[int, typer.Option(min=1, max=256, help="Pairs of directions to measure.")] = 16,
    out: Annotated[
        Path, typer.Option(dir_okay=False, help="The CSV file to fill in; a PNG of the directions lies beside it.")
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
    apart: Annotated[float, typer.Option(min=0, max=90, help="Minimum angle of light to detector, degrees.")] = 5.0,
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

    They minimise the expected error of recipe few: first one by one, then jointly by its gradient.
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
        whole = f"expected brdf; of other applications a fit takes whole pictures.{did_you_mean(app, ['brdf'])}"
        raise typer.BadParameter(f"'{app}': {whole}")
    for path in (out, out.with_suffix(".png")):
        check_new_file(path, overwrite)
    detector = None if detector is None else math.radians(detector)
    limits = InstrumentLimits(math.radians(grazing), math.radians(apart), detector)
    nothing = torch.zeros(0, 3, dtype=torch.float64)
    before = read_pairs(after) if after else MeasuredPairs(nothing, nothing, nothing)
    with progress("plan", quiet=quiet):
        wi, wo, (first, then) = plan_brdf(samples, limits, before, seed)
    write_pairs(out, wi, wo, before)
    picture = save_figure(draw_directions(wi, wo, before), out.with_suffix(".png"))
    if not quiet:
        say(f"{out}: {samples} pairs to measure; the expected error x100 falls from {first:.2f} to {then:.2f}")
        pairs = samples + len(before.wi)
        fit = (
            f"metapp meta brdf {out}"
            if pairs >= MIN_PAIRS
            else f"plan more --after {out}; a fit takes {MIN_PAIRS} pairs"
        )
        every = torch.cat([directions_to_rusinkiewicz(*pair) for pair in ((before.wi, before.wo), (wi, wo))])
        if unseen := describe_unseen_highlight(every):
            say(f"{unseen}; allow them by --apart and --grazing")
        say(f"picture: {picture}\nfill in r, g, b; then: {fit}")
    if json:
        expected = {"before": first, "after": then}
        written = {"out": str(out), "picture": str(picture)}
        print_json({"samples": samples, **written, "expected_error": expected})
