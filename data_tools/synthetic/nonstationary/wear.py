"""Families of patches that time has changed: rust, flaking paint, puddles, stains, tracks, scratches, falling plaster.

Each function `<family>(rng, size)` draws a patch of size x size texels.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.nonstationary.materials import (
    CLOTH_FAMILIES,
    GRAY_METALS,
    GROUND_FAMILIES,
    STONE_FAMILIES,
    WARM_METALS,
    WOOD_FAMILIES,
    bare_metal,
    hard_material,
    paint_coat,
    plain_material,
    procedural_piece,
    varnish_surface,
)
from data_tools.synthetic.nonstationary.patch_surface import (
    PatchSurface,
    add_relief,
    blend_surfaces,
    blend_towards,
    blur_mirrored,
    cloud_noise,
    distance_to_zero,
    lay_surface,
    rim_coverage,
    tint_surface,
)
from data_tools.synthetic.nonstationary.shapes import (
    outline_distance,
    panel_grid,
    patch_coordinates,
    random_coordinates,
)
from data_tools.synthetic.nonstationary.weathering import (
    add_dents,
    add_dirt,
    add_random_wear,
    add_rust,
    add_scratches,
    add_smudges,
    add_stains,
    add_water,
    scale_to_unit_deviation,
)
from data_tools.synthetic.patterns.cells import isotropic_cells
from data_tools.synthetic.patterns.fields import mix, ridges, smoothstep
from data_tools.synthetic.random_values import between, chance, integer_between, log_between, pick

_EARTHS = "8a6f4d 6b4a32 4e3b2a b5a18a 94826a 5c5349"


def corroded(rng: Rng, size: int) -> PatchSurface:
    """Draw bare or painted metal that rusts, more on one side than on the other, dented and streaked."""
    bare = bare_metal(rng, size, GRAY_METALS if chance(rng, 0.6) else WARM_METALS, (0.15, 0.45))
    surface = add_relief(paint_coat(rng, size), 0.5 * bare.height) if chance(rng, 0.35) else bare
    surface = add_dents(rng, surface, integer_between(rng, 0, 6))
    place = random_coordinates(rng, size, 0.3)
    if chance(rng, 0.4):  # corrugated, or ribbed
        surface = add_relief(surface, between(rng, 1.0, 3.0) * np.sin(place.x * between(rng, 6, 25)))
    surface = add_scratches(rng, surface, integer_between(rng, 1, 20), 0.4)
    surface = add_rust(rng, surface, between(rng, -0.6, 0.5), between(rng, 0, 0.9) * place.x)
    if chance(rng, 0.4):
        surface = add_rust(rng, surface, between(rng, -1.8, -1.0))
    return add_smudges(rng, surface, between(rng, 0.05, 0.25))


def flaking(rng: Rng, size: int) -> PatchSurface:
    """Draw coats of paint that crack, curl and fall off metal, wood or plaster, one coat below the other."""
    kind = pick(rng, ("metal", "metal", "wood", "plaster"))
    if kind == "metal":
        layers = bare_metal(rng, size, GRAY_METALS, (0.2, 0.5))
        layers = add_rust(rng, layers, between(rng, -1.2, 1.0)) if chance(rng, 0.7) else layers
    else:
        layers = procedural_piece(rng, size, WOOD_FAMILIES if kind == "wood" else ("grain", "bricks"), (0.5, 0.9))
    frequency = log_between(rng, 1.0, 2.5)
    bareness = (
        cloud_noise(rng, size, frequency, between(rng, 1.5, 2.3))
        + between(rng, 0, 0.6) * random_coordinates(rng, size).x
    )
    bend = tuple(0.12 * cloud_noise(rng, size, 6, 2.2) for _ in range(2))
    cells = isotropic_cells(rng, size, log_between(rng, 3, 8), 0.9, (bend[0], bend[1]))
    level = between(rng, -0.7, 0.7)
    for coat in range(integer_between(rng, 1, 2)):
        # Flakes break along the cracks: what falls is a cell rather than a blotch.
        edge = (
            bareness + between(rng, 0.1, 0.9) * (ridges(cells.edge, 0.08) - 0.4) + 0.2 * cloud_noise(rng, size, 7, 1.6)
        )
        inside = -distance_to_zero(blur_mirrored(edge - level + 0.45 * coat, 0.6))
        skin = paint_coat(rng, size, roughness=(0.12, 0.55))
        skin = add_relief(skin, between(rng, 0.2, 0.9) * blur_mirrored(layers.height, 1.5))
        edge_nearness = smoothstep(bareness, level - 1.8, level)
        crack = smoothstep(cells.edge, between(rng, 0.02, 0.07), 0.0) * edge_nearness
        curl = between(rng, 0, 1.6) * np.exp(-np.clip(inside, 0, 30) / between(rng, 1.5, 4)) * edge_nearness
        skin = tint_surface(add_relief(skin, curl - 0.8 * crack), 1 - 0.6 * crack)
        layers = lay_surface(layers, skin, inside, between(rng, 0.5, 1.6), between(rng, 0.6, 1.5))
    return add_random_wear(rng, layers) if chance(rng, 0.6) else add_dirt(rng, layers, between(rng, 0, 0.5))


def puddles(rng: Rng, size: int) -> PatchSurface:
    """Draw uneven ground after rain: water in the low parts, wet rims, dry rises."""
    ground = procedural_piece(rng, size, GROUND_FAMILIES)
    swell = cloud_noise(rng, size, log_between(rng, 1.0, 2.5), between(rng, 2.4, 3.4))
    ground = ground._replace(height=np.clip(ground.height, -2.5, 2.5) * between(rng, 0.4, 1.0))
    ground = add_relief(ground, between(rng, 1.5, 5) * swell + 0.1 * cloud_noise(rng, size, 15, 1.0))
    if chance(rng, 0.4):
        earth = plain_material(rng, size, _EARTHS, (0.8, 0.95), 0.4)
        silt = smoothstep(-scale_to_unit_deviation(blur_mirrored(ground.height, 2)), between(rng, 0.0, 0.8), 1.5)
        ground = blend_surfaces(
            ground, earth._replace(height=blur_mirrored(ground.height, 2) + 0.2 * earth.height), silt
        )
    if chance(rng, 0.3):
        place = random_coordinates(rng, size, 0.4)
        ground = add_relief(ground, -between(rng, 1.5, 4) * np.exp(-((place.x / between(rng, 0.15, 0.4)) ** 2)))
    return add_water(rng, ground, between(rng, 0.2, 0.6))


def stains(rng: Rng, size: int) -> PatchSurface:
    """Draw cloth, wood, stone, paper or lacquer that much was spilled on."""
    kind = pick(rng, ("cloth", "wood", "stone", "paper", "paint", "metal"))
    if kind == "paper":
        surface = plain_material(rng, size, "e8e0cc d9c9a8 c9b58a f2ede0", (0.7, 0.9), 0.15)
        for _ in range(integer_between(rng, 0, 3)):  # folds
            crease = np.abs(random_coordinates(rng, size, 0.8).x)
            surface = add_relief(surface, between(rng, -6, 6) * crease)
    elif kind == "metal":
        surface = bare_metal(rng, size)
    elif kind == "paint":
        surface = paint_coat(rng, size)
    else:
        surface = procedural_piece(
            rng, size, {"cloth": CLOTH_FAMILIES, "wood": WOOD_FAMILIES, "stone": STONE_FAMILIES}[kind]
        )
    surface = add_stains(rng, surface, integer_between(rng, 2, 5))
    if chance(rng, 0.4):  # drips of paint, wax, or tar
        blot = cloud_noise(rng, size, log_between(rng, 2, 5), between(rng, 2.2, 3.0)) - between(rng, 0.7, 1.4)
        inside = distance_to_zero(blot)
        drop = add_relief(paint_coat(rng, size, roughness=(0.1, 0.3)), 0.5 * blur_mirrored(surface.height, 2))
        surface = lay_surface(surface, drop, inside, between(rng, 0.8, 3.0), log_between(rng, 2, 8))
    return add_smudges(rng, surface, between(rng, 0.1, 0.5))


def tracks(rng: Rng, size: int) -> PatchSurface:
    """Draw bands across the patch: paths worn into floors, tyres over earth or asphalt, skid marks."""
    place = random_coordinates(rng, size, 0.6)
    across = place.x + between(rng, 0, 0.3) * np.sin(place.y * between(rng, 0.8, 2.5) + between(rng, 0, 6))
    half_width = between(rng, 0.2, 0.45)
    inside = (half_width - np.abs(across) + 0.04 * cloud_noise(rng, size, 5, 2.2)) * place.unit
    if chance(rng, 0.45):  # a tyre's profile, pressed in
        ground = plain_material(rng, size, _EARTHS + " d8dde0 e8ecee", (0.75, 0.95), between(rng, 0.3, 0.8))
        ground = blend_surfaces(
            ground, procedural_piece(rng, size, ("gravel", "cracks", "grain")), 0.5 * chance(rng, 0.5)
        )
        lugs = panel_grid(
            place._replace(x=across, y=place.y + between(rng, -0.8, 0.8) * np.abs(across)),
            half_width / 2,
            between(rng, 0.12, 0.3),
        )
        pressed = (
            -between(rng, 1.5, 4.5)
            * smoothstep(inside, -1, 3)
            * (0.3 + 0.7 * smoothstep(lugs.inside * place.unit, 0, 2.5))
        )
        rim = between(rng, 0.3, 1.5) * np.exp(-((inside / 4) ** 2))
        surface = tint_surface(
            add_relief(ground, pressed + rim), 1 - between(rng, 0.15, 0.6) * smoothstep(-pressed, 0.3, 2.0)
        )
        packed = smoothstep(-pressed, 0.5, 2.5) * between(rng, 0.15, 0.5)
        surface = surface._replace(roughness=surface.roughness - packed)
        return add_water(rng, surface, between(rng, 0.1, 0.3)) if chance(rng, 0.5) else surface
    ground = (
        hard_material(rng, size) if chance(rng, 0.6) else procedural_piece(rng, size, GROUND_FAMILIES + CLOTH_FAMILIES)
    )
    share = smoothstep(inside + 4 * cloud_noise(rng, size, 5, 2.4), -4, between(rng, 4, 14)) * between(rng, 0.6, 1.0)
    polish = pick(rng, (-1, -1, 1)) * between(rng, 0.15, 0.5)
    worn = tint_surface(ground, pick(rng, (between(rng, 0.4, 0.75), between(rng, 1.15, 1.6))))._replace(
        roughness=ground.roughness + polish
    )
    if chance(rng, 0.3):
        worn = add_scratches(rng, worn, integer_between(rng, 20, 60), 0.4)
    trough = smoothstep(half_width - np.abs(across), -0.15, 0.2)
    flat = mix(worn.height, 0.35 * blur_mirrored(worn.height, 1.0) - between(rng, 0.3, 2.0), trough)
    surface = blend_surfaces(ground, worn, share)._replace(height=flat)
    if chance(rng, 0.3):  # rubber of tyres
        skid = rim_coverage(outline_distance(across, half_width * 0.6) * place.unit) * smoothstep(
            cloud_noise(rng, size, 8, 0.9), -1.5, 0.8
        )
        surface = tint_surface(surface, 1 - 0.8 * skid)
        surface = surface._replace(roughness=blend_towards(surface.roughness, 0.5, skid))
    return add_random_wear(rng, surface)


def scratches(rng: Rng, size: int) -> PatchSurface:
    """Draw polished metal, lacquer, plastic or stone in use: scratches, dents, fingerprints, smears."""
    kind = pick(rng, ("metal", "metal", "paint", "stone", "wood"))
    if kind == "metal":
        surface = bare_metal(rng, size, roughness=(0.1, 0.3))
    elif kind == "paint":
        surface = paint_coat(rng, size, roughness=(0.1, 0.25))
    else:
        surface = varnish_surface(
            procedural_piece(rng, size, STONE_FAMILIES if kind == "stone" else WOOD_FAMILIES),
            between(rng, 0.1, 0.2),
            0.9,
        )
    surface = add_dents(rng, surface, integer_between(rng, 0, 5))
    if kind == "paint" and chance(rng, 0.5):  # down to the metal
        metal = bare_metal(rng, size, GRAY_METALS, (0.2, 0.4))
        gash = distance_to_zero(np.abs(cloud_noise(rng, size, 2, 2.6)) - between(rng, 0.04, 0.12))
        gash = np.where(cloud_noise(rng, size, 2, 2.0) > 0.2, -gash, -9)
        surface = lay_surface(surface, metal, gash, -between(rng, 0.4, 1.2))
    surface = add_smudges(rng, surface, between(rng, 0.15, 0.5))
    for _ in range(integer_between(rng, 0, 4)):
        place = random_coordinates(rng, size, 0.9, 0, between(rng, 0.15, 0.3))
        whorl = np.hypot(place.x * 1.5, place.y) + 0.2 * place.x + 0.04 * cloud_noise(rng, size, 5, 2.5)
        line = (0.5 + 0.5 * np.sin(whorl * between(rng, 18, 30))) * smoothstep(whorl, 1.0, 0.8)
        surface = surface._replace(roughness=surface.roughness + np.float32(between(rng, 0.1, 0.35)) * line)
    for _ in range(integer_between(rng, 1, 2)):
        surface = add_scratches(rng, surface, integer_between(rng, 15, 90), between(rng, 0.2, 0.6))
    return surface


def overgrown(rng: Rng, size: int) -> PatchSurface:
    """Draw one material over another: plaster off bricks, or moss, sand, snow or any other material on stone."""
    kind = pick(rng, ("plaster", "plaster", "moss", "sand", "snow", "any"))
    lower = procedural_piece(
        rng, size, {"plaster": ("bricks",), "any": GROUND_FAMILIES + STONE_FAMILIES}.get(kind, GROUND_FAMILIES)
    )
    growth = (
        cloud_noise(rng, size, log_between(rng, 1.2, 3), between(rng, 1.2, 2.2))
        + between(rng, 0, 0.8) * random_coordinates(rng, size).x
    )
    if kind in ("moss", "sand", "snow"):  # they settle in joints first
        cavity = -scale_to_unit_deviation(lower.height - blur_mirrored(lower.height, 6))
        growth = growth + between(rng, 0.5, 1.4) * cavity
    inside = distance_to_zero(blur_mirrored(growth + between(rng, -0.5, 0.6), 0.8))
    bed = blur_mirrored(lower.height, 3)
    if kind == "plaster":
        upper = plain_material(rng, size, "e8dcc8 d9c7a8 c98f6b b7c3c9 9c8f80", (0.7, 0.95), 0.2)
        upper = paint_coat(rng, size, roughness=(0.15, 0.5)) if chance(rng, 0.4) else upper
        surface = lay_surface(lower, add_relief(upper, 0.3 * bed), inside, between(rng, 1.5, 4), between(rng, 1.0, 3))
    elif kind == "any":
        upper = hard_material(rng, size) if chance(rng, 0.5) else procedural_piece(rng, size, GROUND_FAMILIES)
        surface = lay_surface(lower, add_relief(upper, bed), inside, between(rng, -3, 3), between(rng, 1.5, 8))
    else:
        upper = procedural_piece(rng, size, ("foliage",), (0.7, 1.0)) if kind == "moss" else plain_material(
            rng, size, "eef2f5 e3e9ee" if kind == "snow" else "c9a878 b08d5c d9c49a", (0.6, 0.95), 0.3
        )  # fmt: skip
        dunes = between(rng, 0, 1.2) * cloud_noise(rng, size, between(rng, 3, 8), 2.0)
        surface = lay_surface(
            lower, add_relief(upper, bed + dunes), inside, between(rng, 0.8, 2.5), between(rng, 3, 10)
        )
    return add_water(rng, surface, between(rng, 0.1, 0.35)) if chance(rng, 0.35) else add_random_wear(rng, surface)


def crumpled(rng: Rng, size: int) -> PatchSurface:
    """Draw foil, paper or film that was crumpled and laid flat again: facets between sharp creases."""
    kind = pick(rng, ("foil", "foil", "paper", "film"))
    patch, relief = patch_coordinates(size), np.zeros((size, size), np.float32)
    bend = [between(rng, 0.01, 0.05) * cloud_noise(rng, size, 2, 3.0) for _ in range(2)]
    patch = patch._replace(x=patch.x + bend[0], y=patch.y + bend[1])
    folds, longest = integer_between(rng, 12, 50), between(rng, 0.3, 1.2)
    for _ in range(folds):  # a fold has two slopes and no step; where they cross there are facets
        fold = patch.moved(between(rng, -1, 1), between(rng, -1, 1), between(rng, 0, math.tau))
        half_length = between(rng, 0.2, longest)
        steep = between(rng, -1, 1) * smoothstep(np.abs(fold.y), half_length + 0.3, half_length)
        relief += np.abs(fold.x) * steep * fold.unit
    relief = blur_mirrored(relief, 0.5) * np.float32(log_between(rng, 0.15, 0.8) / math.sqrt(folds))
    if kind == "foil":
        surface = bare_metal(rng, size, ("aluminium", "gold", "copper", "silver"), (0.12, 0.35))
    elif kind == "film":
        surface = paint_coat(rng, size, roughness=(0.1, 0.25))
    else:
        surface = plain_material(rng, size, "e8e0cc c9b58a f2ede0 b08d5c", (0.6, 0.9), 0.1)
        surface = tint_surface(
            surface, 1 - 0.25 * smoothstep(-scale_to_unit_deviation(relief - blur_mirrored(relief, 2)), 0.5, 2.5)
        )
    surface = add_relief(surface._replace(height=0.4 * surface.height), relief)
    surface = add_smudges(rng, surface, between(rng, 0.15, 0.5))
    return add_stains(rng, surface, 1) if chance(rng, 0.4) else surface
