"""Procedural surfaces that people build: bricks, tiles, wood, shingles, metal.

Each function `<family>(rng, size)` draws periodic maps of size x size texels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.cells import CellLattice, isotropic_cells
from data_tools.synthetic.patterns.fields import band_noise, colour_ramp, fbm, mix, smooth_displacement, smoothstep
from data_tools.synthetic.patterns.strokes import scatter_strokes
from data_tools.synthetic.random_values import Field, Ids, between, chance, integer_between, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import (
    PeriodicMaps,
    assemble_maps,
    draw_dye_colours,
    draw_palette,
    uniform_colour,
    vary_albedo,
)

_ANGLES = (0.0, 0.0, math.pi / 2, math.pi / 4)  # rad, of rows in most draws


class _Blocks(NamedTuple):
    """The rectangular blocks of a wall or a floor.

    Attributes:
        block: identity [S, S] of the block, 0 .. total - 1.
        total: number of blocks.
        rim: distance [S, S] to the block's rim, in its short sides.
        along, across: position [S, S] within the block, in its short sides.
    """

    block: Ids
    total: int
    rim: Field
    along: Field
    across: Field


def _draw_blocks(rng: Rng, size: int, rows: float, warp: tuple[Field, Field] | None) -> _Blocks:
    """Draw bricks in one of the common bonds, at any angle."""
    bond = pick(rng, ("running", "running", "third", "stack", "herringbone", "basket"))
    angle = pick(rng, _ANGLES) if chance(rng, 0.6) else between(rng, 0, math.pi)
    if bond in ("herringbone", "basket"):
        lattice = CellLattice(size, rows, rows, angle, 0, 4, 4, warp)
        return _join_cells(lattice, bond == "herringbone")
    aspect = log_between(rng, 1.3, 4.0)
    shift, multiple = {"running": (0.5, 2), "third": (1 / 3, 3), "stack": (0.0, 1)}[bond]
    lattice = CellLattice(size, rows / aspect, rows, angle, shift, multiple, 1, warp)
    ratio = np.float32(lattice.width / lattice.height)
    rim = np.minimum(np.minimum(lattice.u, 1 - lattice.u) * ratio, np.minimum(lattice.v, 1 - lattice.v))
    return _Blocks(lattice.cell, lattice.count, rim, lattice.u * ratio, lattice.v)


def _join_cells(lattice: CellLattice, herringbone: bool) -> _Blocks:
    """Join cells to blocks of two, lying or standing: in a herringbone, or as a basket weave of four cells each."""
    i, j = lattice.column, lattice.row
    if herringbone:
        kind = (i - j) % 4
        lying, second = kind < 2, (kind == 1) | (kind == 2)
    else:
        lying = (i // 2 + j // 2) % 2 == 0
        second = np.where(lying, i % 2 == 1, j % 2 == 1)
    along = np.where(lying, lattice.u, lattice.v) + second
    across = np.where(lying, lattice.v, lattice.u)
    block = lattice.neighbour(np.where(lying & second, -1, 0), np.where(~lying & second, -1, 0))
    rim = np.minimum(np.minimum(along, 2 - along), np.minimum(across, 1 - across))
    return _Blocks(block, lattice.count, rim.astype(np.float32), along.astype(np.float32), across)


def _draw_edge_displacement(rng: Rng, size: int, rows: float, amount: float) -> tuple[Field, Field]:
    """Draw a displacement of columns and rows, each [S, S] in cells, that roughens the edges of bricks."""
    along, across = fbm(rng, size, rows, 2.3), fbm(rng, size, rows, 2.3)
    return along * np.float32(amount * 0.6), across * np.float32(amount)


def bricks(rng: Rng, size: int) -> PeriodicMaps:
    """Draw walls and pavings of bricks or stones, in several bonds."""
    rows = log_between(rng, 6, 20)
    warp = _draw_edge_displacement(rng, size, rows, between(rng, 0.0, 0.06))
    blocks = _draw_blocks(rng, size, rows, warp)
    joint, softness = between(rng, 0.03, 0.14), between(rng, 0.03, 0.2)
    face = smoothstep(blocks.rim, joint, joint + softness)
    draws = uniforms(rng, 3, blocks.total)
    fine, rough = fbm(rng, size, 20, 0.8), fbm(rng, size, rows, 1.3)
    colours = draw_palette(rng, "8e3b2e a65042 b5654a 6e2f2a c98a6b d9c3a5 8a8077 5d5a58 e3ddd0 99744f", 3, 0.15)
    tone = 0.5 + between(rng, 0.2, 0.9) * (draws[0][blocks.block] - 0.5) + 0.1 * rough
    stone = vary_albedo(colour_ramp(tone, colours), fine, between(rng, 0.04, 0.22))
    mortar = draw_palette(rng, "b8b2a8 8d8880 d8d4cc 55514d a89a86", 1, 0.05)[0]
    bed = vary_albedo(uniform_colour(mortar, size), fbm(rng, size, 40, 0.5), 0.12)
    chips = smoothstep(band_noise(rng, size, rows * 2.5, 0.5), 2.0, 2.6) * chance(rng, 0.5)
    height = face * (1 + between(rng, 0, 0.4) * draws[1][blocks.block]) + 0.04 * rough + 0.03 * fine - 0.4 * chips
    if chance(rng, 0.15):  # painted over
        stone = bed = vary_albedo(
            uniform_colour(draw_dye_colours(rng, 1)[0], size), 0.7 * fine + draws[0][blocks.block], 0.06
        )
    return assemble_maps(rng, mix(bed, stone, face), height, (0.15, 0.5), (0.03, 0.05), (0.6, 1))


def tiles(rng: Rng, size: int) -> PeriodicMaps:
    """Draw glazed tiles: squares, hexagons, mosaics, boards of two colours, tiles with arcs on them."""
    count = log_between(rng, 6, 22)
    kind = pick(rng, ("square", "board", "hexagon", "mosaic", "arcs", "arcs"))
    angle = pick(rng, _ANGLES) if chance(rng, 0.5) else between(rng, 0, math.pi)
    even = 2 if kind == "board" else 1
    shift = 0.5 if kind == "hexagon" else 0.0
    rows = count * 2 / math.sqrt(3) if kind == "hexagon" else count
    lattice = CellLattice(size, count, rows, angle, shift, 2 if kind == "hexagon" else even, even)
    rim = np.minimum(np.minimum(lattice.u, 1 - lattice.u), np.minimum(lattice.v, 1 - lattice.v))
    cell = lattice.cell
    if kind == "hexagon":
        rim, cell = _hexagons(lattice)
    joint = between(rng, 0.02, 0.09)
    glaze = smoothstep(rim, joint, joint + between(rng, 0.03, 0.12))
    colours = (
        draw_dye_colours(rng, 4)
        if chance(rng, 0.55)
        else draw_palette(rng, "e8e4da 2f4f6f b5542f 35605a d9b44a 1f1f1f", 4)
    )
    draws = uniforms(rng, 2, lattice.count)[:, cell]
    if kind == "board":
        face = np.moveaxis(colours[(lattice.column + lattice.row) % 2], -1, 0)
    elif kind == "mosaic":
        face = np.moveaxis(colours[(draws[0] * integer_between(rng, 2, 4)).astype(np.int64)], -1, 0)
    elif kind == "arcs":
        face = mix(
            uniform_colour(colours[0], size), uniform_colour(colours[1], size), _draw_arcs(rng, lattice, draws[0])
        )
    else:
        face = uniform_colour(colours[0], size)
    cloud = fbm(rng, size, count, 1.5)
    face = vary_albedo(face, 0.5 * cloud + 2 * draws[1] - 1, between(rng, 0.02, 0.3))
    grout = vary_albedo(
        uniform_colour(draw_palette(rng, "d8d4cc 8d8880 3c3a38 f0eee8", 1, 0.1)[0], size), fbm(rng, size, 40, 0.5), 0.1
    )
    height = glaze * (1 + 0.2 * draws[1]) + 0.02 * cloud
    shine = between(rng, 0.08, 0.5)
    return assemble_maps(
        rng, mix(grout, face, glaze), height, (0.05, 0.35), (0.04, 0.07), 0.85 + (shine - 0.85) * glaze
    )


def _hexagons(lattice: CellLattice) -> tuple[Field, Ids]:
    """Return the distance [S, S] to the rim of hexagons, in their widths, and the hexagon's identity [S, S]."""
    ratio = np.float32(lattice.height / lattice.width)
    nearest = np.full(lattice.u.shape, 9, np.float32)
    second, cell = nearest.copy(), lattice.cell.copy()
    for rows in (-1, 0, 1):
        for columns in (-1, 0, 1):
            px = np.float32(columns + 0.5 - 0.5 * rows) - lattice.u
            py = (np.float32(rows + 0.5) - lattice.v) * ratio
            distance = px * px + py * py
            cell = np.where(distance < nearest, lattice.neighbour(columns, rows), cell)
            second = np.minimum(second, np.maximum(nearest, distance))
            nearest = np.minimum(nearest, distance)
    return (second - nearest) / 2, cell  # neighbours are one width apart


