"""The roughness that the highlight of a polished surface shows, whatever its pattern.

A highlight of a few px is a small share of a photograph, which features lose. Its fall-off tells the roughness, in the
least of the three channels, where patterns of paint are darkest.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.flash import camera_distance, texel_positions
from metapp.appearance.highlight import PROFILE_RINGS, ring_profile
from metapp.appearance.svbrdf_maps import Maps, tilt_sine
from metapp.apps.svbrdf_nonstationary.maps import encode_roughness
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, apply_dense

SIDE_PX = 256  # side of the photograph in which the highlight is searched for
SPOT_PX, AROUND_PX = 5, 33  # sides of the two squares whose mean brightness finds the highlight
AROUND_WEIGHT = 0.3  # weight of the larger square beside 1 for the smaller one
LOG_FLOOR = 0.02  # radiance, 1 is white, that is added before logs
HIGHLIGHT_NUMBERS = 2 * PROFILE_RINGS + 2  # numbers that describe a highlight
HIDDEN_UNITS = 32  # units of the hidden layer of the network that predicts roughness
# Roughness, and mean sine of the tilt of normals (1 degree), below which the highlight decides the roughness
POLISHED_ROUGHNESS, FLAT_SINE = 0.2, 0.017
LOG_SOFTNESS = 0.1  # range of the logs of both in which the decision changes


def describe_highlight(photos: Tensor) -> Tensor:
    """Describe how highlights of linear photographs [T, 3, H, W] fall off: [T, HIGHLIGHT_NUMBERS]."""
    least_channel = interpolate(photos.clamp(0, 1), (SIDE_PX, SIDE_PX), mode="bilinear").amin(1, keepdim=True)
    spot, around = (avg_pool2d(least_channel, side, 1, side // 2) for side in (SPOT_PX, AROUND_PX))
    brightest = (spot + AROUND_WEIGHT * around).flatten(1).argmax(1)
    texels = texel_positions(SIDE_PX, SIDE_PX, dtype=least_channel.dtype, device=least_channel.device)
    highlight_place = texels.flatten(1)[:, brightest].T
    logs = (least_channel + LOG_FLOOR).log()
    means = ring_profile(torch.cat([least_channel, logs], 1), highlight_place)[0]
    rings = torch.cat([(means[:, 0] + LOG_FLOOR).log(), means[:, 1]], 1)
    return torch.cat([rings, logs.mean((1, 2, 3))[:, None], highlight_place.norm(dim=1, keepdim=True)], 1)


def add_highlight_reader(reader: Params, rng: Generator) -> None:
    """Add random layers for `predict_roughness`; with them no highlight is sharp at first."""
    add_layer(reader, rng, "polish.first", HIDDEN_UNITS, HIGHLIGHT_NUMBERS)
    add_layer(reader, rng, "polish.second", 1, HIDDEN_UNITS, gain=0.0)


def predict_roughness(reader: Params, highlight: Tensor) -> Tensor:
    """Predict the mean roughness [T] of materials from what `describe_highlight` returns, [T, HIGHLIGHT_NUMBERS]."""
    return apply_dense(reader, "polish.second", apply_dense(reader, "polish.first", highlight).tanh())[:, 0].exp()


def scale_roughness(shown: Tensor, height: Tensor) -> Tensor:
    """Scale the roughness [T] that highlights show to cameras and flashes at known heights, [T].

    A highlight is as wide as alpha of GGX, the square of roughness, times the height. Where the height is 0, it is
    unknown, and the roughness stays.
    """
    return torch.where(height > 0, shown * (camera_distance() / height.clamp_min(1e-6)).sqrt(), shown)


def roughness_shift(shown: Tensor, maps: Maps, height: Tensor) -> Tensor:
    """Return the shift [T] of unbounded roughness that moves maps to the roughness which the highlight shows.

    It goes all the way where that is far below POLISHED_ROUGHNESS and the maps are far flatter than FLAT_SINE, else it
    is 0: patterns look like wide highlights, and glints of relief like sharp ones.

    Args:
        shown: the roughness that `predict_roughness` returns, [T].
        maps: the maps [T, C, h, w].
        height: heights of cameras in half sides of the patch, [T], 0 where they are not known.
    """
    mean_roughness = maps.roughness.mean((1, 2, 3))
    polished, flatness = POLISHED_ROUGHNESS / shown, FLAT_SINE / tilt_sine(maps.normal).mean((1, 2, 3))
    share = torch.sigmoid(polished.log() / LOG_SOFTNESS) * torch.sigmoid(flatness.log() / LOG_SOFTNESS)
    return share * (encode_roughness(scale_roughness(shown, height)) - encode_roughness(mean_roughness))
