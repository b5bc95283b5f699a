"""The decoder of stationary svBRDFs, and the encoder of the gloss that is expected.

Maps are made of noise, or of a quilt of the flash photograph. With quilts, diffuse colour is the quilt's but for what
the network changes, and relief and gloss follow it, so that a stitch of a knit stays a stitch in each map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, pad
from typing_extensions import override

from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.exemplar.exemplar_codec import (
    JUDGED_SEED,
    ExemplarDecoder,
    SummaryEncoder,
    fixed_noise,
    move_tiles,
)
from metapp.learning.task import Batch, Params
from metapp.networks.quilted import enlarge_grid, normalise_quilts

SPECULAR_LOGIT = -3.0  # specular in logits where a network gives 0: about 0.05, as most dielectrics have
LEAST_ROUGHNESS = 0.1  # the roughness of maps is between this and 1
RELIEF_WIDTHS = 1 / 32  # height, in widths of the photo, that 1 in the network's output stands for
DISPLAY_RANGE = (0.02, 0.98)  # display values to which quilts are clamped before logits, which are unbounded
# Rows and columns of cells whose means of the network's output are made equal: a stationary material has no slow
# changes, and a network that reads normalised quilts makes clouds of what is left of the light
SLOW_CELLS = 8
# Numbers of channels of diffuse colour, specular reflectance, roughness and height
LAYER_CHANNELS = (3, 1, 1, 1)


class MaterialAnswer(NamedTuple):
    """Materials, and what losses of fits compare with them.

    Attributes:
        prediction: the maps [T, B, ...].
        height: the height that their normals are of, in texels, [T, B, 1, H, W].
        quilts: the quilts that they are made of, moved alike, display values [T, B, 3, H, W]; None for none.
        expected_gloss: the expected logits of mean specular and roughness, [T, 2]; None if none are expected.
    """

    prediction: Maps
    height: Tensor
    quilts: Tensor | None = None
    expected_gloss: Tensor | None = None


@dataclass(frozen=True)
class MaterialDecoder(ExemplarDecoder[MaterialAnswer]):
    """Materials whose maps tile. The network does not know the place, which keeps highlights out of the maps.

    Attributes:
        expects_gloss: whether fits have a parameter that no step moves, `gloss` [T, 2], expected logits of mean gloss.
    """

    expects_gloss: bool = False

    @override
    def init(self, rng: Generator, count: int) -> Params:
        gloss = {"gloss": torch.zeros(count, 2, device=rng.device)} if self.expects_gloss else {}
        return super().init(rng, count) | gloss

    @override
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> MaterialAnswer:
        width, gloss = self.octaves.octave_size(octave)[1], theta.get("gloss") if self.expects_gloss else None
        if not self.reads_quilts:
            return MaterialAnswer(*decode_maps(self.network(theta, noise), width), None, gloss)
        quilts, network = move_tiles(theta["quilt"].detach(), noise), self.network._replace(finest=octave)
        raw = remove_slow_changes(network(theta, noise[:, :, : network.noise], normalise_quilts(quilts)))
        return MaterialAnswer(*decode_maps(add_quilt(raw, quilts), width), quilts, gloss)

    def generate_fine(self, theta: Params, fine_quilt: Tensor) -> tuple[Maps, Tensor]:
        """Generate the maps of fits of quilts at the resolution of finer quilts.

        Args:
            theta: fits [T, ...].
            fine_quilt: the quilts of the fits, display values [T, 3, H, W] in [0, 1].

        Returns:
            Maps [T, C, H, W], and their height [T, 1, H, W] in texels.
        """
        quilt = theta["quilt"]
        noise = self.shown_noise(quilt)[:, :, : self.network.noise]
        raw = remove_slow_changes(self.network(theta, noise, normalise_quilts(quilt[:, None]))[:, 0])
        return decode_maps(add_quilt(refine_relief(raw, quilt, fine_quilt), fine_quilt), fine_quilt.shape[-1])


@dataclass(frozen=True)
class GlossEncoder(SummaryEncoder):
    """An encoder that predicts the expected gloss, too.

    Without it the gloss of fits at 256 texels takes the place of colour.
    """

    input_names = (*SummaryEncoder.input_names, "shine")

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: Any) -> Params:
        """Shift the mean gloss of General's maps to the gloss that a clear highlight shows, and add it as `gloss`.

        The encoder's input has `shine` [T, 3], the confidence in the highlight, 0 to 1, and the logits of specular and
        roughness that it shows.
        """
        theta, shine = super().__call__(encoder, encoder_input, decoder), encoder_input["shine"]
        gloss, confidence = mean_gloss(decoder, theta), shine[:, :1]
        change = confidence * (shine[:, 1:] - gloss)
        output_shift = decoder.network.output_shift
        return theta | {"gloss": gloss + change, output_shift: theta[output_shift] + pad(change, (3, 1))}


@torch.no_grad()
def mean_gloss(decoder: MaterialDecoder, theta: Params) -> Tensor:
    """Return mean logits of specular and roughness [T, 2] of small maps, from noise that is equal for all tasks."""
    coarsest = decoder.octaves.count - 1
    shape = 1, decoder.noise_channels, *decoder.octaves.octave_size(coarsest)
    maps = decoder.generate(theta, fixed_noise(theta["z"], shape, JUDGED_SEED), coarsest).prediction
    return torch.stack([values.mean((1, 2, 3, 4)) for values in encode_gloss(maps.specular, maps.roughness)], -1)


def decode_maps(raw: Tensor, width: int) -> tuple[Maps, Tensor]:
    """Make maps of a network's output.

    Args:
        raw: three channels of diffuse colour, then specular, roughness and height, before any range is imposed,
            [..., 6, H, W].
        width: the number of texels that stand for the width of the photo.

    Returns:
        Maps [..., C, H, W], and their height [..., 1, H, W] in texels.
    """
    diffuse_raw, specular_raw, roughness_raw, height_raw = raw.split(LAYER_CHANNELS, -3)
    diffuse = torch.sigmoid(diffuse_raw) ** DISPLAY_GAMMA  # so that outputs are about evenly spread for the eye
    specular = torch.sigmoid(specular_raw + SPECULAR_LOGIT)
    roughness = LEAST_ROUGHNESS + (1 - LEAST_ROUGHNESS) * torch.sigmoid(roughness_raw)
    height = RELIEF_WIDTHS * width * height_raw
    return Maps(diffuse, specular, roughness, normal_from_height(height)), height


def unpack_layers(layers: Tensor) -> tuple[Maps, Tensor]:
    """Make maps of layers that were quilted again, and normals of their height.

    Args:
        layers: diffuse display values, specular reflectance, roughness, and height in texels, [6, H, W].

    Returns:
        Maps [C, H, W], and their height [1, H, W] in texels.
    """
    diffuse, specular, roughness, height = layers.split(LAYER_CHANNELS)
    # cubic interpolation overshoots
    diffuse, specular, roughness = diffuse.clamp(0, 1), specular.clamp(0, 1), roughness.clamp(LEAST_ROUGHNESS, 1)
    return Maps(diffuse**DISPLAY_GAMMA, specular, roughness, normal_from_height(height)), height


def encode_gloss(specular: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """Return the logits that the network makes specular and roughness of, for values of any shape."""
    shares = (
        (specular, 1e-9),
        ((roughness - LEAST_ROUGHNESS) / (1 - LEAST_ROUGHNESS), 1e-6),
    )  # torch.logit has one eps for both ends
    # float32 has no 1 - 1e-9
    logits = [share.clamp_min(eps).log() - torch.log1p(-share.clamp_max(1 - 1e-6)) for share, eps in shares]
    return logits[0] - SPECULAR_LOGIT, logits[1]


def remove_slow_changes(values: Tensor) -> Tensor:
    """Remove from maps that tile, [..., C, H, W], changes over more than about 2 / SLOW_CELLS of a side; means stay."""
    maps = values.flatten(0, -4) if values.ndim > 4 else values
    cell_means = adaptive_avg_pool2d(maps, SLOW_CELLS)
    deviations = cell_means - cell_means.mean((-1, -2), keepdim=True)
    return values - enlarge_grid(deviations, maps.shape[-2:]).reshape(values.shape)


def refine_relief(raw: Tensor, quilt: Tensor, fine_quilt: Tensor) -> Tensor:
    """Enlarge raw maps to the size of a finer quilt, and continue the relief in the detail that only the latter shows.

    The finest detail of the height is a factor times the finest detail of brightness, in the least squares; so is the
    detail that is still finer. The factor is near 0 where brightness says nothing of the height.

    Args:
        raw: raw maps of the network, [T, 6, H, W].
        quilt: display values of that size, [T, 3, H, W].
        fine_quilt: the same quilt, finer, [T, 3, H', W'].

    Returns:
        Raw maps [T, 6, H', W'].
    """
    size = (fine_quilt.shape[-2], fine_quilt.shape[-1])
    if size == raw.shape[-2:]:
        return raw
    enlarged = enlarge_grid(raw, size)
    if size[0] < quilt.shape[-2]:
        return enlarged
    height, brightness = (
        values - enlarge_grid(avg_pool2d(values, 2), values.shape[-2:])
        for values in (raw[:, 5:], quilt.mean(1, keepdim=True))
    )
    factor = (height * brightness).sum((-1, -2), keepdim=True) / (
        brightness.square().sum((-1, -2), keepdim=True) + 1e-6
    )
    fine_brightness = fine_quilt.mean(1, keepdim=True)
    detail = fine_brightness - enlarge_grid(
        adaptive_avg_pool2d(fine_brightness, (quilt.shape[-2], quilt.shape[-1])), size
    )
    return torch.cat([enlarged[:, :5], enlarged[:, 5:] + factor * detail], 1)


def add_quilt(raw: Tensor, quilts: Tensor) -> Tensor:
    """Add the logits of quilts [..., 3, H, W], display values, to the diffuse channels of raw maps [..., 6, H, W]."""
    diffuse, others = raw.split((3, 3), -3)
    return torch.cat([diffuse + torch.logit(quilts.clamp(*DISPLAY_RANGE)), others], -3)


def display(linear: Tensor) -> Tensor:
    """Return linear values in [0, 1] as a display of DISPLAY_GAMMA shows them; gradients stay finite."""
    return linear.clamp_min(1e-3) ** (1 / DISPLAY_GAMMA)