def _draw_arcs(rng: Rng, lattice: CellLattice, turned: Field) -> Field:
    """Draw Truchet's tiles [S, S], 0 .. 1: arcs around two opposite corners, as bands or filled."""
    u = np.where(turned < 0.5, lattice.u, 1 - lattice.u)
    corner = np.minimum(np.hypot(u, lattice.v), np.hypot(1 - u, 1 - lattice.v))
    band = between(rng, 0.08, 0.22)
    if chance(rng, 0.3):
        return smoothstep(corner, 0.53, 0.47)
    line = smoothstep(np.abs(corner - np.float32(0.5)), band + 0.04, band - 0.02)
    return line if chance(rng, 0.6) else np.maximum(line, smoothstep(corner, 0.2, 0.14))


def wood(rng: Rng, size: int) -> PeriodicMaps:
    """Draw wood: the grain of one piece, planks or parquet."""
    colours = draw_palette(rng, "8b5a2b a9744f c49a6c deb887 5c3a21 3e2a1d e6cfa8 9c6b3f 7a4a3a 8f8478", 3, 0.12)
    whole_piece = chance(rng, 0.4)
    angle = between(rng, 0, math.pi) if whole_piece else pick(rng, _ANGLES)
    if whole_piece:
        rings = _draw_grain(rng, size, angle)
        tone, rim = rings, np.ones((size, size), np.float32)
        board = np.zeros((size, size), np.float32)
    else:
        rows = log_between(rng, 5, 14)
        blocks = _draw_blocks(rng, size, rows, None) if chance(rng, 0.35) else _draw_planks(rng, size, rows, angle)
        draws = uniforms(rng, 2, blocks.total)[:, blocks.block]
        # Each board is cut from another place of one log, so that the grain is looked up in the board's coordinates.
        log = _draw_grain(rng, size, 0.0)
        scale = size / max(rows, 1) * 0.9
        x = ((blocks.along * scale + draws[0] * size).astype(np.int64)) % size
        y = ((blocks.across * scale + draws[1] * size).astype(np.int64)) % size
        tone, board, rim = log[y, x], draws[0] - 0.5, blocks.rim
    gap = between(rng, 0.01, 0.05)
    face = smoothstep(rim, gap, gap + 0.04)
    diffuse = colour_ramp(0.5 + between(rng, 0.15, 0.45) * tone + between(rng, 0.1, 0.8) * board, colours)
    wear = fbm(rng, size, 6, 1.4)
    if chance(rng, 0.15):  # paint, worn off along the grain
        worn = smoothstep(0.7 * wear + 0.7 * tone, between(rng, 0.2, 1.5), 1.8)
        diffuse = mix(vary_albedo(uniform_colour(draw_dye_colours(rng, 1)[0], size), tone, 0.05), diffuse, worn)
    diffuse = vary_albedo(diffuse, 0.3 * wear - 3 * (1 - face), between(rng, 0.15, 0.5))
    roughness = np.clip(between(rng, 0.3, 0.8) + 0.05 * tone, 0.05, 1)
    relief = between(rng, 0.02, 0.2)
    return assemble_maps(rng, diffuse, face + relief * tone, (0.04, 0.3), (0.035, 0.055), roughness)


