"""Which directions of a BRDF to measure, before anything is measured or after some of it is."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from data_tools.readers.measured_pairs import Pairs
from metapp.appearance.geometry import directions_to_full_circle
from metapp.extensions.few import gaussian
from metapp.extensions.few.design import Limits, Posterior, expected_errors, places_of, plan
from metapp.extensions.few.network import NETWORK
from metapp.learning.task import Params
from metapp.runs.checkpoints import with_checkpoint
from metapp.runs.options import fit_options
from metapp.runs.run import Run


def plan_brdf(count: int, limits: Limits, before: Pairs, seed: int = 0) -> tuple[Tensor, Tensor, tuple[float, float]]:
    """Choose directions by the model that ships for fits of few samples.

    Args:
        count: of pairs of directions.
        limits: of the instrument.
        before: what was measured, which may be nothing.
        seed: of the candidates.

    Returns:
        Unit vectors to light and detector, [count, 3] each, in the order in which they tell most; the errors x100 over
        all directions that fits are expected to have before these measurements and after them.

    Raises:
        ValueError: no direction is within the limits.
    """
    planned = with_checkpoint(Run.of(fit_options("brdf", "meta", recipe="few", device="cpu", quiet=True)))
    assert planned.checkpoint is not None  # or it would have been refused
    encoder = planned.checkpoint.phi.encoder
    seen = directions_to_full_circle(before.wi, before.wo)
    # before anything is measured, of the first kind: measured materials
    theta = fitted(encoder, seen, before.reflectance) if len(seen) else NETWORK.of_kinds(encoder, torch.zeros(1).long())
    wi, wo = plan(theta, count, limits, seen, Generator().manual_seed(seed))
    every = torch.cat([seen.float(), directions_to_full_circle(wi, wo)])
    posteriors = (Posterior.of(theta, places_of(angles)) for angles in (seen.float(), every))
    first, then = (100 * expected_errors(posterior)["expected"] for posterior in posteriors)
    return wi, wo, (first, then)


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
