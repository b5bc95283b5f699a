"""The brightest lights of a map in closed form: their directions, light and size.

A sun has 10 numbers: the mean direction of its light, the light itself (radiance times solid angle, RGB), its mean
squared angle to that direction in rad^2, and the radiance round it. There the network does not count.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from metapp.appearance.latlong import luminance, solid_angles, texel_directions
from metapp.learning.task import Params

SUN_COUNT, SUN_NUMBERS = 3, 10  # suns of a map, and numbers of each
SUN_LUMINANCE = 80.0  # luminance of what is a sun, of maps of mean luminance 1
MAX_SUN_RAD = math.radians(2.5)  # root mean square angle; larger lights are no Gaussians, and the network fits them
COVER_GAIN = 20.0  # the network does not count where a sun has this part of its radiance or more
MIN_DEVIATION_TEXELS = 0.1  # texels, standard deviation along one axis


def find_suns(maps: Tensor) -> Tensor:
    """The suns of maps [T, 3, H, W] of mean luminance 1, [T, SUNS, 10]; zeros if there are no more."""
    return torch.stack([_suns(one.detach().cpu()) for one in maps]).to(maps)


def _suns(light: Tensor) -> Tensor:
    bright = luminance(light)
    numbers = torch.zeros(SUN_COUNT, SUN_NUMBERS)
    if not (bright > SUN_LUMINANCE).any():
        return numbers
    height, width = bright.shape
    towards, area = texel_directions(height, width), solid_angles(height, width)
    excess = light * (1 - SUN_LUMINANCE / bright.clamp_min(SUN_LUMINANCE)) * area
    regions = _regions(bright > SUN_LUMINANCE)
    weights = luminance(excess)
    suns = [_shape(weights * (regions == region), towards) for region in range(1, int(regions.max()) + 1)]
    small = sorted((sun for sun in suns if sun[1] <= MAX_SUN_RAD**2), key=lambda sun: -sun[0])[:SUN_COUNT]
    for number, (_, spread, mean) in enumerate(small):
        numbers[number, :3], numbers[number, 6] = mean, spread
    lobes = _lobes(numbers[None], height, width)[0]
    covers = _covered(lobes) * area
    rest = torch.minimum(light, light * SUN_LUMINANCE / bright.clamp_min(1e-9))
    level = torch.einsum("chw,shw->sc", rest, covers) / covers.sum((1, 2)).clamp_min(1e-12)[:, None]
    whole = torch.einsum("chw,shw->sc", light, covers) - level * covers.sum((1, 2))[:, None]
    numbers[:, 3:6], numbers[:, 7:] = whole.clamp_min(0), level
    return numbers


def _shape(weights: Tensor, towards: Tensor) -> tuple[float, float, Tensor]:
    """Sum of weights [H, W], mean squared angle to their mean direction, and that direction [3]."""
    mean, light = torch.einsum("hw,chw->c", weights.double(), towards.double()), float(weights.double().sum())
    length = float(mean.norm())
    return light, max(2 * (1 - length / light), 0.0), (mean / length).float()


def _regions(bright: Tensor) -> Tensor:
    """Numbers of connected regions, from 1, 0 outside; bool [H, W] to int64; they go on around the horizon."""
    names = torch.arange(1.0, bright.numel() + 1).reshape(bright.shape) * bright
    while True:  # each takes the largest name around it
        around = pad(pad(names[None, None], (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1))
        grown = max_pool2d(around, 3, stride=1)[0, 0] * bright
        if torch.equal(grown, names):
            break
        names = grown
    numbers: Tensor = torch.cat([torch.zeros(1), names.flatten()]).unique(return_inverse=True)[1]
    return numbers[1:].reshape(bright.shape)


def _lobes(suns: Tensor, height: int, width: int) -> Tensor:
    """Gaussians round suns [T, SUNS, 10], the mean over each texel, [T, SUNS, height, width]; 0 if there is none.

    They are Gaussians of latitude and of longitude, which is the same for a small sun.
    """
    (x, y, z), there = suns[..., :3].unbind(2), suns[..., :3].norm(dim=2) > 0
    texel = math.pi / height
    polar, around = torch.acos(y.clamp(-1, 1)), torch.atan2(x, -z) % math.tau
    deviation, least = (suns[..., 6] / 2).sqrt(), MIN_DEVIATION_TEXELS * texel
    sideways = (deviation / polar.sin().clamp_min(1e-3)).clamp(least, math.tau)
    rows = torch.arange(height + 1).to(suns) * texel
    columns = torch.arange(width + 1).to(suns) * texel
    down = _between((rows - polar[..., None]) / deviation.clamp_min(least)[..., None])
    turns = columns.new_tensor([-math.tau, 0, math.tau])[:, None]  # it goes on around the horizon
    across = _between((columns - around[..., None, None] + turns) / sideways[..., None, None]).sum(-2)
    lobes: Tensor = down[..., None] * across[..., None, :] * there[..., None, None]
    return lobes


def _between(edges: Tensor) -> Tensor:
    """The share of a normal distribution between each two edges [..., N + 1], [..., N]."""
    shares: Tensor = torch.special.ndtr(edges).diff(dim=-1)
    return shares


def split_suns(suns: Tensor) -> Params:
    """Suns [T, SUNS, SUN_NUMBERS] as parameters of fits, by kind, so that a pack spends bits on each; angles in rad."""
    towards, light, spread, level = suns.split((3, 3, 1, 3), 2)
    return {"suns.angle": spread.sqrt(), "suns.level": level, "suns.light": light, "suns.towards": towards}


def join_suns(theta: Params) -> Tensor:
    """The same again, [T, SUNS, SUN_NUMBERS], which no step moves."""
    kinds = theta["suns.towards"], theta["suns.light"], theta["suns.angle"] ** 2, theta["suns.level"]
    return torch.cat(kinds, 2).detach()


def _covered(lobes: Tensor) -> Tensor:
    """The weight of suns alone, in [0, 1]."""
    return (COVER_GAIN * lobes / lobes.amax((-2, -1), keepdim=True).clamp_min(1e-12)).clamp_max(1)


def add_suns(maps: Tensor, suns: Tensor) -> Tensor:
    """Maps [T, 3, H, W] with suns [T, SUNS, 10], each of exactly its light, in place of their texels."""
    height, width = maps.shape[-2:]
    lobes = _lobes(suns, height, width)
    light, level = suns[..., 3:6], suns[..., 7:]
    shares = (lobes * solid_angles(height, width).to(suns)).sum((2, 3)).clamp_min(1e-12)
    for number in range(suns.shape[1]):
        lobe = lobes[:, number, None]
        covers = _covered(lobe)
        maps = torch.lerp(maps, level[:, number, :, None, None].expand_as(maps), covers)
        maps = maps + lobe * (light[:, number] / shares[:, number, None])[..., None, None]
    return maps