def _draw_grain(rng: Rng, size: int, angle_rad: float) -> Field:
    """Draw the grain [S, S] of cut wood along an angle: year rings, fibres, pores; mean about 0, variance about 1."""
    stretch = log_between(rng, 5, 14)
    shape = band_noise(rng, size, log_between(rng, 2.5, 6), 0.5, stretch, angle_rad)
    phase = shape * np.float32(between(rng, 1.0, 3.5)) + 0.12 * fbm(rng, size, 12, 2.0, stretch, angle_rad)
    ring = phase - np.floor(phase)
    year = smoothstep(ring, 0, between(rng, 0.5, 0.95)) * smoothstep(ring, 1.0, 0.95)
    fibre = band_noise(rng, size, log_between(rng, 30, 60), 0.6, stretch * 2, angle_rad)
    pores = smoothstep(band_noise(rng, size, log_between(rng, 35, 60), 0.4, stretch * 1.5, angle_rad), 1.2, 2.0)
    result: Field = (
        (2 * year - 1) * np.float32(between(rng, 0.3, 1)) + 0.4 * fibre - pores * np.float32(between(rng, 0, 1.5))
    )
    return result


def _draw_planks(rng: Rng, size: int, rows: float, angle_rad: float) -> _Blocks:
    """Draw boards whose ends lie anywhere: each row of four is shifted by its own amount."""
    rows = max(4.0, rows)
    lattice = CellLattice(size, rows / between(rng, 4, 9), rows, angle_rad, 0.25 * integer_between(rng, 1, 3), 4, 1)
    ratio = np.float32(lattice.width / lattice.height)
    rim = np.minimum(np.minimum(lattice.u, 1 - lattice.u) * ratio, np.minimum(lattice.v, 1 - lattice.v))
    return _Blocks(lattice.cell, lattice.count, rim, lattice.u * ratio, lattice.v)


