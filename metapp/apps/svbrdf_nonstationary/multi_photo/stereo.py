"""Photometric stereo of several flash photographs in closed form.

It solves for the brightness and slopes of Lambertian texels, and for the exposures of the photographs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.appearance.flash import directions_to_point, texel_positions
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, encode_diffuse

PHOTO_INPUTS, TEXEL_INPUTS = 18, 12  # channels of readings that describe a photograph, and texels
NOISE_VALUE = 0.004  # noise of photographs of 8 bits, a linear value, 1 is white
STEREO_CLIPPED_LINEAR_VALUE = 0.97  # linear value, 1 is white, above which photometric stereo hardly trusts a pixel
# Widths of the curves that highlights are sums of: tangents of half angles
HIGHLIGHT_TANGENTS = (0.06, 0.12, 0.25, 0.5)
TEXEL_SOLVES = 4  # reweighted least squares of brightness and slopes
EXPOSURE_SOLVES = 2  # solves of exposures after slopes are known
HIGHLIGHT_SOLVES = 3  # reweighted least squares of exposures and highlights, before slopes are known
LAMBERTIAN_SPREAD = 0.08  # relative deviation from a Lambertian texel that halves a photograph's weight
RIDGE = (0.05 / 0.4) ** 2  # (relative noise of a photograph / size of slopes that are expected) squared
MAX_SLOPE = 1.5  # soft bound (tanh) of the length of slopes
RESIDUAL_SCALE = 0.1  # relative deviation from a Lambertian texel that counts by a half
EDGE_TEXELS = 4  # texels at each edge that do not count
EXPOSURE_STRIDE = 4  # exposures are solved on every fourth row and column


class Reading(NamedTuple):
    """The solution by photometric stereo, and the inputs of the network that corrects it.

    Attributes:
        photos: the inputs of each pixel of a photograph, [T, N, PHOTO_INPUTS, H, W].
        texels: the inputs of each texel, [T, TEXEL_INPUTS, H, W].
        maps: unbounded numbers of the maps by photometric stereo, [T, 9, H, W].
        gains: logs of exposures, whose mean is 0, [T, N].
        grey: brightness over the brightness of a flat white patch, [T, N, 1, H, W], after exposures and highlights are
            divided out.
        tangents: x and y over z of the directions to the flash, [T, N, 2, H, W].
        level: brightness of texels that face the flash, [T, 1, H, W].
        weights: the weight of each photograph in each texel, [T, N, 1, H, W].
    """

    photos: Tensor
    texels: Tensor
    maps: Tensor
    gains: Tensor
    grey: Tensor
    tangents: Tensor
    level: Tensor
    weights: Tensor


@torch.no_grad()
def read_stereo(photos: Tensor, places: Tensor) -> Reading:
    """Solve photometric stereo and exposures, and collect the inputs of the network.

    Args:
        photos: linear photographs [T, N, 3, H, W].
        places: positions of camera and flash, [T, N, 2, 3], in half sides of the patch.
    """
    # The geometry of each pixel: directions to camera and flash, the half vector, the brightness of a flat white patch
    texels = texel_positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)
    (wo, _), (wi, squared_distance) = (directions_to_point(place, texels) for place in places.unbind(2))
    white = wi[:, :, 2:] * places[:, :, 1, 2, None, None, None].square() / squared_distance
    half = wi + wo
    half = half / half.norm(dim=2, keepdim=True)
    widths = half.new_tensor(HIGHLIGHT_TANGENTS)[:, None, None]
    highlights = torch.exp((1 - 1 / half[:, :, 2:].square()) / (2 * widths.square()))
    tangents = wi[:, :, :2] / wi[:, :, 2:]

    # Colours over the brightness of the white patch, and how far each pixel can be trusted
    colour = photos.clamp_min(NOISE_VALUE / 4) / white
    grey, brightness = colour.mean(2, keepdim=True), photos.mean(2, keepdim=True)
    logs, noise = grey.log(), NOISE_VALUE / 2 / brightness.clamp_min(NOISE_VALUE / 4)
    is_clipped = (photos.amax(2, keepdim=True) > STEREO_CLIPPED_LINEAR_VALUE).to(photos)
    valid = 1 - 0.98 * is_clipped

    # Photometric stereo, of photographs from which exposures and highlights are divided out
    gains, strengths = _solve_gains(logs, highlights, tangents, valid, noise)
    gloss = (strengths[:, None, :, None, None] * highlights).sum(2, keepdim=True)
    scale = torch.exp(-_add_picture_axes(gains) - gloss)
    colour, grey = colour * scale, grey * scale
    level, slopes, weights, unknown_share = photometric_stereo(grey, tangents, valid, noise)
    lambertian = (1 + (slopes[:, None] * tangents).sum(2, keepdim=True)).clamp_min(0.05)
    weight = weights / weights.sum(1, keepdim=True)
    facing_colour = (weight * colour / lambertian).sum(1)  # the colour of a texel that faces the flash

    # What stereo leaves unexplained, and the directions of the flash and of highlights about the normal
    log_ratio = (colour / (facing_colour[:, None] * lambertian)).log().clamp(-3, 3)
    grey_log_ratio = log_ratio.mean(2, keepdim=True)
    length = (1 + slopes.square().sum(1, keepdim=True)).sqrt()  # of the vector (slopes, 1), along the normal
    normal = (torch.cat([slopes, torch.ones_like(length)], 1) / length)[:, None]
    cos_half = (half * normal).sum(2, keepdim=True).clamp(-1, 1)
    photo_inputs = [
        log_ratio,
        logs - _add_picture_axes(gains) + 1,
        2 * tangents,
        2 * wo[:, :, :2] / wo[:, :, 2:],
        2 * half[:, :, :2] / half[:, :, 2:],
        3 * (1 - cos_half).clamp_min(0).add(1e-6).sqrt(),
        (wi * normal).sum(2, keepdim=True),
        white.log(),
        gloss,
        is_clipped,
        (brightness + NOISE_VALUE).log() / 2 + 1,
        _add_picture_axes(gains).expand_as(white),
        10 * weight / (1 + 9 * weight),
    ]
    albedo = (facing_colour * length).clamp(2e-4, 0.98)
    texel_inputs = [
        2 * slopes,
        albedo.log() / 2 + 1,
        2 * (weight * grey_log_ratio.square()).sum(1).sqrt(),
        grey_log_ratio.amax(1),
        grey_log_ratio.amin(1),
        unknown_share.sqrt(),
        torch.full_like(length, math.log(photos.shape[1]) - 1.5),
        (photos.mean((1, 2), keepdim=True)[:, 0] + NOISE_VALUE).log() / 2 + 1,
    ]
    # Stereo finds slopes and diffuse colour; the numbers of roughness and specular colour are 0, where fits begin.
    maps = torch.cat([slopes, encode_diffuse(albedo), torch.zeros_like(length), torch.zeros_like(albedo)], 1)
    stereo = (grey, tangents, level, weights)
    return Reading(torch.cat(photo_inputs, 2), torch.cat(texel_inputs, 1), maps, gains, *stereo)


def photometric_stereo(brightness: Tensor, tangents: Tensor, valid: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
    """Solve for the brightness and slopes of Lambertian texels by reweighted least squares (Woodham 1980).

    Args:
        brightness: brightness over the brightness of a flat white patch, [T, N, 1, H, W].
        tangents: x and y over z of the directions to the flash, [T, N, 2, H, W].
        valid: 1, and nearly 0 where a photograph clips, [T, N, 1, H, W].
        noise: standard deviation of the noise over brightness, [T, N, 1, H, W].

    Returns:
        The brightness of texels that face the flash, [T, 1, H, W], slopes [T, 2, H, W], weights of the photographs
        [T, N, 1, H, W], and the share of each slope that the prior decides, [T, 2, H, W].
    """
    # the harmonic mean, which highlights hardly move
    typical = 1 / (1 / brightness.clamp_min(1e-4)).mean(1, keepdim=True)
    y, x, z = brightness / typical, tangents[:, :, :1], tangents[:, :, 1:]
    trust = valid / (1 + (noise / 0.05).square())
    weight = trust * (1 / y.clamp_min(1)).square() + 1e-3
    for remaining in reversed(range(TEXEL_SOLVES)):
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
        if remaining:
            lambertian = level[:, None] + along_x[:, None] * x + along_y[:, None] * z
            deviation = (y - lambertian) / (lambertian.abs() + 0.05)
            # highlights are brighter than Lambertian texels: they count less than shadows
            deviation = torch.where(deviation > 0, 1.5 * deviation, deviation) / LAMBERTIAN_SPREAD
            weight = trust / (1 + deviation.square()) + 1e-3
    slopes = torch.cat([along_x, along_y], 1) / level
    length = slopes.square().sum(1, keepdim=True).add(1e-8).sqrt()
    slopes = slopes * (MAX_SLOPE * torch.tanh(length / MAX_SLOPE) / length)
    return level * typical[:, 0], slopes, weight, torch.cat([azz, axx], 1) / determinant * RIDGE


@torch.no_grad()
def stereo_residual(photos: Tensor, places: Tensor) -> Tensor:
    """Measure how far photographs are from those of Lambertian texels, by which stereo explains them.

    Args:
        photos: linear photographs [N, 3, H, W].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.

    Returns:
        The mean of d^2 / (d^2 + RESIDUAL_SCALE^2) over pixels but those at the edges, [], where d is the difference of
        a pixel's brightness from the prediction, over the brightness of its texel.
    """
    reading = read_stereo(photos[None], places[None])
    level, slopes = reading.level[0], reading.maps[0, : CHANNELS[0]]
    prediction = level * (1 + (slopes * reading.tangents[0]).sum(1, keepdim=True))
    squared = ((reading.grey[0] - prediction) / level)[..., EDGE_TEXELS:-EDGE_TEXELS, EDGE_TEXELS:-EDGE_TEXELS].square()
    return (squared / (squared + RESIDUAL_SCALE**2)).mean()


def _solve_gains(
    logs: Tensor, highlights: Tensor, tangents: Tensor, valid: Tensor, noise: Tensor
) -> tuple[Tensor, Tensor]:
    """Solve for the exposures and highlights of photographs, on every EXPOSURE_STRIDEth row and column.

    A gain and a tilt of the whole patch look alike, so exposures are solved such that the mean slope is 0.

    Args:
        logs: logs of brightness over the brightness of a flat white patch, [T, N, 1, H, W].
        highlights: K curves of the half angle, [T, N, K, H, W].
        tangents, valid, noise: the arguments of :func:`photometric_stereo`.

    Returns:
        Logs of gains, [T, N], and strengths of the K curves, [T, K].
    """
    logs, highlights, tangents, valid, noise = (
        values[..., ::EXPOSURE_STRIDE, ::EXPOSURE_STRIDE] for values in (logs, highlights, tangents, valid, noise)
    )
    trust = valid / (1 + (noise / 0.05).square())
    gains, strengths = _solve_exposures(logs[:, :, 0].flatten(2), highlights.flatten(3), trust[:, :, 0].flatten(2))
    gloss = (strengths[:, None, :, None, None] * highlights).sum(2, keepdim=True)
    for _ in range(EXPOSURE_SOLVES):
        matte = torch.exp(logs - gloss - _add_picture_axes(gains))
        level, slopes, *_ = photometric_stereo(matte, tangents, valid, noise)
        slopes = slopes - slopes.mean((2, 3), keepdim=True)
        lambertian = (1 + (slopes[:, None] * tangents).sum(2, keepdim=True)).clamp_min(0.1)
        gains = gains + _centre((matte / (level[:, None] * lambertian)).log().flatten(2).median(2).values)
    return gains, strengths


def _solve_exposures(logs: Tensor, highlights: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Solve for exposures and highlights of photographs before slopes are known, by reweighted least squares.

    The log brightness of a pixel is a sum of three terms: one of its texel, one of its photograph (the exposure), and
    one of its half angle (the highlight). Texels are eliminated: their mean over photographs is subtracted.

    Args:
        logs: logs of the brightness of P pixels of each photograph, [T, N, P].
        highlights: K curves of the half angle, [T, N, K, P].
        weight: weights of the pixels, [T, N, P].

    Returns:
        Logs of gains, [T, N], and strengths of the K curves, [T, K].
    """
    count = logs.shape[1]
    logs, highlights, weight = logs.double(), highlights.double(), weight.double() + 1e-3
    photo_rows = torch.eye(count).to(logs)[None, :, :, None].expand(len(logs), -1, -1, logs.shape[-1])
    rows = torch.cat([photo_rows, highlights], 2)
    ridge = (
        torch.cat([logs.new_full((count,), 1e-3), logs.new_full((highlights.shape[2],), 3e-3)]).diag() * logs.shape[-1]
    )
    current_weight = weight
    for _ in range(HIGHLIGHT_SOLVES):
        total = current_weight.sum(1, keepdim=True)
        y = logs - (current_weight * logs).sum(1, keepdim=True) / total
        x = rows - (current_weight[:, :, None] * rows).sum(1, keepdim=True) / total[:, :, None]
        wx = current_weight[:, :, None] * x
        matrix = torch.einsum("bnip,bnjp->bij", wx, x) + ridge
        solution = torch.linalg.solve(matrix, torch.einsum("bnip,bnp->bi", wx, y))
        residual = y - torch.einsum("bnip,bi->bnp", x, solution)
        current_weight = weight / (1 + (residual / 0.25).square())
    return _centre(solution[:, :count]).to(weight.float()), solution[:, count:].float()


def _centre(gains: Tensor) -> Tensor:
    """Shift logs of gains [T, N] to a mean of 0."""
    return gains - gains.mean(1, keepdim=True)


def _add_picture_axes(gains: Tensor) -> Tensor:
    """Add axes of channels, rows and columns to gains [T, N]: [T, N, 1, 1, 1]."""
    return gains[..., None, None, None]
