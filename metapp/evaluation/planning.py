"""Which directions of a BRDF to measure, before anything is measured or after some of it is."""

from __future__ import annotations

import math

import torch
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from torch import Generator, Tensor

from data_tools.readers.measured_pairs import MeasuredPairs
from metapp.appearance.geometry import directions_to_full_rusinkiewicz
from metapp.apps.brdf.brdf_network import COUNT_KEY
from metapp.apps.brdf.few.design import InstrumentLimits, Posterior, expected_errors, places_at_angles, plan_directions
from metapp.apps.brdf.few.gaussian_model import FEW_NETWORK, error_slope, ridge_regression
from metapp.evaluation.style import FIGURE_STYLE, MUTED_COLOUR, PARADIGM_COLOURS, place_labels
from metapp.learning.task import Params
from metapp.runs.checkpoint_selection import attach_checkpoint
from metapp.runs.fit_options import fit_options
from metapp.runs.run import Run

MAX_NUMBERED_PAIRS = 32  # pairs up to which a picture numbers each


def plan_brdf(
    count: int, limits: InstrumentLimits, before: MeasuredPairs, seed: int = 0
) -> tuple[Tensor, Tensor, tuple[float, float]]:
    """Choose directions by the model that ships for fits of few samples.

    Args:
        count: of pairs of directions.
        limits: of the instrument.
        before: earlier measurements, or none.
        seed: of the candidates.

    Returns:
        Unit vectors to light and detector, [count, 3] each, in the order in which they tell most; the errors x100 over
        all directions that fits are expected to have before these measurements and after them.

    Raises:
        ValueError: no direction is within the limits.
    """
    run = attach_checkpoint(Run.from_options(fit_options("brdf", "meta", recipe="few", device="cpu", quiet=True)))
    assert run.checkpoint is not None  # or it would have been refused
    encoder = run.checkpoint.phi.encoder
    seen = directions_to_full_rusinkiewicz(before.wi, before.wo)
    # before anything is measured, of the first kind: measured materials
    theta = (
        fit_likeliest_model(encoder, seen, before.reflectance)
        if len(seen)
        else FEW_NETWORK.select_kinds(encoder, torch.zeros(1).long())
    )
    wi, wo = plan_directions(theta, count, limits, seen, Generator().manual_seed(seed))
    every = torch.cat([seen.float(), directions_to_full_rusinkiewicz(wi, wo)])
    posteriors = (Posterior.from_samples(theta, places_at_angles(angles)) for angles in (seen.float(), every))
    first, then = (100 * expected_errors(posterior)["expected"] for posterior in posteriors)
    return wi, wo, (first, then)


def fit_likeliest_model(encoder: Params, angles: Tensor, reflectance: Tensor) -> Params:
    """The likeliest model [1, ...] after samples: angles [N, 3] in rad and reflectance [N, 3] in 1/sr."""
    where = places_at_angles(angles.float())
    target = torch.log1p(reflectance.T[None].float() * where[:, 6:])
    batch = {"where": where, "target": target, COUNT_KEY: torch.tensor([float(len(angles))])}
    theta = FEW_NETWORK.encode(encoder, batch)
    fit = ridge_regression(theta, batch)
    posterior = Posterior.from_samples(theta, where, error_slope(reflectance.T[None].float(), where))
    moment = (fit.residual[0] * fit.weights[0] / len(angles)) @ fit.features[0].T
    change = torch.einsum("cfg,cg->cf", posterior.covariance, moment.double())
    return theta | {"last": theta["last"] + change[None].float()}


def draw_directions(wi: Tensor, wo: Tensor, before: MeasuredPairs) -> Figure:
    """Pairs to measure, unit vectors [N, 3] to light and detector, and those measured before, seen from above."""
    light, detector = PARADIGM_COLOURS["meta"], PARADIGM_COLOURS["overfit"]
    pairs = [(*pair, MUTED_COLOUR, MUTED_COLOUR, "") for pair in zip(before.wi, before.wo, strict=True)]
    for at, pair in enumerate(zip(wi, wo, strict=True), 1):
        pairs.append((*pair, light, detector, str(at) if len(wi) <= MAX_NUMBERED_PAIRS else ""))
    with rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(5.2, 5.6))
        axis = figure.add_subplot(projection="polar")
        assert isinstance(axis, PolarAxes)
        axis.set_rlim(0, 90)
        axis.set_rticks([30, 60, 90], ["30", "60", "90 degrees"])
        axis.set_thetagrids(range(0, 360, 45))
        names: list[tuple[str, tuple[float, float], dict[str, int]]] = []
        for *vectors, first, second, number in pairs:
            (a, r), (b, s) = (
                (math.atan2(y, x), math.degrees(math.acos(min(1.0, z)))) for x, y, z in (v.tolist() for v in vectors)
            )
            axis.plot([a, b], [r, s], color="#c8c8c8", linewidth=0.6, zorder=1)
            axis.plot([a], [r], "o", color=first, markersize=5, zorder=3)
            axis.plot([b], [s], "s", color=second, markersize=4, zorder=2)
            if number:
                names.append((number, (a, r), {"fontsize": 7}))
        axis.plot([], [], "o", color=light, markersize=5, label="light")
        axis.plot([], [], "s", color=detector, markersize=4, label="detector")
        if len(before.wi):
            axis.plot([], [], "o", color=MUTED_COLOUR, markersize=5, label="measured before")
        figure.legend(loc="outside lower center", ncols=3)
        place_labels(axis, names)
    return figure
