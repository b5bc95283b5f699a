"""General of several flash photographs: the maps of each texel that they allow, and how far off these may be.

Photometric stereo in closed form comes first: a Lambertian texel's level and slopes, exposures solved beside them. A
small network of each photograph, whose mean and maximum over photographs know no order, and a U-Net over texels correct
it.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, leaky_relu

from metapp.appearance.flash import positions, towards
from metapp.apps.svbrdf_nonstationary.encoder import SLOPE, add_block, block, pointwise, twice
from metapp.apps.svbrdf_nonstationary.maps import RAW
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, convolved

STEM = 32  # channels of the network of a photograph
PHOTO_INPUTS, TEXEL_INPUTS = 18, 12
WIDTHS = (32, 48, 64, 96, 96)  # channels of the U-Net's levels; sides are multiples of 16 texels
NOISE_VALUE, CLIPPED_VALUE = 0.004, 0.97  # of white: noise of 8 bits, and what a photograph shows no more
LOBE_TANGENTS = (0.06, 0.12, 0.25, 0.5)  # widths of highlights, tangents of half angles
REWEIGHTED, REEXPOSED, RELOBED = 4, 2, 3  # solutions of texels, of exposures after them, of exposures before them
LAMBERTIAN_SPREAD = 0.08  # relative deviation from a Lambertian texel that halves a photograph's weight
RIDGE = (0.05 / 0.4) ** 2  # relative noise of a photograph over the slopes expected, squared
STEEPEST_SLOPE = 1.5
COARSE = 4  # every such row and column is enough for exposures


class Reading(NamedTuple):
    """The inputs of the network.

    Attributes:
        photos: [T, N, PHOTO_INPUTS, H, W].
        texels: [T, TEXEL_INPUTS, H, W].
        maps: RAW numbers of the closed form, [T, 9, H, W].
        gains: logs of exposures, about a mean of 0, [T, N].
        grey, tangents, level, weights: of photometric stereo, as `photometric_stereo` takes and gives them.
    """

    photos: Tensor
    texels: Tensor
    maps: Tensor
    gains: Tensor
    grey: Tensor
    tangents: Tensor
    level: Tensor
    weights: Tensor


def init(rng: Generator) -> Params:
    """Random parameters of the network."""
    params: Params = {}
    layer = functools.partial(add_layer, params, rng)
    known = 2 * STEM + TEXEL_INPUTS
    layer("stem.first", STEM, PHOTO_INPUTS, 3, 3)
    layer("stem.second", STEM, STEM)
    for level, (inputs, outputs) in enumerate(zip((known, *WIDTHS), WIDTHS)):  # noqa: B905
        add_block(params, rng, f"down{level}", inputs, outputs)
    for level in reversed(range(len(WIDTHS) - 1)):
        add_block(params, rng, f"up{level}", WIDTHS[level + 1] + WIDTHS[level], WIDTHS[level])
    layer("maps", sum(RAW) + 2, WIDTHS[0] + known, gain=0.1)
    layer("deviation", len(RAW), WIDTHS[0] + known, gain=0.1)
    return params


def network(params: Params, reading: Reading) -> tuple[Tensor, Tensor]:
    """RAW numbers of maps, [T, 9, H, W], and the logs of the scales by which slopes and so on are off, [T, 4, H, W]."""
    number = reading.photos.shape[:2]
    x = reading.photos.flatten(0, 1).contiguous(memory_format=torch.channels_last)
    x = leaky_relu(convolved(params, "stem.first", x), SLOPE)
    x = leaky_relu(pointwise(params, "stem.second", x), SLOPE).unflatten(0, number)
    known = torch.cat([x.mean(1), x.amax(1), reading.texels], 1).contiguous(memory_format=torch.channels_last)
    x, skips = known, []
    for level in range(len(WIDTHS)):
        x = block(params, f"down{level}", avg_pool2d(x, 2) if level else x)
        skips.append(x)
    for level in reversed(range(len(WIDTHS) - 1)):
        x = block(params, f"up{level}", torch.cat([twice(x), skips[level]], 1))
    x = torch.cat([x, known], 1)
    change, gates = pointwise(params, "maps", x).split((sum(RAW), 2), 1)
    slopes, rest = reading.maps.split((RAW[0], sum(RAW[1:])), 1)
    slopes = 2 * torch.sigmoid(gates[:, :1]) * slopes + 0.5 * change[:, : RAW[0]]
    maps = torch.cat([slopes, rest + 2 * change[:, RAW[0] :]], 1)
    return maps, pointwise(params, "deviation", x).clamp(-8, 4)


def photometric_stereo(brightness: Tensor, tangents: Tensor, valid: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
    """Level and slopes of Lambertian texels in closed form, by reweighted least squares (Woodham 1980).

    Args:
        brightness: over that of a flat white patch, [T, N, 1, H, W].
        tangents: of the directions to the flash, x and y over z, [T, N, 2, H, W].
        valid: 1, nearly 0 where a photograph clips, as brightness.
        noise: relative, as brightness.

    Returns:
        Level [T, 1, H, W], slopes [T, 2, H, W], photographs' weights [T, N, 1, H, W], and the share of each slope that
        is the prior's, [T, 2, H, W].
    """
    middle = 1 / (1 / brightness.clamp_min(1e-4)).mean(1, keepdim=True)  # highlights hardly move it
    y, x, z = brightness / middle, tangents[:, :, :1], tangents[:, :, 1:]
    known = valid / (1 + (noise / 0.05).square())
    weight = known * (1 / y.clamp_min(1)).square() + 1e-3
    for again in reversed(range(REWEIGHTED)):
        w = weight / (y + 0.05).square()
        # normal equations of the rows (1, x, z), from which the level is eliminated
        wx, s, sx, sz = w * x, w.sum(1), (w * x).sum(1), (w * z).sum(1)
        sxx, sxz, szz = (wx * x).sum(1) + RIDGE, (wx * z).sum(1), (w * z * z).sum(1) + RIDGE
        t, tx, tz = (w * y).sum(1), (wx * y).sum(1), (w * z * y).sum(1)
        axx, axz, azz = sxx - sx * sx / s, sxz - sx * sz / s, szz - sz * sz / s
        bx, bz = tx - sx * t / s, tz - sz * t / s
        determinant = (axx * azz - axz * axz).clamp_min(1e-8)
        along_x, along_y = (azz * bx - axz * bz) / determinant, (axx * bz - axz * bx) / determinant
        level = ((t - sx * along_x - sz * along_y) / s).clamp_min(0.02)
        if again:
            lambertian = level[:, None] + along_x[:, None] * x + along_y[:, None] * z
            off = (y - lambertian) / (lambertian.abs() + 0.05)
            off = torch.where(off > 0, 1.5 * off, off) / LAMBERTIAN_SPREAD  # highlights are brighter
            weight = known / (1 + off.square()) + 1e-3
    slopes = torch.cat([along_x, along_y], 1) / level
    length = slopes.square().sum(1, keepdim=True).add(1e-8).sqrt()
    slopes = slopes * (STEEPEST_SLOPE * torch.tanh(length / STEEPEST_SLOPE) / length)
    return level * middle[:, 0], slopes, weight, torch.cat([azz, axx], 1) / determinant * RIDGE


def _first_exposures(logs: Tensor, lobes: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Logs of gains [T, N] and strengths of lobes [T, K] of photographs' logs [T, N, P], by reweighted least squares.

    A log is a term of its texel, one of its photograph, and a curve of the half angle by `lobes` [T, N, K, P].
    """
    count = logs.shape[1]
    logs, lobes, weight = logs.double(), lobes.double(), weight.double() + 1e-3
    photo = torch.eye(count).to(logs)[None, :, :, None].expand(len(logs), -1, -1, logs.shape[-1])
    rows = torch.cat([photo, lobes], 2)
    ridge = torch.cat([logs.new_full((count,), 1e-3), logs.new_full((lobes.shape[2],), 3e-3)]).diag() * logs.shape[-1]
    now = weight
    for _ in range(RELOBED):
        total = now.sum(1, keepdim=True)
        y = logs - (now * logs).sum(1, keepdim=True) / total
        x = rows - (now[:, :, None] * rows).sum(1, keepdim=True) / total[:, :, None]
        wx = now[:, :, None] * x
        matrix = torch.einsum("bnip,bnjp->bij", wx, x) + ridge
        solution = torch.linalg.solve(matrix, torch.einsum("bnip,bnp->bi", wx, y))
        off = y - torch.einsum("bnip,bi->bnp", x, solution)
        now = weight / (1 + (off / 0.25).square())
    return _centred(solution[:, :count]).to(weight.float()), solution[:, count:].float()


