"""What `metapp plan` makes: the chosen pairs of directions as a CSV file, a picture of them, and what the user is told.

The command itself is in `plan_command`, whose module imports no torch, so that its help is printed at once.
"""

from __future__ import annotations

import math
from pathlib import Path

import torch

from data_tools.readers.gonio import read_pairs, write_pairs
from data_tools.readers.measured_pairs import MIN_PAIRS, MeasuredPairs
from metapp.appearance.geometry import directions_to_rusinkiewicz
from metapp.apps.brdf.few.design import InstrumentLimits
from metapp.apps.brdf.highlight import describe_unseen_highlight
from metapp.cli.console import print_json
from metapp.evaluation.style import save_figure
from metapp.extensions.plan.planning import draw_directions, plan_brdf
from metapp.runs.reporter import progress, say

# Number of earlier measurements that a plan reads and its picture shows, at most. Each of the plan's steps reads them
# all; the model's 100 features are known from far fewer.
MAX_PLANNED_FROM = 2_000


def write_plan(
    count: int,
    *,
    grazing_degrees: float,
    apart_degrees: float,
    detector_degrees: float | None,
    out: Path,
    after: Path | None,
    seed: int,
    json: bool,
    quiet: bool,
) -> None:
    """Plan pairs of directions, write them and a picture of them, and say what to do next.

    Args:
        count: the number of pairs to choose.
        grazing_degrees: the greatest angle of light and detector from the normal that the instrument can reach.
        apart_degrees: the least angle between light and detector.
        detector_degrees: the angle of a fixed detector from the normal; None if the detector is not fixed.
        out: the CSV file to write; the picture is written beside it, with the suffix .png.
        after: a CSV file of earlier measurements, whose rows are written above the new ones; None if there are none.
        seed: the seed by which candidate directions are drawn.
        json: whether to print the result as one object of JSON.
        quiet: whether to say nothing on standard error.

    Raises:
        ValueError: the file of earlier measurements is damaged, or no direction is within the limits.
    """
    detector_rad = None if detector_degrees is None else math.radians(detector_degrees)
    limits = InstrumentLimits(math.radians(grazing_degrees), math.radians(apart_degrees), detector_rad)
    no_directions = torch.zeros(0, 3, dtype=torch.float64)
    measurements = read_pairs(after) if after else MeasuredPairs(no_directions, no_directions, no_directions)
    planned_from = measurements.draw(MAX_PLANNED_FROM)
    if len(planned_from.wi) < len(measurements.wi) and not quiet:
        found = f"{len(measurements.wi):,} measurements"
        say(f"{after}: {found}, planned from {MAX_PLANNED_FROM:,} of them, drawn at random")
    with progress("plan", quiet=quiet):
        wi, wo, (error_before, error_after) = plan_brdf(count, limits, planned_from, seed)
        write_pairs(out, wi, wo, measurements)
        picture = save_figure(draw_directions(wi, wo, planned_from), out.with_suffix(".png"))
    if not quiet:
        errors = f"from {error_before:.2f} to {error_after:.2f}"
        say(f"{out}: {count} pairs to measure; the expected error x100 falls {errors}")
        pairs = count + len(measurements.wi)
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
        print_json({"samples": count, **written, "expected_error": expected_errors})
