"""Baselines of mirror balls: what they show and nothing else, and their clipped light put back as one Gaussian."""

from __future__ import annotations

import functools

import torch
from torch import Generator, Tensor

from metapp.appearance.latlong import directions, mean_luminance, solid_angles
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.mirror import photographed, raised
from metapp.extensions.baselines.baseline import Allowed, BaselineFit, PreparedBaseline, Training
from metapp.learning.task import Batch, Tasks

GAIN = "light over what clips"


def unwrapped(training: Training, allowed: Allowed) -> PreparedBaseline:
    """The light that a mirror shows; behind it what is before it, and where it clips the light of the clip."""
    return PreparedBaseline(functools.partial(_fit, gain=0.0))


def gaussian(training: Training, allowed: Allowed) -> PreparedBaseline:
    """The same, with the light that training photographs lose on average where they clip."""
    assert isinstance(training.app, Illumination)
    maps = training.holding("map").stacked.data["map"]
    _, mirrored = photographed(maps, Generator().manual_seed(0), 64)
    lost = _clipped(raised(maps, mirrored), mirrored) / _clipped(mirrored["seen"], mirrored).clamp_min(1e-9)
    some = lost[lost > 0]
    gain = float(some.log().mean().exp()) if len(some) else 1.0
    return PreparedBaseline(functools.partial(_fit, gain=max(gain - 1, 0.0)), shared=4, chosen={GAIN: gain})


def _fit(tasks: Tasks, rng: Generator, allowed: Allowed, *, gain: float) -> BaselineFit:
    data = {key: tasks.data[key][tasks.rows] for key in ("seen", "certain")}
    for name, certain in zip(tasks.picked_names, data["certain"], strict=True):
        if not certain.any():
            raise ValueError(f"{name}: a photo of a glossy sphere, expected a mirror ball's; try --method nearest.")
    numbers = 5 * data["seen"][0, 0].numel()
    return BaselineFit(lambda: answer(data, gain), numbers, 2 * numbers)


def answer(data: Batch, gain: float) -> Tensor:
    """Maps [T, 3, H, W] of what mirrors show.

    Args:
        data: `seen` [T, 3, H, W] and `certain` [T, 2, H, W].
        gain: of the light where they clip, how much is added to it, as a Gaussian of its mean direction and spread.
    """
    seen, share = data["seen"], data["certain"].sum(1, keepdim=True)
    behind = seen.flip(-1).roll(seen.shape[-1] // 2, -1)
    there = share.flip(-1).roll(seen.shape[-1] // 2, -1)
    mean = (mean_luminance(seen * share) / mean_luminance(share.expand_as(seen)).clamp_min(1e-6))[:, None, None, None]
    maps = torch.lerp(torch.lerp(mean, behind, there), seen, share)
    return maps + gain * _lobe(data) if gain else maps


def _lobe(data: Batch) -> Tensor:
    """The light of what clips as one Gaussian of angles, [T, 3, H, W]."""
    height, width = data["seen"].shape[-2:]
    area = solid_angles(height, width).to(data["seen"])
    clipped = data["certain"][:, 1] * area
    towards = directions(height, width).to(clipped)
    mean = torch.einsum("thw,chw->tc", clipped, towards)
    share = clipped.sum((1, 2)).clamp_min(1e-9)
    length = mean.norm(dim=1)
    # mean of the squared angle to the mean direction, and that of a texel
    spread = 2 * (1 - length / share).clamp_min(0) + (torch.pi / height) ** 2 / 6
    near = torch.einsum("tc,chw->thw", mean / length.clamp_min(1e-9)[:, None], towards)
    lobe = ((near - 1) * 2 / spread[:, None, None]).exp()
    light = torch.einsum("thw,tchw->tc", clipped, data["seen"])
    result: Tensor = (lobe / (lobe * area).sum((1, 2), keepdim=True))[:, None] * light[..., None, None]
    return result


def _clipped(maps: Tensor, data: Batch) -> Tensor:
    return mean_luminance(maps * data["certain"][:, 1:])
