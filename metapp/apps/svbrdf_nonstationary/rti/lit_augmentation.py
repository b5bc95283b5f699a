"""Photographs under lamps that training sees: some of a dome's lamps, turned, at another exposure, with errors."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.apps.svbrdf_nonstationary.map_judge import TrueMaps
from metapp.apps.svbrdf_nonstationary.rti.curve_network import LitTexels
from metapp.apps.svbrdf_nonstationary.rti.light_curves import curve_weights
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Tasks

SIDE = 32  # side in texels of what is drawn; they are chosen at random, since networks read each by itself
LAMP_COUNTS = (12, 72)  # the least and the greatest number of lamps
LAMP_ERROR = 0.015  # deviation of stated directions along each axis
EXPOSURES = (0.6, 1.5)  # factors of linear values
LAMP_GAIN = 0.04  # deviation of the log of how bright lamps are


def draw_lit_texels(tasks: Tasks, rng: Generator) -> tuple[LitTexels, TrueMaps]:
    """Draw texels of training tasks under some of their lamps.

    Returns:
        What fits see, of SIDE^2 texels, and their maps, [T, 10, SIDE, SIDE].
    """
    data, rows, count = tasks.data, tasks.rows, len(tasks)
    total = data["lamps"].shape[1]
    fewest, most = (min(number, total) for number in LAMP_COUNTS)
    lamp_count = int(torch.randint(fewest, most + 1, (), generator=rng))
    texels = torch.stack(
        [torch.randperm(data["numbers"].shape[-1], generator=rng)[: SIDE * SIDE] for _ in range(count)]
    )
    lamps = data["lamps"][rows]
    # some domes have more of their lamps high up, and others low
    scores = draw_uniform(rng, count, total) + 0.7 * draw_normal(rng, count, 1) * lamps[..., 2]
    chosen = scores.topk(lamp_count, 1).indices
    lamps = lamps.gather(1, chosen[..., None].expand(-1, -1, 3))
    colours = torch.stack(
        [data["colours"][row, lamp][..., texel] for row, lamp, texel in zip(rows, chosen, texels, strict=True)]
    )
    maps = torch.stack([data["maps"][row].flatten(1)[:, texel] for row, texel in zip(rows, texels, strict=True)])
    turn = _draw_turns(rng, count)
    low, high = map(math.log, EXPOSURES)
    exposure = (low + (high - low) * draw_uniform(rng, count, 1, 1, 1)).exp()
    gain = exposure * (LAMP_GAIN * draw_normal(rng, count, lamp_count, 1, 1)).exp()
    linear = (srgb_to_linear(colours.float() / 255) * gain).clamp(0, 1)
    colours = (linear_to_srgb(linear) * 255).round().to(torch.uint8)
    normal, diffuse, roughness, specular = maps.split((3, 3, 1, 3), 1)
    exposed = ((colour * exposure[..., 0]).clamp(0, 1) for colour in (diffuse, specular))
    diffuse, specular = exposed
    turned = torch.cat([turn @ normal, diffuse, roughness, specular], 1).unflatten(-1, (SIDE, SIDE))
    stated = normalize(lamps @ turn.mT + LAMP_ERROR * draw_normal(rng, count, lamp_count, 3), dim=-1)
    weights = torch.stack([curve_weights(task_lamps) for task_lamps in stated])
    photo = linear.mean(1).unflatten(-1, (SIDE, SIDE))
    numbers = torch.arange(SIDE * SIDE).expand(count, -1)
    return LitTexels(photo, colours, stated, weights, numbers), TrueMaps(turned, maps.new_ones(count, 4))


def _draw_turns(rng: Generator, count: int) -> Tensor:
    """Draw rotations about z, half of them with a reflection, [count, 3, 3]."""
    turn_rad = 2 * math.pi * draw_uniform(rng, count)
    mirror = 1 - 2 * (draw_uniform(rng, count) < 0.5).float()
    zero, one = torch.zeros_like(turn_rad), torch.ones_like(turn_rad)
    rows = [
        [turn_rad.cos(), -turn_rad.sin() * mirror, zero],
        [turn_rad.sin(), turn_rad.cos() * mirror, zero],
        [zero, zero, one],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
