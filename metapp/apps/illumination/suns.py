"""The brightest small lights of a map, called suns, in closed form: their directions, light and size.

A network cannot fit a sun in few steps, as it is too small and too bright. So each sun is kept beside the network, as
10 numbers in this order:

- the mean direction of its light, a unit vector (3);
- its light (RGB): its radiance above the background times solid angle, summed over the texels that it covers;
- the mean squared angle between its light and that direction in rad^2 (1);
- the background (RGB), an estimate of the radiance behind it: the mean radiance of the texels that it covers, of which
  none counts with a luminance above SUN_LUMINANCE.

When a map is computed, the background replaces the network's radiance in these texels, and the sun's light is added.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from metapp.appearance.latlong import luminance, solid_angles, texel_directions
from metapp.learning.task import Params, TensorSpec

SUN_COUNT, SUN_NUMBERS = 3, 10  # suns of a map, at most, and numbers of each
# Forms of the parameters that `split_suns` returns, without a task axis; fits by General have none of them.
SUN_SPECS = {
    "suns.angle": TensorSpec((SUN_COUNT, 1), optional=True),
    "suns.level": TensorSpec((SUN_COUNT, 3), optional=True),
    "suns.light": TensorSpec((SUN_COUNT, 3), optional=True),
    "suns.towards": TensorSpec((SUN_COUNT, 3), optional=True),
}
SUN_LUMINANCE = 80.0  # luminance above which texels can belong to a sun, in a map of mean luminance 1
MAX_SUN_RAD = math.radians(2.5)  # root mean square angle; larger lights are no Gaussians, and the network fits them
# A sun replaces all of the network's radiance in texels with 1 / COVER_GAIN of the sun's greatest radiance or more, and
# in dimmer texels a share of it that falls to 0 in proportion to the sun's radiance.
COVER_GAIN = 20.0
MIN_DEVIATION_TEXELS = 0.1  # the least standard deviation of a sun along one axis, in texels


def find_suns(maps: Tensor) -> Tensor:
    """Find the suns of radiance maps.

    Args:
        maps: linear radiance [T, 3, H, W], of mean luminance 1.

    Returns:
        Suns as the module's docstring describes them, [T, SUN_COUNT, SUN_NUMBERS], the brightest first; zeros in place
        of each sun that a map has fewer than SUN_COUNT.
    """
    return torch.stack([_find_map_suns(light.detach().cpu()) for light in maps]).to(maps)


def _find_map_suns(radiance: Tensor) -> Tensor:
    """Find the suns [SUN_COUNT, SUN_NUMBERS] of one radiance map [3, H, W], of mean luminance 1.

    Each connected region of texels above SUN_LUMINANCE is one light, whose direction and size follow from the radiance
    above that luminance. Of the lights that are no larger than MAX_SUN_RAD, the SUN_COUNT brightest are suns. Their
    light and background then follow from the radiance of all texels that they cover.
    """
    brightness = luminance(radiance)
    numbers = torch.zeros(SUN_COUNT, SUN_NUMBERS)
    if not (brightness > SUN_LUMINANCE).any():
        return numbers
    height, width = brightness.shape
    directions, solid_angle = texel_directions(height, width), solid_angles(height, width)
    excess = radiance * (1 - SUN_LUMINANCE / brightness.clamp_min(SUN_LUMINANCE)) * solid_angle
    regions = _label_regions(brightness > SUN_LUMINANCE)
    weights = luminance(excess)
    lights = [_measure_light(weights * (regions == region), directions) for region in range(1, int(regions.max()) + 1)]
    small_lights = [light for light in lights if light.squared_angle <= MAX_SUN_RAD**2]
    for row, light in enumerate(sorted(small_lights, key=lambda light: -light.weight)[:SUN_COUNT]):
        numbers[row, :3], numbers[row, 6] = light.direction, light.squared_angle
    lobes = _rasterise_lobes(numbers[None], height, width)[0]
    cover = _cover_weights(lobes) * solid_angle
    capped_radiance = torch.minimum(radiance, radiance * SUN_LUMINANCE / brightness.clamp_min(1e-9))
    background = torch.einsum("chw,shw->sc", capped_radiance, cover) / cover.sum((1, 2)).clamp_min(1e-12)[:, None]
    sun_light = torch.einsum("chw,shw->sc", radiance, cover) - background * cover.sum((1, 2))[:, None]
    numbers[:, 3:6], numbers[:, 7:] = sun_light.clamp_min(0), background
    return numbers


class _Light(NamedTuple):
    """The strength, size and direction of a light.

    Attributes:
        weight: the sum of the weights of its directions.
        squared_angle: the weighted mean of the squared angle to the mean direction, in rad^2.
        direction: the mean direction, a unit vector [3].
    """

    weight: float
    squared_angle: float
    direction: Tensor


def _measure_light(weights: Tensor, directions: Tensor) -> _Light:
    """Measure the strength, size and direction of a light that consists of weighted directions.

    Args:
        weights: the weight of each direction, [H, W], >= 0 and not all 0.
        directions: unit vectors [3, H, W].
    """
    weights = weights.double()
    vector_sum, weight = torch.einsum("hw,chw->c", weights, directions.double()), float(weights.sum())
    length = float(vector_sum.norm())
    # length / weight is the mean cosine of the angle to the mean direction; for small angles the cosine is
    # 1 - angle^2 / 2. Rounding could make the result negative.
    return _Light(weight, max(2 * (1 - length / weight), 0.0), (vector_sum / length).float())


def _label_regions(is_bright: Tensor) -> Tensor:
    """Find the connected regions of bright texels, and number them.

    Texels that touch at a corner are connected. The left and the right edge of a map are one meridian, so a region may
    go on from one to the other.

    Args:
        is_bright: bool [H, W], True for bright texels.

    Returns:
        For each texel the number of its region, counted from 1, and 0 for texels that are not bright: int64 [H, W].
    """
    labels = torch.arange(1.0, is_bright.numel() + 1).reshape(is_bright.shape) * is_bright
    while True:  # each texel takes the largest label around it, until none changes
        padded = pad(pad(labels[None, None], (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1))
        grown = max_pool2d(padded, 3, stride=1)[0, 0] * is_bright
        if torch.equal(grown, labels):
            break
        labels = grown
    numbers: Tensor = torch.cat([torch.zeros(1), labels.flatten()]).unique(return_inverse=True)[1]
    return numbers[1:].reshape(is_bright.shape)


def _rasterise_lobes(suns: Tensor, height: int, width: int) -> Tensor:
    """Rasterise the lobe of each sun, a Gaussian around its direction, whose width follows from the mean squared angle.

    A lobe is the product of a normal distribution of the polar angle and one of the azimuth: for a small sun, nearly a
    normal distribution of directions.

    Args:
        suns: suns as the module's docstring describes them, [T, SUN_COUNT, SUN_NUMBERS].
        height: rows of the result.
        width: columns of the result.

    Returns:
        The share of each lobe that falls in each texel, [T, SUN_COUNT, height, width]; 0 in all texels where there is
        no sun.
    """
    (x, y, z), exists = suns[..., :3].unbind(2), suns[..., :3].norm(dim=2) > 0
    texel_rad = math.pi / height
    polar, azimuth = torch.acos(y.clamp(-1, 1)), torch.atan2(x, -z) % math.tau
    # The mean squared angle is the sum of the variances along two axes, which are equal.
    deviation, min_deviation = (suns[..., 6] / 2).sqrt(), MIN_DEVIATION_TEXELS * texel_rad
    # An angle across the meridians is a larger azimuth the nearer the sun is to a pole.
    azimuth_deviation = (deviation / polar.sin().clamp_min(1e-3)).clamp(min_deviation, math.tau)
    row_edges = torch.arange(height + 1).to(suns) * texel_rad
    column_edges = torch.arange(width + 1).to(suns) * texel_rad
    row_shares = _normal_shares((row_edges - polar[..., None]) / deviation.clamp_min(min_deviation)[..., None])
    # The left and the right edge of a map are one meridian: a sun near it is drawn at both.
    turns = column_edges.new_tensor([-math.tau, 0, math.tau])[:, None]
    column_shares = _normal_shares(
        (column_edges - azimuth[..., None, None] + turns) / azimuth_deviation[..., None, None]
    ).sum(-2)
    lobes: Tensor = row_shares[..., None] * column_shares[..., None, :] * exists[..., None, None]
    return lobes


def _normal_shares(edges: Tensor) -> Tensor:
    """Return the shares [..., N] of the standard normal distribution in N intervals, given their edges [..., N + 1]."""
    shares: Tensor = torch.special.ndtr(edges).diff(dim=-1)
    return shares


def split_suns(suns: Tensor) -> Params:
    """Split suns [T, SUN_COUNT, SUN_NUMBERS] into parameters of fits, a tensor for each quantity, [T, SUN_COUNT, ...].

    The mean squared angle in rad^2 becomes its root in rad.
    """
    directions, light, squared_angle, background = suns.split((3, 3, 1, 3), 2)
    return {
        "suns.angle": squared_angle.sqrt(),
        "suns.level": background,  # files of fits have this name for it
        "suns.light": light,
        "suns.towards": directions,
    }


def join_suns(theta: Params) -> Tensor:
    """Join the suns [T, SUN_COUNT, SUN_NUMBERS] from the parameters that :func:`split_suns` returns.

    The result has no gradients: the steps of a fit leave suns as they are.
    """
    quantities = theta["suns.towards"], theta["suns.light"], theta["suns.angle"] ** 2, theta["suns.level"]
    return torch.cat(quantities, 2).detach()


def _cover_weights(lobes: Tensor) -> Tensor:
    """Return the shares in [0, 1] by which suns replace the network's radiance in each texel, [..., H, W].

    The share is proportional to the sun's radiance up to 1 / COVER_GAIN of its maximum, and 1 from there on.

    Args:
        lobes: the lobes of the suns, [..., H, W], from :func:`_rasterise_lobes`.
    """
    return (COVER_GAIN * lobes / lobes.amax((-2, -1), keepdim=True).clamp_min(1e-12)).clamp_max(1)


def add_suns(maps: Tensor, suns: Tensor) -> Tensor:
    """Put suns into radiance maps, one after the other in their order, and return the maps [T, 3, H, W].

    In the texels that a sun covers, its background first replaces the radiance; then a lobe is added whose radiance
    times solid angle sums to exactly the sun's light. Where suns overlap, a later sun also replaces what an earlier one
    has added there.

    Args:
        maps: linear radiance [T, 3, H, W].
        suns: suns as the module's docstring describes them, [T, SUN_COUNT, SUN_NUMBERS].
    """
    height, width = maps.shape[-2:]
    lobes = _rasterise_lobes(suns, height, width)
    light, background = suns[..., 3:6], suns[..., 7:]
    lobe_integrals = (lobes * solid_angles(height, width).to(suns)).sum((2, 3)).clamp_min(1e-12)
    for index in range(suns.shape[1]):
        lobe = lobes[:, index, None]
        cover = _cover_weights(lobe)
        maps = torch.lerp(maps, background[:, index, :, None, None].expand_as(maps), cover)
        maps = maps + lobe * (light[:, index] / lobe_integrals[:, index, None])[..., None, None]
    return maps
