"""The choice of directions in which to measure a BRDF, before anything is measured or after some directions are.

The module joins the model of fits of few samples (:mod:`metapp.apps.brdf.few`) with the checkpoint that ships for it.
Nothing here reads or writes a user's file.
"""

from __future__ import annotations

import math

import torch
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from torch import Generator, Tensor

from data_tools.readers.measured_pairs import MeasuredPairs
from metapp.appearance.geometry import directions_to_full_rusinkiewicz
from metapp.apps.brdf.brdf_network import DistinctSamples
from metapp.apps.brdf.few.design import InstrumentLimits, Posterior, expected_errors, places_at_angles, plan_directions
from metapp.apps.brdf.few.gaussian_model import FEW_NETWORK, error_slope, ridge_regression
from metapp.evaluation.style import FIGURE_STYLE, MUTED_COLOUR, PARADIGM_COLOURS, place_labels
from metapp.learning.task import Params
from metapp.storage.checkpoint_files import read_entry
from metapp.storage.shipped_checkpoints import shipped_checkpoint_path

MAX_NUMBERED_PAIRS = 32  # pairs of directions; a picture of more pairs has no numbers


def plan_brdf(
    count: int, limits: InstrumentLimits, measurements: MeasuredPairs, seed: int = 0
) -> tuple[Tensor, Tensor, tuple[float, float]]:
    """Choose the pairs of directions that tell most about a BRDF, by the model that ships for fits of few samples.

    Args:
        count: the number of pairs of directions to choose.
        limits: the directions that the instrument can reach.
        measurements: earlier measurements, or none.
        seed: the seed by which candidate directions are drawn.

    Returns:
        Unit vectors to the light and to the detector, [count, 3] each, the most informative pair first; and the errors
        x100 over all directions that fits are expected to have before these measurements and after them.

    Raises:
        ValueError: no direction is within the limits.
    """
    encoder = read_entry(shipped_checkpoint_path("brdf", "few"), "ridge")[0].encoder
    measured_angles = directions_to_full_rusinkiewicz(measurements.wi, measurements.wo)
    # without measurements the prior of kind 0 holds, which was learned from measured materials
    theta = (
        fit_likeliest_model(encoder, measured_angles, measurements.reflectance)
        if len(measured_angles)
        else FEW_NETWORK.select_kinds(encoder, torch.zeros(1).long())
    )
    wi, wo = plan_directions(theta, count, limits, measured_angles, Generator().manual_seed(seed))
    all_angles = torch.cat([measured_angles.float(), directions_to_full_rusinkiewicz(wi, wo)])
    posteriors = (
        Posterior.from_samples(theta, places_at_angles(angles)) for angles in (measured_angles.float(), all_angles)
    )
    error_before, error_after = (100 * expected_errors(posterior)["expected"] for posterior in posteriors)
    return wi, wo, (error_before, error_after)


def fit_likeliest_model(encoder: Params, angles: Tensor, reflectance: Tensor) -> Params:
    """Fit the most probable model to samples of one material.

    Args:
        encoder: the prior, as its checkpoint has it.
        angles: half-difference angles of the samples, [N, 3] in rad.
        reflectance: the samples, [N, 3] in 1/sr.

    Returns:
        The parameters of the model, [1, ...].
    """
    where = places_at_angles(angles.float())
    target = torch.log1p(reflectance.T[None].float() * where[:, 6:])
    samples = DistinctSamples(where, target, torch.tensor([float(len(angles))]))
    theta = FEW_NETWORK.encode(encoder, samples._asdict())
    fit = ridge_regression(theta, samples)
    posterior = Posterior.from_samples(theta, where, error_slope(reflectance.T[None].float(), where))
    moment = (fit.residual[0] * fit.weights[0] / len(angles)) @ fit.features[0].T
    change = torch.einsum("cfg,cg->cf", posterior.covariance, moment.double())
    return theta | {"last": theta["last"] + change[None].float()}


def draw_directions(wi: Tensor, wo: Tensor, measurements: MeasuredPairs) -> Figure:
    """Draw pairs of directions as seen from above the surface.

    Args:
        wi: unit vectors to the light of the pairs to measure, [N, 3].
        wo: unit vectors to the detector of the pairs to measure, [N, 3].
        measurements: pairs that were measured before, which are drawn in grey.
    """
    light_colour, detector_colour = PARADIGM_COLOURS["meta"], PARADIGM_COLOURS["overfit"]
    with rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(5.2, 5.6))
        axis = figure.add_subplot(projection="polar")
        assert isinstance(axis, PolarAxes)
        axis.set_rlim(0, 90)
        axis.set_rticks([30, 60, 90], ["30", "60", "90 degrees"])
        axis.set_thetagrids(range(0, 360, 45))
        _draw_pairs(axis, measurements.wi, measurements.wo, MUTED_COLOUR, MUTED_COLOUR)
        light_places = _draw_pairs(axis, wi, wo, light_colour, detector_colour)
        axis.plot([], [], "o", color=light_colour, markersize=5, label="light")
        axis.plot([], [], "s", color=detector_colour, markersize=4, label="detector")
        if len(measurements.wi):
            axis.plot([], [], "o", color=MUTED_COLOUR, markersize=5, label="measured before")
        figure.legend(loc="outside lower center", ncols=3)
        if len(wi) <= MAX_NUMBERED_PAIRS:
            numbered_places = enumerate(light_places, 1)
            place_labels(axis, [(str(number), place, {"fontsize": 7}) for number, place in numbered_places])
    return figure


def _draw_pairs(
    axis: PolarAxes, wi: Tensor, wo: Tensor, light_colour: str, detector_colour: str
) -> list[tuple[float, float]]:
    """Draw pairs of directions, [N, 3] each, joined by lines.

    All pairs are three objects of the figure: an object for each pair would take minutes to draw.

    Returns:
        The places of the lights: azimuth in rad, and degrees from the normal.
    """
    azimuths = torch.stack([torch.atan2(vectors[:, 1], vectors[:, 0]) for vectors in (wi, wo)])
    polar_degrees = torch.stack([torch.rad2deg(vectors[:, 2].clamp(max=1).acos()) for vectors in (wi, wo)])
    gaps = torch.full_like(azimuths[:1], math.nan)  # between lines
    lines = (torch.cat([values, gaps]).T.reshape(-1).numpy() for values in (azimuths, polar_degrees))
    axis.plot(*lines, color="#c8c8c8", linewidth=0.6, zorder=1)
    axis.plot(azimuths[0].numpy(), polar_degrees[0].numpy(), "o", color=light_colour, markersize=5, zorder=3)
    axis.plot(azimuths[1].numpy(), polar_degrees[1].numpy(), "s", color=detector_colour, markersize=4, zorder=2)
    return list(zip(azimuths[0].tolist(), polar_degrees[0].tolist(), strict=True))
