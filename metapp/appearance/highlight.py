"""The fall-off of brightness about the flash in a photo of a flat, even material, and the gloss that it shows."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from metapp.appearance.flash import GAMMA, Maps, positions, render
from metapp.appearance.order import flattened

RINGS = 24
REACH_HALF_SIDES = 1.5  # half sides of the patch from the flash to the last ring
RING_POWER = 1.5  # power by which rings are closer together near the flash
ROUGHNESSES = tuple(0.08 * 1.12**i for i in range(22))  # 0.08 to 0.86
CLIPPED_VALUE, CLIPPED_SHARE = 0.98, 0.02  # a ring with a larger share of px above says no more than "so bright"
# Of flat materials whose photos have fewer clipped px the highlight says at least 0.75 of F0, of those with more down
# to 0.34 (9 in 10 of 136 renderings, roughness 0.16 to 0.6, F0 up to 1).
CLIPPED_PX_SHARE = 0.01


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


def profile(pictures: Tensor, light: Tensor) -> tuple[Tensor, Tensor]:
    """Means of pictures [..., C, H, W] in rings about the point below the flash [..., 3].

    Returns:
        Means [..., C, RINGS], and by how much each px belongs to each ring, linear between two, [..., RINGS, H W].
    """
    place = positions(*pictures.shape[-2:], dtype=light.dtype, device=light.device).flatten(1)
    distance = (place - light[..., :2, None]).square().sum(-2).sqrt()
    at = (distance / REACH_HALF_SIDES).clamp_max(1) ** (1 / RING_POWER) * (RINGS - 1)
    ring = torch.arange(RINGS, dtype=light.dtype, device=light.device)[:, None]
    belongs = (1 - (at[..., None, :] - ring).abs()).clamp_min(0)
    means = pictures.flatten(-2) @ belongs.mT / belongs.sum(-1).clamp_min(1e-3)[..., None, :]
    return means, belongs


def unlit(pictures: Tensor, light: Tensor) -> Tensor:
    """Pictures [..., C, H, W] of display values under a flash [..., 3] as if all rings about it were as bright."""
    means, belongs = profile(pictures, light)
    around = (means @ belongs).unflatten(-1, pictures.shape[-2:]).clamp_min(0.02)
    even: Tensor = pictures * pictures.mean((-1, -2), keepdim=True) / around
    return even


def evenly_lit(photos: Tensor, light: Tensor) -> Tensor:
    """Photos [..., 3, H, W] under a flash [..., 3] as if the light were the same everywhere."""
    return flattened(unlit(photos, light))


@torch.no_grad()
def gloss(photos: Tensor, light: Tensor) -> Gloss:
    """The gloss of the flat even material whose profile is most like that of photos [B, 3, H, W].

    A Lambertian body of any colour under one GGX lobe without colour: linear in both but where the photo is clipped.

    Args:
        photos: display values in [0, 1].
        light: position of the flash, and the camera above the same point, [B, 3].

    Returns:
        Roughness to about 10 %, below 0.2, where the lobe is a few px wide, to 25 %.
    """
    means, belongs = profile(photos.clamp(1e-3, 1) ** GAMMA, light)
    display = means.clamp_min(1e-4) ** (1 / GAMMA)
    inside = (belongs.sum(-1) > 2).to(means)[:, None]
    over = (photos.amax(1, keepdim=True) > CLIPPED_VALUE).to(means)
    clipped = (profile(over, light)[0] > CLIPPED_SHARE).to(means)
    weight = inside * display / means.clamp_min(1e-4) / GAMMA  # of display values, not of radiance
    body, lobes = _flat(light)
    # what diffuse red, green, blue and F0 add
    rows = body.new_zeros(len(body), len(ROUGHNESSES), 3, RINGS, 4)
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
    wrong = (made.clamp(1e-4, 1) ** (1 / GAMMA) - display[:, None]) * inside[:, None]
    best = wrong.square().mean((2, 3)).argmin(1)
    row = torch.arange(len(best), device=best.device)
    specular, under = solution[row, best, 3, 0], solution[row, best, :3, 0]
    lobe, beneath = specular[:, None] * lobes[row, best], under.mean(1)[:, None] * body
    contrast = lobe[:, 0] / (lobe[:, 0] + beneath[:, 0] + 0.01)
    by_ring = belongs.sum(-1)
    share = (lobe * by_ring).sum(1) / ((lobe + beneath) * by_ring).sum(1).clamp_min(1e-4)
    diffuse = under / (1 - specular).clamp_min(0.1)[:, None]  # what the surface lets through reaches the body
    return Gloss(lobes.new_tensor(ROUGHNESSES)[best], specular, contrast, share, diffuse)


def _flat(light: Tensor) -> tuple[Tensor, Tensor]:
    """Radiance by ring of a flat white Lambertian patch [B, RINGS], and of lobes with F0 = 1 [B, K, RINGS]."""
    ring = torch.arange(RINGS, dtype=light.dtype, device=light.device) / (RINGS - 1)
    place = torch.stack([REACH_HALF_SIDES * ring**RING_POWER, torch.zeros_like(ring)])[:, None]
    above = torch.cat([torch.zeros_like(light[:, :2]), light[:, 2:]], 1)
    one, up = torch.ones_like(ring)[None, None], torch.eye(3).to(light)[2, :, None, None].expand(3, 1, RINGS)
    body = render(Maps(one.expand(3, 1, -1), 0 * one, one, up), place, above, above, falloff=1.0)
    lobes = [render(Maps(0 * up, one, rough * one, up), place, above, above, falloff=1.0) for rough in ROUGHNESSES]
    return body[:, 0, 0], torch.stack(lobes, 1)[:, :, 0, 0]


def clipped_highlight(photo: Tensor) -> list[str]:
    """A clause on the highlight of a photo [3, H, W], up to 255, if it is clipped; else []."""
    share = float((photo == 255).all(0).float().mean())
    clause = f"the photo is clipped in {100 * share:.2g} % of its px, so F0 is a lower bound"
    return [clause] if share > CLIPPED_PX_SHARE else []
