"""The roughness that the highlight of a polished surface shows, whatever its pattern.

A highlight of a few px is a small share of a photograph, which features lose. Its fall-off tells the roughness, in the
least of the three channels, where patterns of paint are darkest.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.flash import Maps, positions, tilt
from metapp.appearance.highlight import RINGS, profile
from metapp.apps.svbrdf_nonstationary.maps import raw_roughness
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, dense

SIDE_PX = 256  # of the photograph whose highlight is looked at
SPOT_PX, AROUND_PX = 5, 33  # sides of the squares whose brightness finds the highlight
AROUND = 0.3  # the second's weight
DARK = 0.02  # radiance that is added before logs
NUMBERS = 2 * RINGS + 2
HIDDEN = 32
POLISHED, FLAT = 0.2, 0.017  # roughness and mean sine of tilt (1 degree) below which the highlight decides
SOFTNESS = 0.1  # over how much of their logs


def highlight_of(photos: Tensor) -> Tensor:
    """The fall-off of brightness about the highlight of linear photographs [T, 3, H, W]: [T, NUMBERS]."""
    least = interpolate(photos.clamp(0, 1), (SIDE_PX, SIDE_PX), mode="bilinear").amin(1, keepdim=True)
    spot, around = (avg_pool2d(least, side, 1, side // 2) for side in (SPOT_PX, AROUND_PX))
    brightest = (spot + AROUND * around).flatten(1).argmax(1)
    place = positions(SIDE_PX, SIDE_PX, dtype=least.dtype, device=least.device).flatten(1)[:, brightest].T
    logs = (least + DARK).log()
    means = profile(torch.cat([least, logs], 1), place)[0]
    rings = torch.cat([(means[:, 0] + DARK).log(), means[:, 1]], 1)
    return torch.cat([rings, logs.mean((1, 2, 3))[:, None], place.norm(dim=1, keepdim=True)], 1)


def add_polish(reader: Params, rng: Generator) -> None:
    """Add the random layers of `shown_roughness`, by which no highlight is sharp at first."""
    add_layer(reader, rng, "polish.first", HIDDEN, NUMBERS)
    add_layer(reader, rng, "polish.second", 1, HIDDEN, gain=0.0)


def shown_roughness(reader: Params, highlight: Tensor) -> Tensor:
    """The mean roughness [T] of the materials with highlights as of `highlight_of`."""
    return dense(reader, "polish.second", dense(reader, "polish.first", highlight).tanh())[:, 0].exp()


def raw_shift(shown: Tensor, maps: Maps) -> Tensor:
    """The shift [T] of a field's raw roughness from that of its maps [T, C, h, w] towards that by the highlight.

    All the way where this is far below POLISHED and the maps far flatter than FLAT, else 0: patterns look like wide
    highlights, and glints of relief like sharp ones.
    """
    now = maps.roughness.mean((1, 2, 3))
    polished, flat = POLISHED / shown, FLAT / tilt(maps.normal).mean((1, 2, 3))
    share = torch.sigmoid(polished.log() / SOFTNESS) * torch.sigmoid(flat.log() / SOFTNESS)
    return share * (raw_roughness(shown) - raw_roughness(now))
