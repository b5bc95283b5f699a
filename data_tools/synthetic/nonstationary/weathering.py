"""Weathering of a patch: dirt in cavities, worn edges, scratches, stains, water, rust, smudges.

Most functions take a finished surface and return a changed one, so that families of patches combine them freely.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.nonstationary.materials import plain_material
from data_tools.synthetic.nonstationary.patch_surface import (
    PatchSurface,
    add_relief,
    blend_surfaces,
    blend_towards,
    blur_mirrored,
    cloud_noise,
    distance_to_zero,
    local_relief,
    rim_coverage,
    tint_surface,
)
from data_tools.synthetic.nonstationary.shapes import patch_coordinates
from data_tools.synthetic.patterns.fields import colour_ramp, mix, normal_to_uniform, smoothstep
from data_tools.synthetic.patterns.strokes import scatter_strokes
from data_tools.synthetic.random_values import Field, between, chance, integer_between, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import draw_palette

_DIRTS = "2a231c 3b3024 4a4034 1f1e1c 5c4a36"
_RUSTS = "3b1d10 6e2f14 a34a1a c8702a 8a4b2a 4a2a1e"
_PATINAS = "2f6f63 4f9a8a 87bfa8 1e4a48 b5c9a8"


def scale_to_unit_deviation(field: Field) -> Field:
    """Divide a field by its standard deviation."""
    return field / max(float(field.std()), 1e-6)


def add_dirt(rng: Rng, surface: PatchSurface, amount: float, hexes: str = _DIRTS) -> PatchSurface:
    """Add dirt, dust or patina in the cavities of a surface and in patches; amount 0 is next to none, 1 much."""
    size = surface.height.shape[-1]
    cavity = -scale_to_unit_deviation(local_relief(surface.height, between(rng, 1.5, 5)))
    dirtiness = cavity + between(rng, 0.4, 0.9) * cloud_noise(rng, size, log_between(rng, 1.5, 5), 2.0)
    share = smoothstep(dirtiness, 1.3 - 1.4 * amount, 2.6 - 1.1 * amount) * np.float32(between(rng, 0.6, 1.0))
    dirt = plain_material(rng, size, hexes, (0.75, 0.95))
    return blend_surfaces(surface, dirt._replace(height=blur_mirrored(surface.height, 0.8)), share)


def wear_edges(rng: Rng, surface: PatchSurface, bare: PatchSurface, amount: float) -> PatchSurface:
    """Rub the high parts of a surface down to the layer `bare`, 0.25 texels below; amount 0 (hardly) .. 1 (much)."""
    size = surface.height.shape[-1]
    edge = scale_to_unit_deviation(local_relief(surface.height, between(rng, 1.5, 3)))
    exposure = edge + between(rng, 0.4, 0.9) * cloud_noise(rng, size, log_between(rng, 2, 8), 1.7)
    level = 2.2 - 1.5 * amount
    worn = smoothstep(exposure, level, level + log_between(rng, 0.3, 1.0))
    return blend_surfaces(surface, bare._replace(height=surface.height + 0.3 * bare.height - 0.25), worn)


def add_scratches(rng: Rng, surface: PatchSurface, count: int, depth: float = 0.4) -> PatchSurface:
    """Add scratches with lifted rims, most along one direction or in all, rougher and paler than the surface.

    The depth is in texels.
    """
    size = surface.height.shape[-1]
    direction, spread = between(rng, 0, math.pi), math.pi if chance(rng, 0.4) else between(rng, 0.1, 0.7)
    longest = log_between(rng, 0.2, 0.9)
    width = between(rng, 1.2, 2.2) / size
    marks = scatter_strokes(rng, size, count, (0.05, longest), (width * 0.6, width), (direction, spread), 0.5, 0.5)
    mark = marks.of_each(uniforms(rng, marks.total)) * smoothstep(cloud_noise(rng, size, 1.5, 1.5), -1.0, 0.5)
    line = mark * (1 - marks.across**2)
    roughened = surface._replace(roughness=blend_towards(surface.roughness, between(rng, 0.35, 0.8), mark))
    tinted = tint_surface(roughened, 1 + np.float32(between(rng, -0.4, 0.8)) * mark)
    return add_relief(tinted, -np.float32(depth) * (line - 0.5 * blur_mirrored(line, 0.8)))


def add_smudges(rng: Rng, surface: PatchSurface, amount: float) -> PatchSurface:
    """Add grease, wiped traces and haze: the roughness alone changes, by up to about the amount."""
    size = surface.height.shape[-1]
    stretch = log_between(rng, 1, 6)
    haze = cloud_noise(rng, size, log_between(rng, 1.2, 4) * math.sqrt(stretch), 2.2, stretch, between(rng, 0, math.pi))
    edge = log_between(rng, 0.4, 2.0)
    share = smoothstep(haze, -edge, edge) - 0.3
    return surface._replace(roughness=surface.roughness + np.float32(amount) * share)


def add_stains(rng: Rng, surface: PatchSurface, count: int) -> PatchSurface:
    """Add spills that dried: blotches, rings of cups, drops; each dyes, and some are still wet or left a gloss."""
    size = surface.height.shape[-1]
    x, y, unit = patch_coordinates(size)
    for _ in range(count):
        radius = log_between(rng, 0.12, 0.8)
        reach = np.hypot(x - between(rng, -1, 1), y - between(rng, -1, 1))
        ragged = between(rng, 0.02, 0.35) * radius
        inside = (radius - reach + ragged * cloud_noise(rng, size, 1.5 / radius, 2.4)) * unit
        tint = draw_palette(rng, "6b4423 3b2a1c 8a6a3a 8c2f2a 2f3b46 d9c9a8 55602f", 1, 0.15)[0]
        rim = np.exp(-((inside / between(rng, 1.0, 2.5)) ** 2))
        body = smoothstep(inside, -1, between(rng, 1, 8)) * between(rng, 0.1, 0.8)
        if chance(rng, 0.3):  # the ring that a cup leaves
            body = np.exp(-((inside / between(rng, 1.0, 2.0)) ** 2)) * smoothstep(
                cloud_noise(rng, size, 2, 1.5), -1.5, 0.2
            )
        share = np.clip(body + between(rng, 0.1, 0.5) * rim, 0, 0.95)
        dye = np.exp(-between(rng, 0.8, 2.2) * share * (1 - tint[:, None, None]))
        gloss = pick(rng, (0.1, 0.2, 0.4, 0.9))
        rough = blend_towards(surface.roughness, gloss, np.clip(1.3 * body, 0, 0.95))
        surface = tint_surface(surface, dye)._replace(roughness=rough)
    return surface


def add_water(rng: Rng, surface: PatchSurface, share: float) -> PatchSurface:
    """Add water in the lowest parts, over a share of the patch, with soaked ground around it."""
    size = surface.height.shape[-1]
    bed = blur_mirrored(surface.height, 1.0)
    level = float(np.quantile(bed, share))
    deep = level - bed
    covered = smoothstep(deep, -0.15, between(rng, 0.1, 0.5))
    damp = smoothstep(deep, -between(rng, 0.8, 3.0), 0.1)
    mud = draw_palette(rng, "6b5a40 4a4a3a 3a3f40 7a6a50", 1, 0.05)[0][:, None, None]
    murk = (1 - np.exp(-np.clip(deep, 0, 9) * between(rng, 0.02, 0.25))) * covered
    diffuse = mix(surface.diffuse * (1 - np.float32(between(rng, 0.4, 0.65)) * damp), 0.6 * mud, murk)
    specular = blend_towards(surface.specular, 0.025, covered)
    rough = blend_towards(surface.roughness * (1 - np.float32(between(rng, 0.15, 0.45)) * damp), 0.1, covered)
    ripples = between(rng, 0.0, 0.12) * cloud_noise(rng, size, log_between(rng, 4, 10), 2.6)
    return PatchSurface(diffuse, specular, rough, mix(surface.height, level + ripples, covered))


def rust_layer(rng: Rng, size: int) -> PatchSurface:
    """Draw rust, or in one of five draws the green of copper: rough, lumpy, of several tones."""
    coarse, fine = (
        cloud_noise(rng, size, log_between(rng, 2, 6), 1.6),
        cloud_noise(rng, size, log_between(rng, 8, 16), 1.2),
    )
    colours = draw_palette(rng, _PATINAS if chance(rng, 0.2) else _RUSTS, 4, 0.08)
    diffuse = colour_ramp(normal_to_uniform(0.6 * coarse + 0.35 * fine), colours)
    specular = np.full((3, size, size), 0.04, np.float32)
    lumps = between(rng, 0.2, 0.6) * fine + between(rng, 0, 0.8) * coarse
    return PatchSurface(diffuse, specular, 0.86 + 0.05 * fine, lumps)


def add_rust(rng: Rng, surface: PatchSurface, amount: float, bias: Field | float = 0.0) -> PatchSurface:
    """Add rust that breaks through: it lifts or eats the surface, and dyes a halo around; amount -1 .. 1.

    The bias [S, S] is added to the amount, so that one side may rust more than the other.
    """
    size = surface.height.shape[-1]
    stretch, frequency = (log_between(rng, 1.5, 4) if chance(rng, 0.3) else 1.0), log_between(rng, 1.5, 6)
    spread = (
        cloud_noise(rng, size, frequency, between(rng, 1.3, 2.2), stretch, between(rng, 0, math.pi)) + bias + amount
    )
    inside = distance_to_zero(blur_mirrored(spread, 0.7))
    crust = rust_layer(rng, size)
    eaten = rim_coverage(inside)
    halo = smoothstep(spread, -between(rng, 0.3, 0.9), 0.0) * (1 - eaten) * between(rng, 0.2, 0.7)
    haloed = blend_surfaces(surface, crust._replace(height=surface.height), halo)
    swell = np.float32(between(rng, -1.5, 1.2)) * smoothstep(inside, -0.5, log_between(rng, 1.5, 6))
    return add_relief(blend_surfaces(haloed, crust._replace(height=0.4 * surface.height + crust.height), eaten), swell)


def add_dents(rng: Rng, surface: PatchSurface, count: int) -> PatchSurface:
    """Add broad dents, of a depth in texels."""
    size = surface.height.shape[-1]
    y, x = np.mgrid[:size, :size].astype(np.float32)
    relief = np.zeros((size, size), np.float32)
    for _ in range(count):
        width = log_between(rng, 3, 20)
        squared_distance = ((x - between(rng, 0, size)) ** 2 + (y - between(rng, 0, size)) ** 2) / np.float32(width**2)
        relief -= np.float32(between(rng, 0.05, 0.25) * width) * np.exp(-squared_distance)
    return add_relief(surface, relief)


def add_random_wear(rng: Rng, surface: PatchSurface) -> PatchSurface:
    """Add smudges, and in three of four draws also dirt, scratches or a stain, as on most things in use."""
    surface = add_smudges(rng, surface, between(rng, 0.1, 0.5))
    kind = pick(rng, ("none", "dirty", "scratched", "stained"))
    if kind == "dirty":
        return add_dirt(rng, surface, between(rng, 0.0, 0.6))
    if kind == "scratched":
        return add_scratches(rng, surface, integer_between(rng, 4, 25), between(rng, 0.1, 0.5))
    return add_stains(rng, surface, 1) if kind == "stained" else surface
