"""The materials of a patch's layers: metals, paints, plastics, and pieces of the procedural materials.

The families of patches choose among them. Where a layer lies on the patch, and what has worn it, is not known here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.nonstationary.patch_surface import PatchSurface, cloud_noise
from data_tools.synthetic.patterns.cells import isotropic_cells
from data_tools.synthetic.patterns.fields import band_noise, texel_centres
from data_tools.synthetic.random_values import Field, Ids, between, chance, log_between, pick, uniforms
from data_tools.synthetic.stationary.families import FAMILIES
from data_tools.synthetic.stationary.periodic_maps import draw_dye_colours, draw_palette, uniform_colour, vary_albedo

# Reflectance of metals at normal incidence, linear RGB.
METAL_REFLECTANCES: dict[str, tuple[float, float, float]] = {
    "steel": (0.56, 0.57, 0.58),
    "aluminium": (0.91, 0.92, 0.92),
    "gold": (1.0, 0.77, 0.34),
    "copper": (0.95, 0.64, 0.54),
    "brass": (0.91, 0.78, 0.42),
    "bronze": (0.71, 0.52, 0.33),
    "silver": (0.97, 0.96, 0.91),
    "titanium": (0.54, 0.50, 0.45),
}
_PAINTS = "f2f0ea e8dcc0 c03028 d9a017 2f6f9f 6fa8b8 3f7f4f e07a2f b8bcc0 7a8a90 1c1d20 d8b8b0"

WARM_METALS = ("gold", "copper", "brass", "bronze")
GRAY_METALS = ("steel", "aluminium", "titanium", "silver")

STONE_FAMILIES = ("marble", "granite", "terrazzo", "grain", "marble")
WOOD_FAMILIES = ("wood",)
CLOTH_FAMILIES = ("weave", "knit", "stripes", "weave")
GROUND_FAMILIES = ("gravel", "cracks", "grain", "bricks", "granite", "tiles", "shingles")


def procedural_piece(rng: Rng, size: int, names: Sequence[str], zoom: tuple[float, float] = (0.5, 1.0)) -> PatchSurface:
    """Draw a piece of one of the procedural materials, at any place and angle, enlarged by up to 1 / zoom."""
    maps = FAMILIES[pick(rng, names)](rng, size)
    share = log_between(rng, *zoom)
    angle = pick(rng, (0.0, math.pi / 2)) if chance(rng, 0.4) else between(rng, 0, math.tau)
    cos, sin = (np.float32(share * size * component) for component in (math.cos(angle), math.sin(angle)))
    x, y = texel_centres(size)
    planes = _interpolate_periodic(
        np.concatenate(maps), x * cos - y * sin + between(rng, 0, size), x * sin + y * cos + between(rng, 0, size)
    )
    roughness = np.clip(planes[4], 0.1, 0.95)
    # The reflectance stays that of a dielectric: metals are drawn by `bare_metal`.
    specular = np.broadcast_to(np.clip(planes[3], 0.03, 0.08), (3, size, size))
    return PatchSurface(planes[:3], specular, roughness, (planes[5] - planes[5].mean()) / np.float32(share))


def _interpolate_periodic(planes: Field, x: Field, y: Field) -> Field:
    """Interpolate periodic planes [C, S, S] linearly at texel coordinates x and y, each [S, S]: [C, S, S]."""
    size = planes.shape[-1]
    left, top = np.floor(x), np.floor(y)
    fx, fy = x - left, y - top
    i, j = left.astype(np.int64) % size, top.astype(np.int64) % size
    i2, j2 = (i + 1) % size, (j + 1) % size
    texels = planes.reshape(len(planes), -1)
    upper = texels[:, j * size + i] * (1 - fx) + texels[:, j * size + i2] * fx
    lower = texels[:, j2 * size + i] * (1 - fx) + texels[:, j2 * size + i2] * fx
    return (upper * (1 - fy) + lower * fy).astype(np.float32)


def shuffle_cells(rng: Rng, surface: PatchSurface, cell: Ids, total: int) -> PatchSurface:
    """Show another part of a surface in each cell, half of them turned upside down; `cell` [S, S] is 0 .. total - 1."""
    size = cell.shape[-1]
    draws = uniforms(rng, 3, total)
    columns, rows = np.meshgrid(np.arange(size), np.arange(size))
    flip = (draws[2] < 0.5)[cell]
    dx = (draws[0] * size).astype(np.int64)[cell]
    x = np.where(flip, -columns, columns) + dx
    y = np.where(flip, -rows, rows) + (draws[1] * size).astype(np.int64)[cell]
    # The surface is mirrored beyond its borders, since a patch need not repeat.
    i, j = (
        size - 1 - np.abs(coordinate % (2 * size) - size + (coordinate % (2 * size) < size)) for coordinate in (x, y)
    )
    return PatchSurface(*(field[..., j, i] for field in surface))


def bare_metal(
    rng: Rng, size: int, names: Sequence[str] = tuple(METAL_REFLECTANCES), roughness: tuple[float, float] = (0.15, 0.5)
) -> PatchSurface:
    """Draw a bare metal: polished, brushed, hammered, cast, or spun about a point."""
    tint = np.array(METAL_REFLECTANCES[pick(rng, names)], np.float32) * np.float32(between(rng, 0.75, 1.0))
    kind = pick(rng, ("polished", "brushed", "brushed", "hammered", "cast", "spun"))
    mean_roughness, tarnish = (
        between(rng, *roughness),
        cloud_noise(rng, size, log_between(rng, 1.5, 6), between(rng, 1.2, 2.2)),
    )
    roughness_map = mean_roughness + 0.05 * tarnish
    height = 0.03 * cloud_noise(rng, size, 12, 1.0)
    if kind == "brushed":
        lines = band_noise(rng, size, log_between(rng, 25, 60), 0.7, log_between(rng, 8, 60), between(rng, 0, math.pi))
        height, roughness_map = between(rng, 0.03, 0.12) * lines, roughness_map + 0.05 * lines + 0.05
    elif kind == "hammered":
        dents = isotropic_cells(rng, size, log_between(rng, 4, 11), 0.8)
        height = np.minimum(dents.nearest**2, 0.7) * np.float32(between(rng, 0.4, 1.3))
    elif kind == "cast":
        lumps = cloud_noise(rng, size, log_between(rng, 10, 30), 0.9)
        height, roughness_map = between(rng, 0.08, 0.3) * lumps, roughness_map + 0.2 - 0.03 * lumps
    elif kind == "spun":
        x, y = texel_centres(size)
        reach = np.hypot(x - between(rng, -0.2, 1.2), y - between(rng, -0.2, 1.2)) * size / 2
        ring = uniforms(rng, 2 * size)[reach.astype(np.int64)] - 0.5
        height, roughness_map = between(rng, 0.08, 0.25) * ring, roughness_map + 0.12 * ring
    specular = uniform_colour(tint, size) * np.exp(np.float32(-0.06) * np.clip(tarnish, -1, 3))
    return PatchSurface(uniform_colour(tint * np.float32(0.02), size), np.minimum(specular, 1), roughness_map, height)


def paint_coat(
    rng: Rng, size: int, colour: Field | None = None, roughness: tuple[float, float] = (0.12, 0.6)
) -> PatchSurface:
    """Draw a coat of paint, lacquer or enamel: smooth, or with an orange-peel relief, or brushed on."""
    tint = colour
    if tint is None:
        tint = draw_dye_colours(rng, 1)[0] if chance(rng, 0.3) else draw_palette(rng, _PAINTS, 1, 0.1)[0]
    bumps = cloud_noise(rng, size, log_between(rng, 8, 25), 2.0)
    if chance(rng, 0.25):
        bumps = bumps + 2 * band_noise(rng, size, log_between(rng, 15, 40), 0.5, 12, between(rng, 0, math.pi))
    worn = cloud_noise(rng, size, log_between(rng, 1.2, 4), 1.8)
    diffuse = vary_albedo(uniform_colour(np.clip(tint, 0.02, 0.8), size), worn, between(rng, 0.01, 0.08))
    specular = np.full((3, size, size), between(rng, 0.035, 0.06), np.float32)
    return PatchSurface(diffuse, specular, between(rng, *roughness) + 0.04 * worn, between(rng, 0.01, 0.15) * bumps)


def plain_material(
    rng: Rng, size: int, hexes: str, roughness: tuple[float, float], relief: float = 0.1
) -> PatchSurface:
    """Draw a material of about one colour from a palette, such as earth, dust or mortar.

    The relief is a standard deviation in texels, about; the roughness is from its range.
    """
    fine, broad = cloud_noise(rng, size, 20, 0.8), cloud_noise(rng, size, log_between(rng, 1.5, 5), 1.6)
    diffuse = vary_albedo(
        uniform_colour(draw_palette(rng, hexes, 1, 0.05)[0], size), 0.7 * fine + 0.7 * broad, between(rng, 0.05, 0.2)
    )
    specular = np.full((3, size, size), between(rng, 0.03, 0.05), np.float32)
    rough = between(rng, *roughness) + 0.03 * fine + 0.03 * broad
    return PatchSurface(diffuse, specular, rough, relief * (0.7 * fine + broad))


def varnish_surface(surface: PatchSurface, roughness: float, flatness: float = 1.0) -> PatchSurface:
    """Lay a clear varnish on a surface; it fills the share `flatness` of the relief and sets the mean roughness."""
    rough = np.full_like(surface.roughness, roughness) + 0.25 * (surface.roughness - surface.roughness.mean())
    return surface._replace(roughness=rough, height=surface.height * np.float32(1 - flatness))


def hard_material(rng: Rng, size: int) -> PatchSurface:
    """Draw any hard material, a metal in one of three draws."""
    kind = pick(rng, ("metal", "metal", "stone", "stone", "wood", "paint"))
    if kind == "metal":
        return bare_metal(rng, size)
    if kind == "paint":
        return paint_coat(rng, size)
    piece = procedural_piece(rng, size, STONE_FAMILIES if kind == "stone" else WOOD_FAMILIES)
    return varnish_surface(piece, between(rng, 0.12, 0.5), between(rng, 0, 0.9)) if chance(rng, 0.5) else piece
