"""The fall-off of brightness about the flash in a photo, the gloss that it shows, and highlights that clip.

All of it is measured on the photo itself, before or without any fit; maps come in only to be filled where a photo
clips.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, interpolate, max_pool2d

from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.appearance.doubts import CLIPPED_HIGHLIGHT
from metapp.appearance.flash import render_maps, texel_positions
from metapp.appearance.lattice import even_out_brightness
from metapp.appearance.svbrdf_maps import Maps

PROFILE_RINGS = 24  # number of rings about the flash
PROFILE_RADIUS_HALF_SIDES = 1.5  # half sides of the patch from the flash to the last ring
RING_SPACING_POWER = 1.5  # power by which rings are closer together near the flash
CANDIDATE_ROUGHNESSES = tuple(0.08 * 1.12**i for i in range(22))  # 0.08 to 0.86
CLIPPED_DISPLAY_VALUE = 0.98  # display value from which a channel counts as clipped
CLIPPED_RING_SHARE = 0.02  # a ring with a larger share of clipped px says no more than "so bright"
MIN_WHITE_DISPLAY_VALUE = 0.9  # least channel of a clipped highlight; paint that saturates one or two channels has less
CLIPPED_WINDOW_HALF_SHARE = 1 / 128  # half the side of the window of a clipped px's surroundings, in sides of the photo
MIN_CLIPPED_DENSITY = 0.5  # least share of clipped px in the window
F0_BOUND_CLAUSE = "so F0 is a lower bound"
FILL_PX = 256  # side at which clipped px are found and fills are made, which are smooth
FILL_MARGIN_SHARE = 1 / 64  # margin by which fills reach beyond clipped px, and over which they fade, in sides
FILL_FADE_DISPLAY_VALUES = (0.4, 0.8)  # mean display values: px of the margin below are not filled, px above fully
HALO_SHARE = 3 / 16  # distance, in sides, up to which maps beside a wide highlight bear its traces
HALO_WEIGHT = 1e-3  # weight of maps in the halo as sources of the fill
COVERED_WEIGHT = 1e-6  # weight of maps beneath the fill, for photos where there is nothing else to fill from


class Gloss(NamedTuple):
    """The gloss of a material by the profile of its highlight.

    Attributes:
        roughness: [B], roughness of the flat even material that looks most alike.
        specular: [B], its F0.
        central_lobe_share: [B], the lobe's share of the light that is reflected right below the flash, 0 to 1.
        lobe_share: [B], the lobe's share of all light that the photo's patch reflects, 0 to 1.
        diffuse: [B, 3], its diffuse albedo, linear RGB.
    """

    roughness: Tensor
    specular: Tensor
    central_lobe_share: Tensor
    lobe_share: Tensor
    diffuse: Tensor


def ring_profile(pictures: Tensor, light: Tensor) -> tuple[Tensor, Tensor]:
    """Compute means of pictures in rings about the point below the flash.

    Args:
        pictures: [..., C, H, W].
        light: position of the flash in half sides of the patch, [..., 3].

    Returns:
        Means [..., C, PROFILE_RINGS], and by how much each px belongs to each ring, linear between two,
        [..., PROFILE_RINGS, H W].
    """
    positions = texel_positions(*pictures.shape[-2:], dtype=light.dtype, device=light.device).flatten(1)
    distance = (positions - light[..., :2, None]).square().sum(-2).sqrt()
    ring_coordinate = (distance / PROFILE_RADIUS_HALF_SIDES).clamp_max(1) ** (1 / RING_SPACING_POWER) * (
        PROFILE_RINGS - 1
    )
    ring = torch.arange(PROFILE_RINGS, dtype=light.dtype, device=light.device)[:, None]
    memberships = (1 - (ring_coordinate[..., None, :] - ring).abs()).clamp_min(0)
    means = pictures.flatten(-2) @ memberships.mT / memberships.sum(-1).clamp_min(1e-3)[..., None, :]
    return means, memberships


def remove_flash_falloff(pictures: Tensor, light: Tensor) -> Tensor:
    """Scale pictures of display values as if all rings about the flash were equally bright.

    Args:
        pictures: [..., C, H, W].
        light: position of the flash in half sides of the patch, [..., 3].
    """
    means, memberships = ring_profile(pictures, light)
    ring_brightness = (means @ memberships).unflatten(-1, pictures.shape[-2:]).clamp_min(0.02)
    scaled: Tensor = pictures * pictures.mean((-1, -2), keepdim=True) / ring_brightness
    return scaled


def remove_shading(photos: Tensor, light: Tensor) -> Tensor:
    """Scale photos as if the light were the same everywhere: by rings about the flash, then by local means.

    Args:
        photos: display values [..., 3, H, W].
        light: position of the flash in half sides of the patch, [..., 3].
    """
    return even_out_brightness(remove_flash_falloff(photos, light))


@torch.no_grad()
def estimate_gloss(photos: Tensor, light: Tensor) -> Gloss:
    """Estimate the gloss of the flat even material whose profile is most like the profile of photos.

    The material is a Lambertian body of any colour under one GGX lobe without colour: radiance is linear in both but
    where the photo is clipped.

    Args:
        photos: display values in [0, 1], [B, 3, H, W].
        light: position of the flash, and the camera above the same point, [B, 3].

    Returns:
        Roughness to about 10 %, below 0.2, where the lobe is a few px wide, to 25 %.
    """
    means, memberships = ring_profile(photos.clamp(1e-3, 1) ** DISPLAY_GAMMA, light)
    display = means.clamp_min(1e-4) ** (1 / DISPLAY_GAMMA)
    covered_rings = (memberships.sum(-1) > 2).to(means)[:, None]
    is_clipped = (photos.amax(1, keepdim=True) > CLIPPED_DISPLAY_VALUE).to(means)
    clipped_rings = (ring_profile(is_clipped, light)[0] > CLIPPED_RING_SHARE).to(means)
    # derivative of display values by radiance: differences count as they are seen
    weight = covered_rings * display / means.clamp_min(1e-4) / DISPLAY_GAMMA
    body, lobes = _flat_profiles(light)
    # radiance by diffuse red, green, blue and F0, of each candidate roughness, channel and ring
    terms = body.new_zeros(len(body), len(CANDIDATE_ROUGHNESSES), 3, PROFILE_RINGS, 4)
    for channel in range(3):
        terms[:, :, channel, :, channel] = body[:, None]
    terms[..., 3] = lobes[:, :, None]
    counted_rings = (1 - clipped_rings)[:, None]
    for _ in range(3):  # a clipped ring is a lower bound: it counts only where the fit is darker
        row_weights = (weight[:, None] * counted_rings)[..., None]
        weighted_rows = (terms * row_weights).flatten(2, 3)
        weighted_means = (means[:, None, ..., None] * row_weights).expand(*terms.shape[:-1], 1).flatten(2, 3)
        solution = torch.linalg.solve(
            weighted_rows.mT @ weighted_rows + 1e-4 * torch.eye(4).to(weighted_rows), weighted_rows.mT @ weighted_means
        ).clamp_min(0)
        fitted = (terms @ solution[:, :, None]).squeeze(-1)
        counted_rings = torch.maximum((1 - clipped_rings)[:, None], (fitted < means[:, None]).to(fitted))
    differences = (fitted.clamp(1e-4, 1) ** (1 / DISPLAY_GAMMA) - display[:, None]) * covered_rings[:, None]
    best = differences.square().mean((2, 3)).argmin(1)
    batch_rows = torch.arange(len(best), device=best.device)
    specular, body_colour = solution[batch_rows, best, 3, 0], solution[batch_rows, best, :3, 0]
    lobe_profile, body_profile = specular[:, None] * lobes[batch_rows, best], body_colour.mean(1)[:, None] * body
    central_lobe_share = lobe_profile[:, 0] / (lobe_profile[:, 0] + body_profile[:, 0] + 0.01)
    ring_sizes = memberships.sum(-1)
    lobe_share = (lobe_profile * ring_sizes).sum(1) / ((lobe_profile + body_profile) * ring_sizes).sum(1).clamp_min(
        1e-4
    )
    # the body reflects the light that the surface lets through
    diffuse = body_colour / (1 - specular).clamp_min(0.1)[:, None]
    return Gloss(lobes.new_tensor(CANDIDATE_ROUGHNESSES)[best], specular, central_lobe_share, lobe_share, diffuse)


def _flat_profiles(light: Tensor) -> tuple[Tensor, Tensor]:
    """Compute radiance by ring of a flat white Lambertian patch, and of lobes with F0 = 1 of each candidate roughness.

    Args:
        light: position of the flash in half sides of the patch, [B, 3].

    Returns:
        [B, PROFILE_RINGS] and [B, K, PROFILE_RINGS].
    """
    ring = torch.arange(PROFILE_RINGS, dtype=light.dtype, device=light.device) / (PROFILE_RINGS - 1)
    positions = torch.stack([PROFILE_RADIUS_HALF_SIDES * ring**RING_SPACING_POWER, torch.zeros_like(ring)])[:, None]
    centred_light = torch.cat([torch.zeros_like(light[:, :2]), light[:, 2:]], 1)
    ones, up = torch.ones_like(ring)[None, None], torch.eye(3).to(light)[2, :, None, None].expand(3, 1, PROFILE_RINGS)
    body = render_maps(
        Maps(ones.expand(3, 1, -1), 0 * ones, ones, up), positions, centred_light, centred_light, falloff=1.0
    )
    lobes = [
        render_maps(Maps(0 * up, ones, roughness * ones, up), positions, centred_light, centred_light, falloff=1.0)
        for roughness in CANDIDATE_ROUGHNESSES
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
    """Find the px of clipped highlights: dense px of :func:`find_white`. Single ones are glints.

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

    Fits see nothing there but "at least so bright", and leave dark diffuse discs with bright specular ones. Maps beside
    a wide highlight bear its traces and count little; dark px among clipped ones are seen, and stay. So do normals: of
    30 materials with known maps, fills were worse for 28. Maps of photographs that do not clip stay as they are.

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
    fading = avg_pool2d(covered, 2 * margin + 1, 1, margin, count_include_pad=False)
    low, high = FILL_FADE_DISPLAY_VALUES
    brightness = ((photos.mean(1, keepdim=True) - low) / (high - low)).clamp(0, 1)
    opacity = (fading * brightness).maximum(mask)
    # highlights of few px have no halo, and their surroundings are the best guess
    wide_mask = 1 - _grow(1 - mask, margin)
    source_weights = 1 - _grow(wide_mask, halo) * (1 - HALO_WEIGHT)
    source_weights = torch.where(covered > 0, COVERED_WEIGHT, source_weights)

    def fill(values: Tensor, gamma: float) -> Tensor:
        size = (values.shape[-2], values.shape[-1])
        shades = values.clamp_min(0) ** (1 / gamma)  # colours in steps that look equal
        smooth = fill_gaps(
            adaptive_avg_pool2d(shades, (mask.shape[-2], mask.shape[-1])) * source_weights, source_weights
        )
        smooth, share = (interpolate(part, size, mode="bilinear") for part in (smooth, opacity))
        return torch.where(share > 0, torch.lerp(shades, smooth, share) ** gamma, values)

    diffuse, specular, roughness, normal = maps
    return Maps(fill(diffuse, DISPLAY_GAMMA), fill(specular, DISPLAY_GAMMA), fill(roughness, 1.0), normal)


def _grow(mask: Tensor, radius: int) -> Tensor:
    """Grow a mask [T, 1, H, W] of 0 and 1 by a square whose half side is `radius` px."""
    rows = max_pool2d(mask, (2 * radius + 1, 1), 1, (radius, 0))
    grown: Tensor = max_pool2d(rows, (1, 2 * radius + 1), 1, (0, radius))
    return grown


def fill_gaps(sums: Tensor, weights: Tensor) -> Tensor:
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
    coarse = fill_gaps(adaptive_avg_pool2d(sums, half), adaptive_avg_pool2d(weights, half))
    return torch.lerp(interpolate(coarse, size, mode="bilinear"), means, weights)


def clipped_highlight_warnings(photo: Tensor, effect: str, subject: str = "the photo") -> list[str]:
    """Return a clause on a photo of whose px more than a few clip and are white, else [].

    Args:
        photo: display values in [0, 1], [3, H, W].
        effect: says what clipping does to the maps, such as "so F0 is a lower bound".
        subject: names the clipped photo.
    """
    return CLIPPED_HIGHLIGHT.about(float(find_white(photo).float().mean()), effect=effect, subject=subject)