def shingles(rng: Rng, size: int) -> PeriodicMaps:
    """Draw scales, slates or roof tiles: rows that overlap."""
    count = log_between(rng, 6, 22)
    angle = between(rng, 0, math.pi) if chance(rng, 0.6) else pick(rng, (0.0, math.pi / 2))
    lattice = CellLattice(size, count, count * between(rng, 0.8, 1.8), angle, 0.5, 2)
    bluntness = pick(rng, (1.0, 2.0, 2.0, 3.0, 8.0))  # 1: points, 2: circles, 8: slates
    top_position = np.full((size, size), -9, np.float32)
    cell, tip_distance = lattice.cell.copy(), top_position.copy()
    centre = top_position.copy()
    for rows in (2, 1, 0, -1):  # from below; the later ones lie above
        for columns in (-1, 0, 1):
            px = 2 * (lattice.u - np.float32(columns + 0.5 - 0.5 * rows))
            py = lattice.v - np.float32(rows)  # 0 at the root, grows towards the tip
            reach = 1.75 * (1 - np.clip(np.abs(px), 0, 1) ** np.float32(bluntness)) ** np.float32(1 / bluntness) - 0.75
            is_visible = (np.abs(px) < 1) & (py > -1) & (py < 1 + 0.6 * reach) & (reach > -0.74)
            cell = np.where(is_visible, lattice.neighbour(columns, rows), cell)
            tip_distance, centre = (
                np.where(is_visible, 1 + 0.6 * reach - py, tip_distance),
                np.where(is_visible, px, centre),
            )
            top_position = np.where(is_visible, py, top_position)
    draws = uniforms(rng, 3, lattice.count)[:, cell]
    rim = smoothstep(tip_distance, 0.0, between(rng, 0.04, 0.2))
    colours = draw_palette(rng, "6b6f75 4a4e54 8c4a35 a5623f 5b6b58 93836b 2f3b46 c9b79c 3f6f6a", 3, 0.35)
    lines = np.sin(centre * np.float32(between(rng, 0, 25))) * np.float32(between(rng, 0, 1))
    rough = fbm(rng, size, count * 1.5, 1.0)
    tone = 0.5 + between(rng, 0.1, 0.9) * (draws[0] - 0.5) + between(rng, -0.3, 0.3) * top_position
    diffuse = vary_albedo(colour_ramp(tone, colours), 0.6 * rough + 0.5 * lines + 2 * rim - 2, between(rng, 0.08, 0.3))
    bulge = between(rng, 0, 0.6) * (1 - centre**2)
    height = 0.8 * top_position + bulge + 0.25 * rim + 0.15 * draws[1] + 0.05 * lines + 0.06 * rough
    return assemble_maps(rng, diffuse, height, (0.2, 0.6), (0.03, 0.08), (0.25, 0.9))


