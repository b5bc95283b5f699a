"""The brightest lights of a map in closed form: their directions, light and size.

A network cannot fit a sun in few steps, as it is too small and too bright. So a sun is kept as 10 numbers: the mean
direction of its light; its light above its surroundings (radiance times solid angle, RGB); the mean squared angle to
that direction in rad^2; and the background radiance behind it, which replaces the network's radiance there. This is the
mean of the texels that the sun covers, each of which is capped before.
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
COVER_GAIN = 20.0  # the network does not count where a sun has 1 / COVER_GAIN of its greatest radiance, or more
MIN_DEVIATION_TEXELS = 0.1  # the least standard deviation of a sun along one axis, in texels


def find_suns(maps: Tensor) -> Tensor:
    """Find the suns of maps [T, 3, H, W] of mean luminance 1: [T, SUN_COUNT, SUN_NUMBERS], zeros if there are fewer."""
    return torch.stack([_find_map_suns(light.detach().cpu()) for light in maps]).to(maps)


def _find_map_suns(light: Tensor) -> Tensor:
    """Find the suns of one map [3, H, W], [SUN_COUNT, SUN_NUMBERS]."""
    brightness = luminance(light)
    numbers = torch.zeros(SUN_COUNT, SUN_NUMBERS)
    if not (brightness > SUN_LUMINANCE).any():
        return numbers
    height, width = brightness.shape
    directions, solid_angle = texel_directions(height, width), solid_angles(height, width)
    excess = light * (1 - SUN_LUMINANCE / brightness.clamp_min(SUN_LUMINANCE)) * solid_angle
    regions = _label_regions(brightness > SUN_LUMINANCE)
    weights = luminance(excess)
    suns = [_measure_light(weights * (regions == region), directions) for region in range(1, int(regions.max()) + 1)]
    small_suns = sorted((sun for sun in suns if sun[1] <= MAX_SUN_RAD**2), key=lambda sun: -sun[0])[:SUN_COUNT]
    for number, (_, squared_angle, mean) in enumerate(small_suns):
        numbers[number, :3], numbers[number, 6] = mean, squared_angle
    lobes = _draw_lobes(numbers[None], height, width)[0]
    covers = _cover_weights(lobes) * solid_angle
    capped_light = torch.minimum(light, light * SUN_LUMINANCE / brightness.clamp_min(1e-9))
    surrounding = torch.einsum("chw,shw->sc", capped_light, covers) / covers.sum((1, 2)).clamp_min(1e-12)[:, None]
    sun_light = torch.einsum("chw,shw->sc", light, covers) - surrounding * covers.sum((1, 2))[:, None]
    numbers[:, 3:6], numbers[:, 7:] = sun_light.clamp_min(0), surrounding
    return numbers


def _measure_light(weights: Tensor, directions: Tensor) -> tuple[float, float, Tensor]:
    """Measure where light is, given as weights [H, W] of directions [3, H, W].

    Returns:
        The sum of weights, their mean squared angle to their mean direction in rad^2, and this direction, [3].
    """
    mean, light = torch.einsum("hw,chw->c", weights.double(), directions.double()), float(weights.double().sum())
    length = float(mean.norm())
    return light, max(2 * (1 - length / light), 0.0), (mean / length).float()


def _label_regions(is_bright: Tensor) -> Tensor:
    """Label connected regions of a mask [H, W] from 1, and what is outside 0, int64; they go on around the horizon."""
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
    """Draw Gaussians round suns, [T, SUN_COUNT, height, width]: the mean over each texel, 0 for a sun that is missing.

    They are Gaussians of latitude and of longitude, which for a small sun are Gaussians of direction.

    Args:
        suns: numbers [T, SUN_COUNT, SUN_NUMBERS].
        height: rows of the result.
        width: columns of the result.
    """
    (x, y, z), exists = suns[..., :3].unbind(2), suns[..., :3].norm(dim=2) > 0
    texel = math.pi / height
    polar, azimuth = torch.acos(y.clamp(-1, 1)), torch.atan2(x, -z) % math.tau
    deviation, min_deviation = (suns[..., 6] / 2).sqrt(), MIN_DEVIATION_TEXELS * texel
    azimuth_deviation = (deviation / polar.sin().clamp_min(1e-3)).clamp(min_deviation, math.tau)
    rows = torch.arange(height + 1).to(suns) * texel
    columns = torch.arange(width + 1).to(suns) * texel
    row_shares = _normal_shares((rows - polar[..., None]) / deviation.clamp_min(min_deviation)[..., None])
    turns = columns.new_tensor([-math.tau, 0, math.tau])[:, None]  # a sun goes on around the horizon
    column_shares = _normal_shares(
        (columns - azimuth[..., None, None] + turns) / azimuth_deviation[..., None, None]
    ).sum(-2)
    lobes: Tensor = row_shares[..., None] * column_shares[..., None, :] * exists[..., None, None]
    return lobes


def _normal_shares(edges: Tensor) -> Tensor:
    """Return the share of a normal distribution between each two neighbours of edges [..., N + 1], [..., N]."""
    shares: Tensor = torch.special.ndtr(edges).diff(dim=-1)
    return shares


def split_suns(suns: Tensor) -> Params:
    """Return suns [T, SUN_COUNT, SUN_NUMBERS] as parameters of fits, by kind, so that a pack spends bits on each kind.

    The mean squared angle in rad^2 becomes its root in rad.
    """
    directions, light, squared_angle, surrounding = suns.split((3, 3, 1, 3), 2)
    return {
        "suns.angle": squared_angle.sqrt(),
        "suns.level": surrounding,
        "suns.light": light,
        "suns.towards": directions,
    }


def join_suns(theta: Params) -> Tensor:
    """Return the suns [T, SUN_COUNT, SUN_NUMBERS] whose parameters a fit has, without gradients: no step moves them."""
    kinds = theta["suns.towards"], theta["suns.light"], theta["suns.angle"] ** 2, theta["suns.level"]
    return torch.cat(kinds, 2).detach()


def _cover_weights(lobes: Tensor) -> Tensor:
    """Return how much suns count in place of the network, in [0, 1], where their lobes are [..., H, W]."""
    return (COVER_GAIN * lobes / lobes.amax((-2, -1), keepdim=True).clamp_min(1e-12)).clamp_max(1)


def add_suns(maps: Tensor, suns: Tensor) -> Tensor:
    """Add suns to maps [T, 3, H, W], each of exactly its light, in place of the radiance of the texels that it covers.

    Args:
        maps: linear radiance [T, 3, H, W].
        suns: numbers [T, SUN_COUNT, SUN_NUMBERS].
    """
    height, width = maps.shape[-2:]
    lobes = _draw_lobes(suns, height, width)
    light, surrounding = suns[..., 3:6], suns[..., 7:]
    shares = (lobes * solid_angles(height, width).to(suns)).sum((2, 3)).clamp_min(1e-12)
    for number in range(suns.shape[1]):
        lobe = lobes[:, number, None]
        covers = _cover_weights(lobe)
        maps = torch.lerp(maps, surrounding[:, number, :, None, None].expand_as(maps), covers)
        maps = maps + lobe * (light[:, number] / shares[:, number, None])[..., None, None]
    return maps
