"""The scars that a highlight leaves in maps of one photograph: discs and halos of another colour, gloss or roughness.

Beneath a highlight a photograph tells little of the diffuse colour, and as much of the lens and of relief as of gloss.
What maps have there is what their surroundings have, unless the material varies as much elsewhere.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate

from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.appearance.highlight import FILL_PX, fill_gaps
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import Flash, render_photo
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED_LINEAR_VALUE

COARSE_CELLS = 32  # side of the coarse maps that are compared and filled
MIN_TRUST = 1e-4  # for photographs that are clipped all over
HIDDEN_TRUST = 0.4  # texels of less are said to lie beneath a highlight
# The parts of a colour that are judged by themselves: its mean, and two differences of its channels
COLOUR_PARTS = ((1 / 3, 1 / 3, 1 / 3), (1.0, -1.0, 0.0), (-0.5, -0.5, 1.0))
# Specular colours, medians of maps, up to which and from which on a material counts as a dielectric and as a metal: a
# metal has no other light than its highlights, in which its colour is seen best.
MAX_DIELECTRIC_F0, MIN_METAL_F0 = 0.08, 0.11
# How much larger than elsewhere, in squares, a change beneath a highlight must be: fills that always count leave no
# scar on 13 photographs, but blur 48 materials of known maps by 2 % (log radiance).
MIN_ENERGY_RATIO = 1.5


@torch.no_grad()
def trust_texels(maps: Maps, radiance: Tensor, flash: Flash, positions: Tensor | None = None) -> Tensor:
    """Return how much a photograph tells of each texel, [T, 1, H, W]: 1, and less beneath a highlight.

    It is the photograph's typical light over the sum of that light and of the texel's specular lobe.

    Args:
        maps: the maps of the material, [T, C, H, W].
        radiance: their radiance under the flash, [T, 3, H, W].
        flash: the flash of the photograph.
        positions: the positions of the texels in the patch, [T, 2, H, W]; None for maps of the whole patch.
    """
    body = maps._replace(diffuse=maps.diffuse * (1 - maps.specular), specular=torch.zeros_like(maps.specular))
    light = radiance.mean(1, keepdim=True)
    lobe = (light - render_photo(body, flash, positions).mean(1, keepdim=True)).clamp_min(0)
    typical_light, typical_lobe = (
        values.flatten(1).median(1).values[:, None, None, None].clamp_min(1e-4) for values in (light, lobe)
    )
    trust: Tensor = ((typical_light + typical_lobe) / (typical_light + lobe)).clamp(max=1)
    return trust


@torch.no_grad()
def hidden_share(maps: Maps, flash: Flash) -> Tensor:
    """Return the share of texels that lie beneath a highlight, [T]; 0 of metals, whose colour it shows."""
    trust = trust_texels(maps, render_photo(maps, flash), flash)
    return (trust < HIDDEN_TRUST).float().mean((1, 2, 3)) * (_dielectric_share(maps) > 0)


@torch.no_grad()
def remove_scars(maps: Maps, photo: Tensor, flash: Flash) -> Maps:
    """Return maps whose diffuse colour, specular colour and roughness are filled beneath highlights; normals stay.

    Coarse maps are filled smoothly from where the photograph tells more, and details stay. A fill counts as far as it
    changes a map more than fills of the same shape change it at eight other places. Metals stay as they are.

    Args:
        maps: the maps, [T, C, H, W].
        photo: the linear photograph, [T, 3, H, W].
        flash: its flash.
    """
    size = (min(FILL_PX, photo.shape[-2]), min(FILL_PX, photo.shape[-1]))
    small_maps = Maps(*(adaptive_avg_pool2d(values, size) for values in maps))
    is_clipped = (adaptive_avg_pool2d(photo, size) > CLIPPED_LINEAR_VALUE).any(1, keepdim=True)
    trust = trust_texels(small_maps, render_photo(small_maps, flash), flash)
    weights = torch.where(is_clipped, 0, trust).square().clamp_min(MIN_TRUST)

    dielectric_share = _dielectric_share(small_maps)[:, None, None, None]

    def fill(values: Tensor, small_values: Tensor, gamma: float) -> Tensor:
        change = dielectric_share * _find_scars(small_values.clamp_min(0) ** (1 / gamma), weights)
        finer_change = interpolate(change, values.shape[-2:], mode="bicubic")
        return (values.clamp_min(0) ** (1 / gamma) - finer_change).clamp(0, 1) ** gamma

    return Maps(
        fill(maps.diffuse, small_maps.diffuse, DISPLAY_GAMMA),
        fill(maps.specular, small_maps.specular, DISPLAY_GAMMA),
        fill(maps.roughness, small_maps.roughness, 1.0),
        maps.normal,
    )


def _dielectric_share(maps: Maps) -> Tensor:
    """Return how surely materials are dielectrics, [T]: 1 up to MAX_DIELECTRIC_F0, 0 from MIN_METAL_F0 on."""
    typical_f0 = maps.specular.mean(1).flatten(1).median(1).values
    return ((MIN_METAL_F0 - typical_f0) / (MIN_METAL_F0 - MAX_DIELECTRIC_F0)).clamp(0, 1)


def _find_scars(shades: Tensor, weights: Tensor) -> Tensor:
    """Return what of shades [T, C, H, W] is a scar, [T, C, COARSE_CELLS, COARSE_CELLS]: shades less their fill.

    Args:
        shades: values in steps that look equal.
        weights: how much they count, [T, 1, H, W], above 0 and up to 1.
    """
    cells = (COARSE_CELLS, COARSE_CELLS)
    to_parts = shades.new_tensor(COLOUR_PARTS if shades.shape[1] == 3 else [[1.0]])
    coarse, weighted = (
        torch.einsum("pc,tchw->tphw", to_parts, adaptive_avg_pool2d(values, cells))
        for values in (shades, shades * weights)
    )
    coarse_weights = adaptive_avg_pool2d(weights, cells)
    change = coarse - fill_gaps(weighted, coarse_weights)
    third = COARSE_CELLS // 3
    shifts = [(rows, columns) for rows in (-third, 0, third) for columns in (-third, 0, third) if rows or columns]
    energies = []
    for shift in shifts:
        moved_weights = coarse_weights.roll(shift, (2, 3))
        moved_change = coarse - fill_gaps(coarse * moved_weights, moved_weights)
        energies.append(_mean_square(moved_change, 1 - moved_weights))
    usual_energy = torch.stack(energies).mean(0)
    energy = _mean_square(change, 1 - coarse_weights).clamp_min(1e-9)
    share = (1 - MIN_ENERGY_RATIO * usual_energy / energy).clamp(0, 1)
    scars: Tensor = torch.einsum("cp,tphw->tchw", torch.linalg.inv(to_parts), share * change)
    return scars


def _mean_square(values: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted means of squares of values [T, P, H, W], by weights [T, 1, H, W]: [T, P, 1, 1]."""
    total_weight = weights.sum((2, 3), keepdim=True).clamp_min(1e-6)
    means: Tensor = (weights * values * values).sum((2, 3), keepdim=True) / total_weight
    return means
