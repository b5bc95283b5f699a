"""Which directions of a BRDF to measure, before anything is measured or after some of it is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from data_tools.readers.measured_pairs import Pairs
from metapp.appearance.geometry import directions_to_full_circle, outgoing_cosine
from metapp.extensions.few import gaussian
from metapp.extensions.few.design import Limits, Posterior, expected_errors, places_of, plan
from metapp.extensions.few.gonio import read_pairs
from metapp.extensions.few.network import NETWORK
from metapp.learning.task import Params
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.outputs.recorded import read_run
from metapp.runs.requests.plan import plan as plan_of
from metapp.runs.requests.request import Request

RECIPE = "few"
GRID, PHI = (30, 30), 8


class Planned(NamedTuple):
    """A plan of measurements.

    Attributes:
        wi, wo: unit vectors to light and detector, [N, 3] each, in the order in which they tell most.
        before: what was measured before.
        expected: errors x100 that fits are expected to have before these measurements and after them.
        maps: the same over half and difference angles, 0 to 90 degrees, [GRID] each.
    """

    wi: Tensor
    wo: Tensor
    before: Pairs
    expected: tuple[float, float]
    maps: tuple[Tensor, Tensor]


def plan_brdf(count: int, limits: Limits, after: Path | None = None, seed: int = 0) -> Planned:
    """Choose directions by the model that ships for fits of few samples.

    Args:
        count: of pairs of directions.
        limits: of the instrument.
        after: a CSV file of what was measured, or the run that fitted it; None: nothing was.
        seed: of the candidates.

    Raises:
        ValueError: no direction is within the limits; `after` is no such file or run.
    """
    request = Request("brdf", "meta", recipe=RECIPE, device="cpu", quiet=True)
    planned = find_checkpoint(plan_of(request))
    assert planned.checkpoint is not None  # or it would have been refused
    encoder = planned.checkpoint.prepared.encoder
    before = read_pairs(_file_of(after)) if after else Pairs(*(torch.zeros(0, 3, dtype=torch.float64),) * 3)
    seen = directions_to_full_circle(before.wi, before.wo)
    # before anything is measured, of the first kind: measured materials
    theta = fitted(encoder, seen, before.reflectance) if len(seen) else NETWORK.of_kinds(encoder, torch.zeros(1).long())
    wi, wo = plan(theta, count, limits, seen, Generator().manual_seed(seed))
    every = torch.cat([seen.float(), directions_to_full_circle(wi, wo)])
    (low, first), (high, then) = open_errors(theta, seen.float()), open_errors(theta, every)
    return Planned(wi, wo, before, (low, high), (first, then))


def fitted(encoder: Params, angles: Tensor, reflectance: Tensor) -> Params:
    """The likeliest model [1, ...] after samples: angles [N, 3] in rad and reflectance [N, 3] in 1/sr."""
    where = places_of(angles.float())
    target = torch.log1p(reflectance.T[None].float() * where[:, 6:])
    batch = {"where": where, "target": target, "count": torch.tensor([float(len(angles))])}
    theta = NETWORK.encode(encoder, batch)
    linear = gaussian.linear(theta, batch)
    posterior = Posterior.of(theta, where, gaussian.slope_of(reflectance.T[None].float(), where))
    moment = (linear.residual[0] * linear.weights[0] / len(angles)) @ linear.features[0].T
    change = torch.einsum("cfg,cg->cf", posterior.covariance, moment.double())
    return theta | {"last": theta["last"] + change[None].float()}


def _grid() -> Tensor:
    """Places [1, 7, N] of the picture: half angles, then difference angles, mean over PHI azimuths."""
    half, difference = ((torch.arange(each) + 0.5) / each * math.pi / 2 for each in GRID)
    azimuth = (torch.arange(PHI) + 0.5) / PHI * math.tau
    return places_of(torch.cartesian_prod(half, difference, azimuth))


def open_errors(theta: Params, seen: Tensor) -> tuple[float, Tensor]:
    """The expected error x100 over all directions after samples [N, 3] rad, and over GRID, NaN below the horizon."""
    posterior = Posterior.of(theta, places_of(seen))
    grid = _grid()
    errors = 100 * posterior.expected_error(grid)
    above = torch.minimum(grid[0, 6], outgoing_cosine(grid)[0]) > 0
    mean = torch.where(above, errors, math.nan).reshape(*GRID, PHI).nanmean(2)
    return 100 * expected_errors(posterior)["expected"], mean


def _file_of(after: Path) -> Path:
    """A CSV file, or the one input of a run.

    Raises:
        ValueError: the run is of other inputs.
    """
    if after.is_file() and after.name != "record.jsonl":
        return after
    (record, *others) = read_run(after).records
    inputs = record.get("origin", {}).get("inputs", [])
    if others or len(inputs) != 1 or not Path(inputs[0]).is_file():
        raise ValueError(f"{after}: a run of {len(inputs)} inputs, expected one CSV file that is still there; name it.")
    return Path(inputs[0])
