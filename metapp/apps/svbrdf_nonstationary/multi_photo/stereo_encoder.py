"""General's encoder of several flash photographs: maps of each texel, and the scales of their errors.

It corrects the maps of photometric stereo. A small network reads each photograph by itself; the mean and the maximum of
its outputs over photographs do not depend on their order. A U-Net over texels reads these.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, leaky_relu
from typing_extensions import override

from metapp.apps.svbrdf_nonstationary.encoder import (
    ENCODER_LEAKY_SLOPE,
    add_block,
    apply_block,
    apply_pointwise,
    upsample,
)
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps
from metapp.apps.svbrdf_nonstationary.multi_photo.flash_gains import estimate_flashes
from metapp.apps.svbrdf_nonstationary.multi_photo.parallax import RELIEF_CHANNELS
from metapp.apps.svbrdf_nonstationary.multi_photo.photo_set_sight import SeenPhotos
from metapp.apps.svbrdf_nonstationary.multi_photo.stereo import PHOTO_INPUTS, TEXEL_INPUTS, Reading, read_stereo
from metapp.apps.svbrdf_nonstationary.multi_photo.texel_maps import TexelMaps
from metapp.learning.components import Encoder
from metapp.learning.task import Batch, Params
from metapp.networks.layers import add_layer, apply_convolution

STEM_CHANNELS = 32  # channels of the network that reads a photograph
WIDTHS = (32, 48, 64, 96, 96)  # channels of the U-Net's levels; sides are multiples of 16 texels


def init(rng: Generator) -> Params:
    """Draw random parameters of the network."""
    params: Params = {}
    add_random_layer = functools.partial(add_layer, params, rng)
    texel_channels = 2 * STEM_CHANNELS + TEXEL_INPUTS + RELIEF_CHANNELS
    add_random_layer("stem.first", STEM_CHANNELS, PHOTO_INPUTS, 3, 3)
    add_random_layer("stem.second", STEM_CHANNELS, STEM_CHANNELS)
    for level, (inputs, outputs) in enumerate(zip((texel_channels, *WIDTHS), WIDTHS)):  # noqa: B905
        add_block(params, rng, f"down{level}", inputs, outputs)
    for level in reversed(range(len(WIDTHS) - 1)):
        add_block(params, rng, f"up{level}", WIDTHS[level + 1] + WIDTHS[level], WIDTHS[level])
    add_random_layer("maps", sum(CHANNELS) + 2, WIDTHS[0] + texel_channels, gain=0.1)
    add_random_layer("deviation", len(CHANNELS), WIDTHS[0] + texel_channels, gain=0.1)
    return params


def predict_maps(params: Params, reading: Reading, relief: Tensor) -> tuple[Tensor, Tensor]:
    """Predict maps and the scales of their errors.

    Args:
        params: the parameters that `init` draws.
        reading: the solution by photometric stereo, which `stereo.read_stereo` returns.
        relief: what parallax tells of heights, [T, RELIEF_CHANNELS, H, W].

    Returns:
        Unbounded numbers of maps, [T, 9, H, W], and the logs of the scales of errors of slopes, diffuse colour,
        roughness and specular colour, [T, 4, H, W].
    """
    leading = reading.photos.shape[:2]
    x = reading.photos.flatten(0, 1).contiguous(memory_format=torch.channels_last)
    x = leaky_relu(apply_convolution(params, "stem.first", x), ENCODER_LEAKY_SLOPE)
    x = leaky_relu(apply_pointwise(params, "stem.second", x), ENCODER_LEAKY_SLOPE).unflatten(0, leading)
    texel_inputs = torch.cat([x.mean(1), x.amax(1), reading.texels, relief], 1)
    texel_inputs = texel_inputs.contiguous(memory_format=torch.channels_last)
    x, skips = texel_inputs, []
    for level in range(len(WIDTHS)):
        x = apply_block(params, f"down{level}", avg_pool2d(x, 2) if level else x)
        skips.append(x)
    for level in reversed(range(len(WIDTHS) - 1)):
        x = apply_block(params, f"up{level}", torch.cat([upsample(x), skips[level]], 1))
    x = torch.cat([x, texel_inputs], 1)
    # checkpoints have one more channel, which is not used
    change, gate, _ = apply_pointwise(params, "maps", x).split((sum(CHANNELS), 1, 1), 1)
    slopes, others = reading.maps.split((CHANNELS[0], sum(CHANNELS[1:])), 1)
    slopes = 2 * torch.sigmoid(gate) * slopes + 0.5 * change[:, : CHANNELS[0]]
    maps = torch.cat([slopes, others + 2 * change[:, CHANNELS[0] :]], 1)
    return maps, apply_pointwise(params, "deviation", x).clamp(-8, 4)


@dataclass(frozen=True)
class StereoEncoder(Encoder[SeenPhotos]):
    """The encoder of several photographs: a network that corrects photometric stereo."""

    @override
    def init(self, rng: Generator, decoder: TexelMaps) -> Params:
        return init(rng)

    @override
    def select_input(self, seen: SeenPhotos) -> Batch:
        """Return `photos`, `places` and `relief`; see :class:`SeenPhotos`."""
        return {"photos": seen.photos, "places": seen.places, "relief": seen.relief}

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: TexelMaps) -> Params:
        """Return General's maps, the flashes whose brightness agrees with them, and these maps as the prior."""
        reading = read_stereo(encoder_input["photos"], encoder_input["places"])
        maps, log_scales = predict_maps(encoder, reading, encoder_input["relief"])
        # General predicts one scale for each kind of map: all numbers of that kind share it.
        expanded_scales = [
            log_scale.expand(-1, count, -1, -1)
            for log_scale, count in zip(log_scales.split(1, 1), CHANNELS, strict=True)
        ]
        return {
            "maps": maps,
            "flash": estimate_flashes(decode_maps(maps), encoder_input["photos"], encoder_input["places"]),
            "falloff": maps.new_zeros(len(maps), 1),
            "prior": torch.cat([maps, *expanded_scales], 1),
        }
