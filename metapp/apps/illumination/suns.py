"""The brightest lights of a map in closed form: their directions, light and size.

A network cannot fit a sun in few steps, as it is too small and too bright. So it is kept as 10 numbers: the mean
direction of its light (3 numbers); its light, which is radiance above the background times solid angle (RGB); the mean
squared angle to that direction in rad^2 (1); and the background, the radiance behind it (RGB): a mean over the texels
that it covers, whose luminance is capped. There the background replaces the network's radiance.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from metapp.appearance.latlong import luminance, solid_angles, texel_directions
from metapp.learning.task import Params

SUN_COUNT, SUN_NUMBERS = 3, 10  # suns of a map, and numbers of each
SUN_LUMINANCE = 80.0  # luminance from which texels of a map of mean luminance 1 belong to a sun
MAX_SUN_RAD = math.radians(2.5)  # root mean square angle; larger lights are no Gaussians, and the network fits them
COVER_GAIN = 20.0  # a sun replaces the network's radiance where it has 1 / COVER_GAIN of its greatest radiance or more
MIN_DEVIATION_TEXELS = 0.1  # the least standard deviation of a sun along one axis, in texels


def find_suns(maps: Tensor) -> Tensor:
    """Find the suns of maps [T, 3, H, W] of mean luminance 1: [T, SUN_COUNT, SUN_NUMBERS], zeros if there are fewer."""
    return torch.stack([_find_map_suns(light.detach().cpu()) for light in maps]).to(maps)


def _find_map_suns(radiance: Tensor) -> Tensor:
    """Find the suns [SUN_COUNT, SUN_NUMBERS] of one radiance map [3, H, W]."""
    brightness = luminance(radiance)
    numbers = torch.zeros(SUN_COUNT, SUN_NUMBERS)
    if not (brightness > SUN_LUMINANCE).any():
        return numbers
    height, width = brightness.shape
    directions, solid_angle = texel_directions(height, width), solid_angles(height, width)
    excess = radiance * (1 - SUN_LUMINANCE / brightness.clamp_min(SUN_LUMINANCE)) * solid_angle
    regions = _label_regions(brightness > SUN_LUMINANCE)
    weights = luminance(excess)
    suns = [_measure_light(weights * (regions == region), directions) for region in range(1, int(regions.max()) + 1)]
    small_suns = sorted((sun for sun in suns if sun[1] <= MAX_SUN_RAD**2), key=lambda sun: -sun[0])[:SUN_COUNT]
    for number, (_, squared_angle, mean) in enumerate(small_suns):
        numbers[number, :3], numbers[number, 6] = mean, squared_angle
    lobes = _draw_lobes(numbers[None], height, width)[0]
    cover = _cover_weights(lobes) * solid_angle
    capped_radiance = torch.minimum(radiance, radiance * SUN_LUMINANCE / brightness.clamp_min(1e-9))
    background = torch.einsum("chw,shw->sc", capped_radiance, cover) / cover.sum((1, 2)).clamp_min(1e-12)[:, None]
    sun_light = torch.einsum("chw,shw->sc", radiance, cover) - background * cover.sum((1, 2))[:, None]
    numbers[:, 3:6], numbers[:, 7:] = sun_light.clamp_min(0), background
    return numbers


def _measure_light(weights: Tensor, directions: Tensor) -> tuple[float, float, Tensor]:
    """Measure the extent of a light that is given as weights [H, W] of directions [3, H, W].

    Returns:
        The sum of weights, their mean squared angle to their mean direction in rad^2, and this direction, [3].
    """
    mean, light = torch.einsum("hw,chw->c", weights.double(), directions.double()), float(weights.double().sum())
    length = float(mean.norm())
    return light, max(2 * (1 - length / light), 0.0), (mean / length).float()


def _label_regions(is_bright: Tensor) -> Tensor:
    """Return the connected regions of a mask [H, W] numbered from 1, int64; all other texels are 0.

    The left and the right edge of a map are one meridian, so a region may go on from one to the other.
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


def _draw_lobes(suns: Tensor, height: int, width: int) -> Tensor:
    """Draw a Gaussian around each sun, [T, SUN_COUNT, height, width]: the share of it that falls in each texel.

    A Gaussian is a product of normal distributions of the polar angle and the azimuth: for a small sun, nearly a normal
    distribution of directions. For a sun that does not exist all shares are 0.

    Args:
        suns: suns as the module's docstring describes them, [T, SUN_COUNT, SUN_NUMBERS].
        height: rows of the result.
        width: columns of the result.
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
        "suns.level": background,
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
    """Return the shares in [0, 1] by which suns replace the network's radiance, given their lobes, [..., H, W] both."""
    return (COVER_GAIN * lobes / lobes.amax((-2, -1), keepdim=True).clamp_min(1e-12)).clamp_max(1)


def add_suns(maps: Tensor, suns: Tensor) -> Tensor:
    """Add suns to radiance maps, and return the maps [T, 3, H, W].

    The texels that a sun covers first get the radiance behind it; then the sun adds exactly its light.

    Args:
        maps: linear radiance [T, 3, H, W].
        suns: suns as the module's docstring describes them, [T, SUN_COUNT, SUN_NUMBERS].
    """
    height, width = maps.shape[-2:]
    lobes = _draw_lobes(suns, height, width)
    light, background = suns[..., 3:6], suns[..., 7:]
    lobe_integrals = (lobes * solid_angles(height, width).to(suns)).sum((2, 3)).clamp_min(1e-12)
    for number in range(suns.shape[1]):
        lobe = lobes[:, number, None]
        cover = _cover_weights(lobe)
        maps = torch.lerp(maps, background[:, number, :, None, None].expand_as(maps), cover)
        maps = maps + lobe * (light[:, number] / lobe_integrals[:, number, None])[..., None, None]
    return maps
