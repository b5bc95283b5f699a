"""The fall-off of brightness about the flash in a photo, the gloss that it shows, and highlights that clip."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, interpolate, max_pool2d

from metapp.appearance.flash import DISPLAY_GAMMA, Maps, render_maps, texel_positions
from metapp.appearance.order import even_out_brightness

PROFILE_RINGS = 24
PROFILE_RADIUS_HALF_SIDES = 1.5  # half sides of the patch from the flash to the last ring
RING_SPACING_POWER = 1.5  # power by which rings are closer together near the flash
CANDIDATE_ROUGHNESSES = tuple(0.08 * 1.12**i for i in range(22))  # 0.08 to 0.86
CLIPPED_DISPLAY_VALUE, CLIPPED_RING_SHARE = (
    0.98,
    0.02,
)  # a ring with a larger share of px above says no more than "so bright"
MIN_WHITE_DISPLAY_VALUE = 0.9  # least channel of a clipped highlight; paint that saturates one or two channels has less
CLIPPED_WINDOW_HALF_SHARE, MIN_CLIPPED_DENSITY = (
    1 / 128,
    0.5,
)  # half the window's side over the photo's; share of its px
# Between photos that show next to nothing clipped (< 0.1 %) and those of which 0.5 % or more is. Of flat materials
# whose photos have 1 % the highlight says at least 0.75 of F0, of those with more down to 0.34 (9 in 10 of 136
# renderings, roughness 0.16 to 0.6, F0 up to 1).
WARNING_CLIPPED_PX_SHARE = 0.002
F0_BOUND_CLAUSE = "so F0 is a lower bound"
FILL_PX = 256  # side at which clipped px are found and fills are made, which are smooth
FILL_MARGIN_SHARE = 1 / 64  # of the side: by which fills reach beyond what clips, and over which they fade
FILL_FADE_DISPLAY_VALUES = (
    0.4,
    0.8,
)  # mean display values between which px beside those that clip come to be filled as these
HALO_SHARE = 3 / 16  # of the side: maps so near to a wide highlight are taken for part of it
HALO_WEIGHT, COVERED_WEIGHT = 1e-3, 1e-6  # of maps there, and beneath the fill, if there is nothing else to fill from


class Gloss(NamedTuple):
    """The properties of a material by its highlight's profile.

    Attributes:
        roughness: [B], of the flat even material that looks most alike.
        specular: [B], its F0.
        contrast: [B], the lobe's share of the light that is reflected right below the flash, 0 to 1.
        share: [B], the same of all that the photo's patch reflects.
        diffuse: [B, 3], its diffuse albedo, linear RGB.
    """

    roughness: Tensor
    specular: Tensor
    contrast: Tensor
    share: Tensor
    diffuse: Tensor


def ring_profile(pictures: Tensor, light: Tensor) -> tuple[Tensor, Tensor]:
    """Means of pictures [..., C, H, W] in rings about the point below the flash [..., 3].

    Returns:
        Means [..., C, RINGS], and by how much each px belongs to each ring, linear between two, [..., RINGS, H W].
    """
    place = texel_positions(*pictures.shape[-2:], dtype=light.dtype, device=light.device).flatten(1)
    distance = (place - light[..., :2, None]).square().sum(-2).sqrt()
    at = (distance / PROFILE_RADIUS_HALF_SIDES).clamp_max(1) ** (1 / RING_SPACING_POWER) * (PROFILE_RINGS - 1)
    ring = torch.arange(PROFILE_RINGS, dtype=light.dtype, device=light.device)[:, None]
    belongs = (1 - (at[..., None, :] - ring).abs()).clamp_min(0)
    means = pictures.flatten(-2) @ belongs.mT / belongs.sum(-1).clamp_min(1e-3)[..., None, :]
    return means, belongs


def remove_flash_falloff(pictures: Tensor, light: Tensor) -> Tensor:
    """Pictures [..., C, H, W] of display values under a flash [..., 3] as if all rings about it were as bright."""
    means, belongs = ring_profile(pictures, light)
    around = (means @ belongs).unflatten(-1, pictures.shape[-2:]).clamp_min(0.02)
    even: Tensor = pictures * pictures.mean((-1, -2), keepdim=True) / around
    return even


def remove_shading(photos: Tensor, light: Tensor) -> Tensor:
    """Photos [..., 3, H, W] under a flash [..., 3] as if the light were the same everywhere."""
    return even_out_brightness(remove_flash_falloff(photos, light))


@torch.no_grad()
def estimate_gloss(photos: Tensor, light: Tensor) -> Gloss:
    """The gloss of the flat even material whose profile is most like that of photos [B, 3, H, W].

    A Lambertian body of any colour under one GGX lobe without colour: linear in both but where the photo is clipped.

    Args:
        photos: display values in [0, 1].
        light: position of the flash, and the camera above the same point, [B, 3].

    Returns:
        Roughness to about 10 %, below 0.2, where the lobe is a few px wide, to 25 %.
    """
    means, belongs = ring_profile(photos.clamp(1e-3, 1) ** DISPLAY_GAMMA, light)
    display = means.clamp_min(1e-4) ** (1 / DISPLAY_GAMMA)
    inside = (belongs.sum(-1) > 2).to(means)[:, None]
    over = (photos.amax(1, keepdim=True) > CLIPPED_DISPLAY_VALUE).to(means)
    clipped = (ring_profile(over, light)[0] > CLIPPED_RING_SHARE).to(means)
    weight = inside * display / means.clamp_min(1e-4) / DISPLAY_GAMMA  # of display values, not of radiance
    body, lobes = _flat(light)
    # what diffuse red, green, blue and F0 add
    rows = body.new_zeros(len(body), len(CANDIDATE_ROUGHNESSES), 3, PROFILE_RINGS, 4)
    for channel in range(3):
        rows[:, :, channel, :, channel] = body[:, None]
    rows[..., 3] = lobes[:, :, None]
    counts = (1 - clipped)[:, None]
    for _ in range(3):
        used = (weight[:, None] * counts)[..., None]
        a = (rows * used).flatten(2, 3)
        y = (means[:, None, ..., None] * used).expand(*rows.shape[:-1], 1).flatten(2, 3)
        solution = torch.linalg.solve(a.mT @ a + 1e-4 * torch.eye(4).to(a), a.mT @ y).clamp_min(0)
        made = (rows @ solution[:, :, None]).squeeze(-1)
        counts = torch.maximum((1 - clipped)[:, None], (made < means[:, None]).to(made))
    wrong = (made.clamp(1e-4, 1) ** (1 / DISPLAY_GAMMA) - display[:, None]) * inside[:, None]
    best = wrong.square().mean((2, 3)).argmin(1)
    row = torch.arange(len(best), device=best.device)
    specular, under = solution[row, best, 3, 0], solution[row, best, :3, 0]
    lobe, beneath = specular[:, None] * lobes[row, best], under.mean(1)[:, None] * body
    contrast = lobe[:, 0] / (lobe[:, 0] + beneath[:, 0] + 0.01)
    by_ring = belongs.sum(-1)
    share = (lobe * by_ring).sum(1) / ((lobe + beneath) * by_ring).sum(1).clamp_min(1e-4)
    diffuse = under / (1 - specular).clamp_min(0.1)[:, None]  # what the surface lets through reaches the body
    return Gloss(lobes.new_tensor(CANDIDATE_ROUGHNESSES)[best], specular, contrast, share, diffuse)


def _flat(light: Tensor) -> tuple[Tensor, Tensor]:
    """Radiance by ring of a flat white Lambertian patch [B, RINGS], and of lobes with F0 = 1 [B, K, RINGS]."""
    ring = torch.arange(PROFILE_RINGS, dtype=light.dtype, device=light.device) / (PROFILE_RINGS - 1)
    place = torch.stack([PROFILE_RADIUS_HALF_SIDES * ring**RING_SPACING_POWER, torch.zeros_like(ring)])[:, None]
    above = torch.cat([torch.zeros_like(light[:, :2]), light[:, 2:]], 1)
    one, up = torch.ones_like(ring)[None, None], torch.eye(3).to(light)[2, :, None, None].expand(3, 1, PROFILE_RINGS)
    body = render_maps(Maps(one.expand(3, 1, -1), 0 * one, one, up), place, above, above, falloff=1.0)
    lobes = [
        render_maps(Maps(0 * up, one, rough * one, up), place, above, above, falloff=1.0)
        for rough in CANDIDATE_ROUGHNESSES
    ]
    return body[:, 0, 0], torch.stack(lobes, 1)[:, :, 0, 0]


def find_white(photos: Tensor) -> Tensor:
    """Find px of photographs that clip and are white, as highlights are: one channel at its maximum, all near it.

    JPEG makes 250 to 255 of what clips. Paint that saturates one or two channels is not white.

    Args:
        photos: display values in [0, 1], [..., 3, H, W].

    Returns:
        A mask, bool [..., 1, H, W].
    """
    brightest, darkest = photos.amax(-3, keepdim=True), photos.amin(-3, keepdim=True)
    white: Tensor = (brightest >= CLIPPED_DISPLAY_VALUE) & (darkest >= MIN_WHITE_DISPLAY_VALUE)
    return white


def find_clipped(photos: Tensor) -> Tensor:
    """Find the px of clipped highlights: those of :func:`find_white` that are dense. Single ones are glints.

    Args:
        photos: display values in [0, 1], [T, 3, H, W].

    Returns:
        A mask, bool [T, 1, H, W].
    """
    white = find_white(photos)
    half = int(min(photos.shape[-2:]) * CLIPPED_WINDOW_HALF_SHARE)
    density = avg_pool2d(white.to(photos), 2 * half + 1, 1, half, count_include_pad=False)
    return white & (density >= MIN_CLIPPED_DENSITY)


@torch.no_grad()
def fill_clipped(maps: Maps, photos: Tensor) -> Maps:
    """Fill diffuse colour, specular colour and roughness beneath clipped highlights smoothly from their surroundings.

    Fits see nothing there but "at least so bright", and leave dark diffuse discs with bright specular ones. What is
    near to a wide highlight bears its traces and counts little; what is dark among clipped px is seen, and stays. So do
    normals: of 30 materials with known maps, fills were worse for 28. Maps of photographs that do not clip are returned
    as they are.

    Args:
        maps: [T, C, h, w] each.
        photos: display values in [0, 1], [T, 3, H, W], no finer than maps.
    """
    clipped = find_clipped(photos)
    if not clipped.any():
        return maps
    mask = clipped.to(maps.diffuse)
    margin, halo = (max(1, round(min(mask.shape[-2:]) * share)) for share in (FILL_MARGIN_SHARE, HALO_SHARE))
    covered = _grow(mask, margin)
    faded = avg_pool2d(covered, 2 * margin + 1, 1, margin, count_include_pad=False)
    low, high = FILL_FADE_DISPLAY_VALUES
    bright = ((photos.mean(1, keepdim=True) - low) / (high - low)).clamp(0, 1)
    opacity = (faded * bright).maximum(mask)
    wide = 1 - _grow(1 - mask, margin)  # a few px have no halo, and what is around them is the best guess
    known = 1 - _grow(wide, halo) * (1 - HALO_WEIGHT)
    known = torch.where(covered > 0, COVERED_WEIGHT, known)

    def fill(values: Tensor, gamma: float) -> Tensor:
        size = (values.shape[-2], values.shape[-1])
        shades = values.clamp_min(0) ** (1 / gamma)  # colours as the eye spaces them
        smooth = _fill_gaps(adaptive_avg_pool2d(shades, (mask.shape[-2], mask.shape[-1])) * known, known)
        smooth, share = (interpolate(part, size, mode="bilinear") for part in (smooth, opacity))
        return torch.where(share > 0, torch.lerp(shades, smooth, share) ** gamma, values)

    diffuse, specular, roughness, normal = maps
    return Maps(fill(diffuse, DISPLAY_GAMMA), fill(specular, DISPLAY_GAMMA), fill(roughness, 1.0), normal)


def _grow(mask: Tensor, radius: int) -> Tensor:
    """A mask [T, 1, H, W] of 0 and 1, grown by a square of such a radius in px."""
    rows = max_pool2d(mask, (2 * radius + 1, 1), 1, (radius, 0))
    grown: Tensor = max_pool2d(rows, (1, 2 * radius + 1), 1, (0, radius))
    return grown


def _fill_gaps(sums: Tensor, weights: Tensor) -> Tensor:
    """Fill gaps by pull-push (Gortler et al. 1996, "The Lumigraph"): coarser means where weights are small.

    Args:
        sums: values times weights, [T, C, H, W].
        weights: above 0 and up to 1, [T, 1, H, W].
    """
    size = (sums.shape[-2], sums.shape[-1])
    means = sums / weights
    if max(size) == 1:
        return means
    half = ((size[0] + 1) // 2, (size[1] + 1) // 2)
    coarse = _fill_gaps(adaptive_avg_pool2d(sums, half), adaptive_avg_pool2d(weights, half))
    return torch.lerp(interpolate(coarse, size, mode="bilinear"), means, weights)


def format_percent(share: float) -> str:
    """Write a share in [0, 1] as a percentage of two digits.

    >>> format_percent(0.01234), format_percent(1.0)
    ('1.2 %', '100 %')
    """
    return f"{float(f'{100 * share:.2g}'):g} %"


def clipped_highlight_warnings(photo: Tensor, effect: str, subject: str = "the photo") -> list[str]:
    """Return a clause on a photo if more than CLIPPED_PX_SHARE of its px clip and are white, else [].

    Args:
        photo: display values in [0, 1], [3, H, W].
        effect: says what that does to the maps, such as "so F0 is a lower bound".
        subject: names what is clipped.
    """
    share = float(find_white(photo).float().mean())
    clause = f"{format_percent(share)} of {subject} is clipped, {effect} (a darker exposure shows more)"
    return [clause] if share > WARNING_CLIPPED_PX_SHARE else []