def _centred(gains: Tensor) -> Tensor:
    return gains - gains.mean(1, keepdim=True)


def _spread(gains: Tensor) -> Tensor:
    return gains[..., None, None, None]


@torch.no_grad()
def read(photos: Tensor, places: Tensor) -> Reading:
    """Read linear photographs [T, N, 3, H, W], taken from `places` [T, N, 2, 3] of camera and flash."""
    texels = positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)
    (wo, _), (wi, squared) = (towards(each, texels) for each in places.unbind(2))
    white = wi[:, :, 2:] * places[:, :, 1, 2, None, None, None].square() / squared  # of a flat white patch
    half = wi + wo
    half = half / half.norm(dim=2, keepdim=True)
    lobe = torch.exp((1 - 1 / half[:, :, 2:].square()) / (2 * half.new_tensor(LOBE_TANGENTS)[:, None, None].square()))
    tangents = wi[:, :, :2] / wi[:, :, 2:]
    colour = photos.clamp_min(NOISE_VALUE / 4) / white
    grey, bright = colour.mean(2, keepdim=True), photos.mean(2, keepdim=True)
    logs, noise = grey.log(), NOISE_VALUE / 2 / bright.clamp_min(NOISE_VALUE / 4)
    clips = (photos.amax(2, keepdim=True) > CLIPPED_VALUE).to(photos)
    valid = 1 - 0.98 * clips
    # exposures such that the slopes' means, which depend on them, are 0
    few = [part[..., ::COARSE, ::COARSE] for part in (logs, lobe, tangents, valid, noise)]
    trusted = few[3] / (1 + (few[4] / 0.05).square())
    gains, strengths = _first_exposures(few[0][:, :, 0].flatten(2), few[1].flatten(3), trusted[:, :, 0].flatten(2))
    gloss = (strengths[:, None, :, None, None] * lobe).sum(2, keepdim=True)
    for _ in range(REEXPOSED):
        y = torch.exp(few[0] - gloss[..., ::COARSE, ::COARSE] - _spread(gains))
        level, slopes, *_ = photometric_stereo(y, *few[2:])
        slopes = slopes - slopes.mean((2, 3), keepdim=True)
        lambertian = (1 + (slopes[:, None] * few[2]).sum(2, keepdim=True)).clamp_min(0.1)
        gains = gains + _centred((y / (level[:, None] * lambertian)).log().flatten(2).median(2).values)
    scale = torch.exp(-_spread(gains) - gloss)
    colour, grey = colour * scale, grey * scale
    level, slopes, weights, unknown = photometric_stereo(grey, tangents, valid, noise)
    lambertian = (1 + (slopes[:, None] * tangents).sum(2, keepdim=True)).clamp_min(0.05)
    weight = weights / weights.sum(1, keepdim=True)
    body = (weight * colour / lambertian).sum(1)
    apart = (colour / (body[:, None] * lambertian)).log().clamp(-3, 3)
    grey_apart = apart.mean(2, keepdim=True)
    length = (1 + slopes.square().sum(1, keepdim=True)).sqrt()
    normal = (torch.cat([slopes, torch.ones_like(length)], 1) / length)[:, None]
    cos_half = (half * normal).sum(2, keepdim=True).clamp(-1, 1)
    of_photos = [
        apart,
        logs - _spread(gains) + 1,
        2 * tangents,
        2 * wo[:, :, :2] / wo[:, :, 2:],
        2 * half[:, :, :2] / half[:, :, 2:],
        3 * (1 - cos_half).clamp_min(0).add(1e-6).sqrt(),
        (wi * normal).sum(2, keepdim=True),
        white.log(),
        gloss,
        clips,
        (bright + NOISE_VALUE).log() / 2 + 1,
        _spread(gains).expand_as(white),
        10 * weight / (1 + 9 * weight),
    ]
    albedo = (body * length).clamp(2e-4, 0.98)
    of_texels = [
        2 * slopes,
        albedo.log() / 2 + 1,
        2 * (weight * grey_apart.square()).sum(1).sqrt(),
        grey_apart.amax(1),
        grey_apart.amin(1),
        unknown.sqrt(),
        torch.full_like(length, math.log(photos.shape[1]) - 1.5),
        (photos.mean((1, 2), keepdim=True)[:, 0] + NOISE_VALUE).log() / 2 + 1,
    ]
    shade = torch.logit((albedo ** (1 / 2.2)).clamp(0.02, 0.98))
    maps = torch.cat([slopes, shade, torch.zeros_like(length), torch.zeros_like(albedo)], 1)
    stereo = (grey, tangents, level, weights)
    return Reading(torch.cat(of_photos, 2), torch.cat(of_texels, 1), maps, gains, *stereo)