def metal(rng: Rng, size: int) -> PeriodicMaps:
    """Draw metal: brushed, scratched, hammered, galvanised, or a tread plate."""
    tint = draw_palette(rng, "b8bcc0 c9c5bd a8a9ad d4af6a b87352 8f9499 5f6266", 1, 0.25)[0]
    kind = pick(rng, ("brushed", "brushed", "scratched", "hammered", "galvanised", "tread"))
    diffuse, dirt = uniform_colour(tint * np.float32(between(rng, 0.25, 0.6)), size), fbm(rng, size, 5, 1.4)
    roughness = np.full((size, size), between(rng, 0.2, 0.5), np.float32)
    angle, slope = between(rng, 0, math.pi), (0.02, 0.12)
    height = 0.2 * band_noise(rng, size, 70, 0.6, 3, angle)
    if kind == "brushed":
        lines = band_noise(rng, size, log_between(rng, 45, 100), 0.7, log_between(rng, 15, 80), angle)
        height, diffuse, slope = lines, vary_albedo(diffuse, lines + 0.4 * dirt, between(rng, 0.1, 0.4)), (0.05, 0.25)
    elif kind == "scratched":
        turn = math.pi if chance(rng, 0.5) else between(rng, 0.05, 0.5)
        marks = scatter_strokes(
            rng, size, integer_between(rng, 150, 500), (0.05, 0.3), (0.002, 0.006), (angle, turn), 0.4, 0
        )
        depth = marks.of_each(uniforms(rng, marks.total))
        height = -depth * (1 - marks.across**2) + 0.1 * dirt
        diffuse, roughness = vary_albedo(diffuse, 2 * depth - 0.5 + 0.4 * dirt, 0.3), roughness + 0.2 * depth
    elif kind == "hammered":
        dents = isotropic_cells(rng, size, log_between(rng, 8, 24), 0.7)
        height, slope = np.minimum(dents.nearest**2, 0.6), (0.15, 0.5)
        diffuse = vary_albedo(diffuse, dents.edge * 3 - 1 + 0.4 * dirt, between(rng, 0.05, 0.25))
    elif kind == "galvanised":
        warp = smooth_displacement(rng, size, 20, 0.12)
        crystals = isotropic_cells(rng, size, log_between(rng, 8, 26), 0.95, warp, between(rng, 1, 2))
        tone = uniforms(rng, crystals.total)[crystals.cell]
        diffuse, roughness = vary_albedo(diffuse, 3 * tone - 1.5, between(rng, 0.15, 0.4)), roughness + 0.2 * tone
    else:
        height, slope = _draw_tread(rng, size) + 0.02 * dirt, (0.12, 0.4)
        diffuse = vary_albedo(diffuse, dirt + smoothstep(height, 0, 0.4), between(rng, 0.1, 0.35))
    shine = np.float32(between(rng, 0.45, 0.85)) * np.exp(np.float32(-0.1) * np.clip(dirt, 0, 3))
    return assemble_maps(rng, diffuse, height, slope, shine, np.clip(roughness, 0.12, 1))


def _draw_tread(rng: Rng, size: int) -> Field:
    """Draw raised bars [S, S], 0 .. 1, by turns along one diagonal and along the other."""
    bars = integer_between(rng, 1, 3)
    lattice = CellLattice(size, log_between(rng, 8, 18), log_between(rng, 8, 18), between(rng, 0, math.pi), 0, 2, 2)
    turned = (lattice.column + lattice.row) % 2 == 0
    along = np.where(turned, lattice.u, lattice.v) - np.float32(0.5)
    across = np.where(turned, lattice.v, lattice.u)
    across = (across * bars - np.floor(across * bars)) - np.float32(0.5)
    shape = (along / np.float32(0.46)) ** 2 + (across / np.float32(between(rng, 0.2, 0.4))) ** 2
    return smoothstep(shape, 1.0, between(rng, 0.2, 0.7))
