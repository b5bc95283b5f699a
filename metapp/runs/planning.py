"""Which directions of a BRDF to measure, before anything is measured or after some of it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor

from data_tools.readers.brdf_task import analytic_angles
from data_tools.readers.gonio import Pairs, read_pairs
from metapp.appearance.geometry import directions_to_full_circle
from metapp.apps.brdf import few
from metapp.apps.brdf.design import Limits, belief, places_of, plan
from metapp.learning.task import Params
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.plan import plan as plan_of
from metapp.runs.recorded import read_run
from metapp.runs.request import Request

RECIPE = "few"
REFERENCES = 512


class Planned(NamedTuple):
    """What to measure.

    Attributes:
        wi, wo: unit vectors to light and detector, [N, 3] each, in the order in which they tell most.
        before: what was measured before.
        expected: errors x100 that fits are expected to have before these measurements and after them.
    """

    wi: Tensor
    wo: Tensor
    before: Pairs
    expected: tuple[float, float]


def plan_brdf(count: int, limits: Limits, after: Path | None = None, seed: int = 0, checkpoint: Any = None) -> Planned:
    """Choose directions by the model that ships for fits of few samples, or by another checkpoint.

    Args:
        count: of pairs of directions.
        limits: of the instrument.
        after: a CSV file of what was measured, or the run that fitted it; None: nothing was.
        seed: of the candidates.
        checkpoint: a file; None: the one that ships.

    Raises:
        ValueError: no direction is within the limits; `after` is no such file or run.
    """
    request = Request("brdf", "meta", recipe=RECIPE, device="cpu", quiet=True, checkpoint=checkpoint)
    found = find_checkpoint(plan_of(request))
    assert found.checkpoint is not None  # or it would have been refused
    theta = {key: value[None] for key, value in found.checkpoint.prepared.theta.items()}
    before = read_pairs(_file_of(after)) if after else Pairs(*(torch.zeros(0, 3, dtype=torch.float64),) * 3)
    seen = directions_to_full_circle(before.wi, before.wo)
    if len(seen):
        theta = fitted(theta, seen, before.reflectance)
    wi, wo = plan(theta, count, limits, seen, Generator().manual_seed(seed))
    every = torch.cat([seen.float(), directions_to_full_circle(wi, wo)])
    return Planned(wi, wo, before, (_expected(theta, seen.float()), _expected(theta, every)))


def fitted(theta: Params, angles: Tensor, reflectance: Tensor) -> Params:
    """The model [1, ...] after samples: angles [N, 3] in rad and reflectance [N, 3] in 1/sr."""
    where = places_of(angles.float())
    target = torch.log1p(reflectance.T[None].float() * where[:, 6:])
    batch = {"where": where, "target": target, "count": torch.tensor([float(len(angles))])}
    linear = few.linear(theta, batch)
    known = belief(theta, where, few.slope_of(reflectance.T[None].float(), where))
    moment = (linear.residual[0] * linear.weights[0] / len(angles)) @ linear.features[0].T
    change = torch.einsum("cfg,cg->cf", known.covariance, moment.double())
    return theta | {"last": theta["last"] + change[None].float()}


def _anywhere() -> Tensor:
    """Places all over the hemisphere, as held-out samples of BRDFs are."""
    return places_of(analytic_angles(REFERENCES, 1))


def _expected(theta: Params, seen: Tensor) -> float:
    return 100 * float(belief(theta, places_of(seen)).expected_error(_anywhere()).mean())


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
