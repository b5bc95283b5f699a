"""The decoder of maps from light curves: a small network that reads each texel by itself.

The network's weights are the parameters of a fit. It corrects the normal and the albedo of least squares; with a last
layer of zeros it answers these.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, Flash, decode_flash
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps, encode_diffuse
from metapp.apps.svbrdf_nonstationary.photographed_maps import MaterialDecoder
from metapp.apps.svbrdf_nonstationary.rti.light_curves import TEXEL_INPUTS, TexelReading, read_texels
from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params

WIDTH = 128  # channels of the hidden layers
INPUTS = TEXEL_INPUTS + 2 + 3  # a light curve, and slopes and albedo by least squares
OUTPUT_SCALE = 0.5  # of the network's outputs, which are added to raw parameters
TEXELS_AT_ONCE = 65_536  # that are decoded at a time where no gradient is asked for


class LitTexels(NamedTuple):
    """Texels of photographs under lamps, as fits see them.

    Attributes:
        photo: the linear mean photograph, [T, 3, H, W].
        colours: the values of texels under all lamps, sRGB uint8 [T, N, 3, P].
        lamps: unit vectors towards the lamps, [T, N, 3].
        weights: the weights of photographs in light curves, [T, CURVE_DIRECTIONS, N].
        numbers: the numbers of the texels among the H W of the photographs, [T, P].
    """

    photo: Tensor
    colours: Tensor
    lamps: Tensor
    weights: Tensor
    numbers: Tensor


class TexelAnswer(NamedTuple):
    """Maps of texels that a network read from light curves.

    Attributes:
        maps: the maps, [T, C, P, 1], or [T, C, H, W].
        flash: a light straight above; see :meth:`flash_of_each_photo`.
    """

    maps: Maps
    flash: Flash

    def flash_of_each_photo(self) -> list[Flash]:
        """Return no flash: photographs under distant lamps are predicted by other photographs, not by renderings."""
        return []


@dataclass(frozen=True)
class CurveNetwork(MaterialDecoder[TexelAnswer, LitTexels]):
    """The decoder of maps that a network reads from light curves.

    Attributes:
        side: the side in texels of training tasks.
    """

    side: int = 64

    @property
    @override
    def size(self) -> tuple[int, int]:
        return self.side, self.side

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random hidden layers, and a last one of zeros: `<layer>.kernel` [T, outputs, inputs] and `.shift`."""
        theta: Params = {}
        for name, inputs, outputs, gain in (
            ("first", INPUTS, WIDTH, 2.0),
            ("second", WIDTH, WIDTH, 2.0),
            ("last", WIDTH, sum(CHANNELS), 0.0),
        ):
            theta[f"{name}.kernel"] = draw_normal(rng, count, outputs, inputs) * (gain / inputs) ** 0.5
            theta[f"{name}.shift"] = torch.zeros(count, outputs, device=rng.device)
        return theta

    @override
    def __call__(self, theta: Params, seen: LitTexels) -> TexelAnswer:
        if torch.is_grad_enabled() or seen.colours.shape[-1] <= TEXELS_AT_ONCE:
            return answer_of(_decode_texels(theta, seen.colours, seen))
        parts = [_decode_texels(theta, colours, seen) for colours in seen.colours.split(TEXELS_AT_ONCE, -1)]
        return answer_of(Maps(*(torch.cat(maps, -2) for maps in zip(*parts, strict=True))))

    @override
    def decode(self, theta: Params, photo: Tensor, cameras: Tensor) -> TexelAnswer:
        raise NotImplementedError  # maps need all photographs; see `RtiApp.decode`


def _decode_texels(theta: Params, colours: Tensor, seen: LitTexels) -> Maps:
    """Return the maps [T, C, P, 1] of some texels' values, sRGB uint8 [T, N, 3, P], under the lamps of what is seen."""
    with torch.no_grad():
        reading = read_texels(colours, seen.lamps, seen.weights)
    return decode_maps(correct_reading(theta, reading)[..., None])


def correct_reading(theta: Params, reading: TexelReading) -> Tensor:
    """Return the raw parameters of maps, [T, 9, P], see :func:`decode_maps`, of networks [T, ...]."""
    albedo = encode_diffuse(reading.albedo)
    x = torch.cat([reading.curves, reading.slopes, albedo / 4], 1)
    for name in ("first", "second"):
        x = gelu(torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.kernel"], x))
    correction = torch.baddbmm(theta["last.shift"][..., None], theta["last.kernel"], x)
    rest = torch.zeros_like(correction[:, : CHANNELS[2] + CHANNELS[3]])
    return torch.cat([reading.slopes, albedo, rest], 1) + OUTPUT_SCALE * correction


def answer_of(maps: Maps) -> TexelAnswer:
    """Return maps as an answer."""
    return TexelAnswer(maps, decode_flash(maps.diffuse.new_zeros(len(maps.diffuse), FLASH_NUMBERS)))
