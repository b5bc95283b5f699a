"""Families of patches that are put together of pieces: inlays, tiles, plates, mosaics, planks, circuits, covers.

Each function `<family>(rng, size)` draws a patch of size x size texels.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.nonstationary.materials import (
    GRAY_METALS,
    STONE_FAMILIES,
    WARM_METALS,
    WOOD_FAMILIES,
    bare_metal,
    hard_material,
    paint_coat,
    plain_material,
    procedural_piece,
    shuffle_cells,
    varnish_surface,
)
from data_tools.synthetic.nonstationary.patch_surface import (
    PatchSurface,
    add_relief,
    blend_surfaces,
    cloud_noise,
    lay_surface,
    tint_surface,
)
from data_tools.synthetic.nonstationary.shapes import (
    PanelGrid,
    PatchCoordinates,
    box_distance,
    disc_distance,
    motif_distance,
    outline_distance,
    panel_grid,
    random_coordinates,
    random_panel_grid,
    star_distance,
)
from data_tools.synthetic.nonstationary.weathering import (
    add_dirt,
    add_random_wear,
    add_rust,
    add_scratches,
    add_smudges,
    add_stains,
    wear_edges,
)
from data_tools.synthetic.patterns.cells import isotropic_cells
from data_tools.synthetic.patterns.fields import mix, smoothstep
from data_tools.synthetic.random_values import Field, between, chance, integer_between, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import draw_dye_colours, draw_palette, uniform_colour

_GROUTS = "d8d4cc 8d8880 3c3a38 b8a98f 5a534c"  # sRGB


def inlay(rng: Rng, size: int) -> PatchSurface:
    """Draw marquetry, stone in stone or brass in wood: flush pieces with the finest of joints, polished over."""
    names = WOOD_FAMILIES if chance(rng, 0.55) else STONE_FAMILIES
    surface = procedural_piece(rng, size, names)
    place = random_coordinates(rng, size, 0.5)
    joint = between(rng, -0.8, -0.1)
    figures: list[Field] = []
    if chance(rng, 0.5):  # a frame of one or two strings
        frame = box_distance(place, between(rng, 0.6, 1.1), between(rng, 0.5, 1.1), pick(rng, (0.0, 0.2)))
        figures += [outline_distance(frame, between(rng, 0.02, 0.08)) * place.unit]
        if chance(rng, 0.6):
            figures += [outline_distance(frame - between(rng, 0.15, 0.25), 0.02) * place.unit]
    if chance(rng, 0.35):  # a field of lozenges or squares
        cells = panel_grid(place.moved(0, 0, pick(rng, (0.0, math.pi / 4))), *[log_between(rng, 0.2, 0.6)] * 2)
        figures += [np.where((cells.column + cells.row) % 2 == 0, cells.inside, -cells.inside) * place.unit]
    for _ in range(integer_between(rng, 1, 3)):
        motif_place = place.moved(
            between(rng, -0.5, 0.5), between(rng, -0.5, 0.5), between(rng, 0, 6), between(rng, 0.3, 0.9)
        )
        figures += [motif_distance(rng, motif_place) * motif_place.unit]
    piece_materials = [
        procedural_piece(rng, size, names),
        bare_metal(rng, size, WARM_METALS if chance(rng, 0.7) else GRAY_METALS, (0.12, 0.4)),
    ]
    if chance(rng, 0.3):
        piece_materials[0] = paint_coat(rng, size)
    for index, inside in enumerate(figures):
        piece = piece_materials[int(chance(rng, 0.5))] if index else piece_materials[1]
        ring = np.exp(-((inside / 0.7) ** 2))
        surface = lay_surface(surface, piece, inside)
        surface = tint_surface(add_relief(surface, joint * ring), 1 - 0.6 * ring)
    if chance(rng, 0.6):
        surface = varnish_surface(surface, between(rng, 0.12, 0.35), between(rng, 0.3, 0.9))
    return add_random_wear(rng, surface)


def tiles(rng: Rng, size: int) -> PatchSurface:
    """Draw tiles of two or three materials between joints: glazed, of stone, metal or wood, some chipped or missing."""
    cells = random_panel_grid(rng, random_coordinates(rng, size, 1.0, 0.5), (0.35, 1.2), (0.8, 3.0))
    kinds = [hard_material(rng, size) for _ in range(2)] + [paint_coat(rng, size, roughness=(0.1, 0.3))]
    draws = uniforms(rng, 3, cells.total)[:, cells.cell]
    order = pick(rng, ("random", "board", "rows", "rare"))
    kind_number = {
        "random": (draws[0] * 3).astype(np.int64),
        "board": (cells.column + cells.row) % 2 + (draws[0] > 0.93),
        "rows": cells.row % integer_between(rng, 2, 3),
        "rare": (draws[0] > 0.75) + (draws[0] > 0.93).astype(np.int64),
    }[order]
    surface = kinds[0]
    for number in (1, 2):
        surface = blend_surfaces(surface, kinds[number], (kind_number == number).astype(np.float32))
    surface = (
        shuffle_cells(rng, surface, cells.cell, cells.total) if order == "random" and chance(rng, 0.5) else surface
    )
    surface = tint_surface(surface, 1 + between(rng, 0.0, 0.3) * (draws[1] - 0.5))
    # The rim moves inwards where chips are broken off.
    rim = cells.inside * (size / 2) - between(rng, 0.5, 2.0)
    rim = rim - smoothstep(cloud_noise(rng, size, 9, 1.5), 1.2, 3.0) * between(rng, 0, 5)
    is_missing = draws[1] < pick(rng, (0.0, 0.0, 0.06))
    rim = np.where(is_missing, -9, rim)
    tilt = (draws[1] - 0.5) * cells.u + (draws[2] - 0.5) * cells.v
    surface = add_relief(surface, between(rng, 0, 6) * tilt + between(rng, 0, 0.5) * draws[2])
    grout = plain_material(rng, size, _GROUTS, (0.75, 0.95), 0.25)
    bevel = log_between(rng, 1.5, 6)
    return add_random_wear(rng, lay_surface(grout, surface, rim, between(rng, 0.8, 3.0), bevel))


def mosaic(rng: Rng, size: int) -> PatchSurface:
    """Draw tesserae of stone, glass and gold, each a little tilted, that show a figure, bands or a ground."""
    bend = [cloud_noise(rng, size, 3, 2.5) * between(rng, 0.03, 0.15) for _ in range(2)]
    if chance(rng, 0.5):
        cells = random_panel_grid(rng, random_coordinates(rng, size, 1, 0.3), (0.12, 0.24), (0.8, 1.4))
        cell, total, rim = cells.cell, cells.total, cells.inside * (size / 2)
        tile_offset = cells.u, cells.v
    else:
        worley = isotropic_cells(rng, size, between(rng, 7, 14), between(rng, 0.3, 0.8), (bend[0], bend[1]))
        cell, total, rim = worley.cell, worley.total, worley.edge * np.float32(size / 11)
        tile_offset = worley.across_x * 0.15, worley.across_y * 0.15
    place = random_coordinates(rng, size, 0.5, 0.5, between(rng, 0.6, 1.2))
    figure = motif_distance(rng, place) if chance(rng, 0.7) else 0.5 - np.abs(place.y) + 0.2 * np.sin(place.x * 4)
    masks = np.stack([smoothstep(figure, -0.02, 0.02), smoothstep(outline_distance(figure, 0.12), -0.02, 0.02)])
    weight = np.maximum(np.bincount(cell.ravel(), minlength=total), 1)
    shares = [(np.bincount(cell.ravel(), mask.ravel(), minlength=total) / weight > 0.5) for mask in masks]
    zone_number = np.where(shares[1], 2, np.where(shares[0], 1, 0))
    tones = (
        draw_dye_colours(rng, 3)
        if chance(rng, 0.5)
        else draw_palette(rng, "e8e0d0 2f4f6f 7a2f2a 35605a c9a24a 1f1f22", 3)
    )
    draws = uniforms(rng, 4, total).astype(np.float32)
    albedo = tones[zone_number] * (0.6 + 0.7 * draws[0])[:, None]
    gold = (draws[1] < 0.9) & (zone_number == integer_between(rng, 0, 2)) if chance(rng, 0.5) else draws[1] < 0.06
    foil = np.array([1.0, 0.77, 0.34] if chance(rng, 0.7) else [0.95, 0.93, 0.88], np.float32)
    specular = np.where(gold[:, None], foil * (0.7 + 0.3 * draws[2])[:, None], 0.05).astype(np.float32)
    albedo = np.where(gold[:, None], 0.02, albedo)
    roughness = between(rng, 0.1, 0.25) + between(rng, 0.05, 0.5) * draws[2]
    tilt = (draws[3][cell] - 0.5) * tile_offset[0] + (draws[2][cell] - 0.5) * tile_offset[1]
    relief = between(rng, 2, 14) * tilt + 0.06 * cloud_noise(rng, size, 14, 1.2)
    tesserae = PatchSurface(
        np.moveaxis(albedo[cell], -1, 0), np.moveaxis(specular[cell], -1, 0), roughness[cell], relief
    )
    bed = plain_material(rng, size, _GROUTS, (0.8, 0.95), 0.25)
    surface = lay_surface(bed, tesserae, rim - between(rng, 0.5, 1.1), between(rng, 0.6, 1.8), between(rng, 1.2, 3))
    return add_dirt(rng, surface, between(rng, 0, 0.4)) if chance(rng, 0.4) else surface


def plates(rng: Rng, size: int) -> PatchSurface:
    """Draw metal plates, some painted, between grooves or overlapping, with rivets or screws along their rims."""
    place = random_coordinates(rng, size, 1.0, 0.6)
    cells = random_panel_grid(rng, place, (0.6, 1.6), (0.6, 2.2))
    names = GRAY_METALS if chance(rng, 0.65) else tuple(WARM_METALS)
    bare_plates = shuffle_cells(rng, bare_metal(rng, size, names), cells.cell, cells.total)
    draws = uniforms(rng, 3, cells.total)[:, cells.cell]
    bare_plates = bare_plates._replace(roughness=bare_plates.roughness + between(rng, 0.05, 0.3) * (draws[0] - 0.4))
    surface = tint_surface(bare_plates, 1, np.minimum(1 - 0.3 * draws[1], 1))
    if chance(rng, 0.5):
        coat = add_relief(paint_coat(rng, size), 0.1 + 0.3 * surface.height)
        coated = wear_edges(
            rng, add_relief(coat, smoothstep(cells.inside * (size / 2), 0, 3)), bare_plates, between(rng, 0.1, 0.7)
        )
        surface = blend_surfaces(surface, coated, (draws[2] < between(rng, 0.3, 1.0)).astype(np.float32))
    rim = cells.inside * (size / 2)
    gap = PatchSurface(
        uniform_colour(np.full(3, 0.03, np.float32), size),
        uniform_colour(np.full(3, 0.04, np.float32), size),
        np.full((size, size), 0.9, np.float32),
        np.zeros((size, size), np.float32),
    )
    step_height = between(rng, -1.5, 1.5) * (draws[1] - 0.5) if chance(rng, 0.5) else 0.0
    surface = add_relief(
        lay_surface(gap, surface, rim - between(rng, 0.5, 1.2), between(rng, 0.6, 2.5), between(rng, 1, 3)), step_height
    )
    surface = _add_rivets(rng, surface, cells, place, names)
    if chance(rng, 0.35):
        surface = add_rust(rng, surface, between(rng, -1.6, -0.4), np.exp(-rim / 8))
    surface = add_dirt(rng, surface, between(rng, 0.1, 0.6)) if chance(rng, 0.6) else surface
    return (
        add_scratches(rng, surface, integer_between(rng, 3, 25), 0.3)
        if chance(rng, 0.6)
        else add_smudges(rng, surface, 0.3)
    )


def _add_rivets(
    rng: Rng, surface: PatchSurface, cells: PanelGrid, place: PatchCoordinates, names: tuple[str, ...]
) -> PatchSurface:
    """Add rivet or screw heads to a surface: in a row within every rim, or at the corners alone."""
    radius, spacing, margin = between(rng, 0.035, 0.08), between(rng, 0.16, 0.35), between(rng, 0.1, 0.16)
    width, height = 2 * float(cells.u.max()), 2 * float(cells.v.max())
    nearest = np.full(cells.u.shape, 9, np.float32)
    for along, across, length, breadth in ((cells.u, cells.v, width, height), (cells.v, cells.u, height, width)):
        reach = max(length / 2 - margin, 0.01)
        gaps = max(1, round(2 * reach / spacing)) if chance(rng, 0.7) else 1
        pitch = 2 * reach / gaps
        offset = np.clip(np.round((along + reach) / pitch), 0, gaps) * pitch - reach
        nearest = np.minimum(nearest, np.hypot(along - offset, np.abs(across) - max(breadth / 2 - margin, 0)))
    inside = (radius - nearest) * place.unit
    head = bare_metal(rng, surface.height.shape[-1], names, (0.2, 0.45))
    kind = pick(rng, ("dome", "dome", "flat", "socket"))
    round_top = np.sqrt(np.clip(1 - (nearest / np.float32(radius)) ** 2, 0, 1)) * radius * place.unit
    relief = 0.8 * round_top if kind == "dome" else 0.8 * smoothstep(inside, -0.5, 1.2)
    if kind == "socket":
        relief = relief - 1.2 * smoothstep((0.5 * radius - nearest) * place.unit, -0.6, 0.6)
    shade = 1 - 0.5 * np.exp(-((inside / 1.2) ** 2))
    shaded_surface = tint_surface(surface, shade, shade)
    return add_relief(lay_surface(shaded_surface, head._replace(height=0.3 * surface.height), inside), relief)


def planks(rng: Rng, size: int) -> PatchSurface:
    """Draw boards with nails, each of its own log, bare, painted or tarred, worn along the edges."""
    width = between(rng, 0.25, 0.7)
    place = random_coordinates(rng, size, 1.0, 0.5)
    cells = panel_grid(place, width * between(rng, 3, 7), width, between(rng, 0.2, 0.5))
    logs = procedural_piece(rng, size, WOOD_FAMILIES, (0.4, 0.7))
    logs = shuffle_cells(rng, logs._replace(height=np.clip(logs.height, -2, 2) * 0.7), cells.cell, cells.total)
    draws = uniforms(rng, 3, cells.total)[:, cells.cell]
    surface = tint_surface(logs, 1 + between(rng, 0.1, 0.7) * (draws[0] - 0.5))
    if chance(rng, 0.5):
        surface = surface._replace(roughness=between(rng, 0.15, 0.5) + 0.4 * (surface.roughness - 0.5))
    rim = cells.inside * (size / 2)
    if chance(rng, 0.65):
        coat = add_relief(
            paint_coat(rng, size, roughness=(0.2, 0.6)), 0.2 + 0.6 * surface.height + smoothstep(rim, -1, 3)
        )
        worn = wear_edges(rng, coat, surface, between(rng, 0.2, 0.9))
        share = (draws[1] < pick(rng, (0.3, 0.6, 1.1))).astype(np.float32)
        surface = blend_surfaces(surface, worn, share)
    gap_material = plain_material(rng, size, "1a1512 2a211a 3a3026", (0.8, 0.95))
    curvature = between(rng, -6, 6) * cells.v**2 + between(rng, 0, 1.5) * draws[2]
    surface = lay_surface(
        gap_material,
        add_relief(surface, curvature),
        rim - between(rng, 0.3, 1.3),
        between(rng, 0.8, 3.0),
        between(rng, 1.2, 4),
    )
    if chance(rng, 0.65):
        pitch = between(rng, 0.5, 1.1)
        along = (place.x / pitch) % 1 - 0.5
        radius = between(rng, 0.03, 0.06)
        nail_distance = np.hypot(along * pitch, np.abs(cells.v) - width * between(rng, 0.2, 0.35))
        inside = (radius - nail_distance) * place.unit
        nail = bare_metal(rng, size, ("steel", "titanium", "brass"), (0.25, 0.55))
        nail = add_rust(rng, nail, between(rng, -1.5, 1.0)) if chance(rng, 0.5) else nail
        streak = np.exp(-np.clip(-inside, 0, 30) / 3) * between(rng, 0, 0.6)
        surface = lay_surface(tint_surface(surface, 1 - streak), nail, inside, between(rng, -0.8, 1.0))
    surface = add_stains(rng, surface, integer_between(rng, 1, 2)) if chance(rng, 0.3) else surface
    return add_dirt(rng, surface, between(rng, 0.0, 0.5)) if chance(rng, 0.5) else surface


def circuit(rng: Rng, size: int) -> PatchSurface:
    """Draw a circuit board: traces under lacquer, pads of tin or gold, holes, chips with legs."""
    place = random_coordinates(rng, size, 1.0, 0.5)
    lacquer = draw_palette(rng, "1f5a35 1b3f7a 7a1f22 1a1c20 e0e0da 3a1f5a", 1, 0.05)[0]
    board = paint_coat(rng, size, lacquer, (0.2, 0.45))
    pitch = between(rng, 0.12, 0.2)
    cells = panel_grid(place, pitch, pitch)
    rows = (uniforms(rng, 64) < between(rng, 0.3, 0.6))[cells.row % 64]
    direction_field = place.x * between(rng, 0.3, 0.8) + cloud_noise(rng, size, 1.5, 3) * 0.1
    lane = np.where(direction_field > 0, cells.u, cells.v)
    trace = (np.where(rows, 0.2 * pitch, -1) - np.abs(lane)) * place.unit
    surface = lay_surface(board, tint_surface(board, 1.6), trace, between(rng, 0.3, 0.8))
    tin = bare_metal(rng, size, ("gold", "silver", "aluminium", "copper"), (0.15, 0.4))
    pads = uniforms(rng, cells.total)[cells.cell] < between(rng, 0.15, 0.4)
    middle_distance = np.hypot(cells.u, cells.v)
    pad = (np.where(pads, 0.42 * pitch, -1) - middle_distance) * place.unit
    hole = (np.where(pads, 0.18 * pitch, -1) - middle_distance) * place.unit
    surface = lay_surface(surface, tin, pad, 0.4)
    surface = lay_surface(surface, tint_surface(board, 0.1), hole, -2.0)
    for _ in range(integer_between(rng, 1, 3)):
        chip_place = place.moved(between(rng, -1, 1), between(rng, -1, 1), pick(rng, (0.0, math.pi / 2)))
        half_width, half_height = between(rng, 0.2, 0.45), between(rng, 0.15, 0.4)
        legs = (
            np.where(
                (chip_place.x / pitch * 1.5) % 1 < 0.5,
                box_distance(chip_place, half_width - 0.03, half_height + 0.1),
                -1,
            )
            * chip_place.unit
        )
        surface = lay_surface(surface, tin, legs, 0.8)
        body = plain_material(rng, size, "1c1c1e 26262a 2e2a28", (0.4, 0.7), 0.06)
        inside = box_distance(chip_place, half_width, half_height) * chip_place.unit
        surface = lay_surface(surface, body, inside, between(rng, 2, 3.5), 2.5)
        dot = disc_distance(chip_place.moved(0.7 * half_width, 0.6 * half_height), 0.05) * chip_place.unit
        surface = lay_surface(surface, tint_surface(body, 0.7), dot, -0.6)
    return add_smudges(rng, surface, 0.2) if chance(rng, 0.5) else add_dirt(rng, surface, between(rng, 0, 0.5))


def cover(rng: Rng, size: int) -> PatchSurface:
    """Draw a cast cover or grate in stone or asphalt: rings of knobs, bars and ornaments of iron or bronze."""
    place = random_coordinates(rng, size, 0.7, 0.3, between(rng, 0.9, 1.5))
    lid = bare_metal(rng, size, ("steel", "bronze", "titanium", "brass"), (0.3, 0.55))
    reach, angle = np.hypot(place.x, place.y), np.arctan2(place.y, place.x)
    relief = np.zeros_like(lid.height)
    inner = between(rng, 0.2, 0.4)
    pitch = between(rng, 0.1, 0.2)
    ring = np.floor((reach - inner) / pitch)
    count = np.maximum(np.round(math.tau * (ring + 0.5 + inner / pitch)), 1)
    u, v = (angle / math.tau * count) % 1 - 0.5, ((reach - inner) / pitch) % 1 - 0.5
    knobs = (
        box_distance(PatchCoordinates(u, v, 1), between(rng, 0.2, 0.4), between(rng, 0.2, 0.4), between(rng, 0.0, 0.2))
        * pitch
    )
    relief = mix(
        relief, 2.0 * smoothstep(knobs * place.unit, -1, 1.5), ((reach > inner) & (reach < 0.85)).astype(np.float32)
    )
    relief = relief + 2.0 * smoothstep(outline_distance(reach - 0.93, 0.04) * place.unit, -1, 1)
    relief = relief + 2.0 * smoothstep(motif_distance(rng, place.moved(0, 0, 0, inner)) * place.unit * inner, -1, 1) * (
        reach < inner
    )
    if chance(rng, 0.4):  # bars with slots through
        bars = np.abs((place.y * between(rng, 3, 6)) % 1 - 0.5) - 0.22
        slots = np.minimum(bars / 4, 0.8 - reach) * place.unit
        relief = -4.0 * smoothstep(slots, -1, 1)
    lid = add_dirt(rng, add_relief(lid, between(rng, 0.5, 1.2) * relief), between(rng, 0.3, 0.9))
    lid = add_rust(rng, lid, between(rng, -1.8, 0.0), -0.4 * relief) if chance(rng, 0.6) else lid
    lid = wear_edges(rng, lid, bare_metal(rng, size, ("steel", "bronze", "brass"), (0.15, 0.3)), between(rng, 0.3, 0.9))
    ground = procedural_piece(rng, size, ("granite", "grain", "bricks", "gravel"))
    shape = disc_distance(place, 1.0) if chance(rng, 0.7) else star_distance(place, pick(rng, (4, 4, 8)), 1.25, 0.0)
    return lay_surface(ground, lid, shape * place.unit, between(rng, -1.5, 1.5), 2)
