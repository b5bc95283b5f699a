"""Procedural cloth and hide: weaves, knits, stripes, leather.

Each function `<family>(rng, size)` draws periodic maps of size x size texels.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.cells import CellLattice, isotropic_cells
from data_tools.synthetic.patterns.fields import (
    band_noise,
    colour_ramp,
    fbm,
    mix,
    normal_to_uniform,
    ridges,
    smooth_displacement,
    smoothstep,
)
from data_tools.synthetic.random_values import Field, Ids, between, chance, integer_between, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import (
    PeriodicMaps,
    assemble_maps,
    draw_dye_colours,
    draw_palette,
    uniform_colour,
    vary_albedo,
)

_CLOTHS = "24365c 3b5998 8c2f39 c8b89a e9e4d8 2b2b2b 5e6b4a 7b4b2a a67c52 9a9a9a d4a017 61304b 1f4e4a"

# Whether the warp lies over (1) or under (0) the weft, by column + shift * row modulo the length: plain, hopsack,
# twills, satin.
_DRAFTS: tuple[tuple[str, int], ...] = (
    ("10", 1), ("10", 1), ("110", 1), ("1100", 1), ("1110", 1), ("11100", 1), ("10000", 2), ("11011000", 3),
)  # fmt: skip


def _draw_cloth_colours(rng: Rng, count: int) -> Field:
    """Draw colours of cloths, linear RGB [count, 3]."""
    return draw_dye_colours(rng, count) if chance(rng, 0.4) else draw_palette(rng, _CLOTHS, count, 0.3)


def _draw_yarn_sequence(rng: Rng, period: int, colours: int) -> Ids:
    """Draw which of the colours each yarn of a repeat has: bands of one or more yarns."""
    places: list[int] = []
    while len(places) < period:
        places += [integer_between(rng, 0, colours - 1)] * integer_between(rng, 1, max(1, period // 2))
    return np.array(places[:period], np.int64)


def weave(rng: Rng, size: int) -> PeriodicMaps:
    """Draw a weave: plain, basket, twill, denim, satin, herringbone or checks."""
    draft, shift = pick(rng, _DRAFTS)
    yarns = log_between(rng, 12, 48)
    repeat = len(draft) * (pick(rng, (1, 1, 2, 4)) if yarns > 24 else 1)
    angle = between(rng, 0, math.pi) if repeat <= 6 else pick(rng, (0.0, math.pi / 4, math.pi / 2))
    bend = smooth_displacement(rng, size, 6, between(rng, 0.0, 0.005) * yarns)
    lattice = CellLattice(size, yarns, yarns * log_between(rng, 0.7, 1.4), angle, 0, repeat, repeat, bend)
    column, row = lattice.column, lattice.row
    if len(draft) > 2 and chance(rng, 0.3) and repeat % (2 * len(draft)) == 0:  # herringbone
        is_turned = row % (2 * len(draft)) >= len(draft)
        phase = column + shift * np.where(is_turned, -row, row)
    else:
        phase = column + shift * row
    is_warp = np.array([key == "1" for key in draft])[phase % len(draft)]
    warp_round, weft_round = 1 - (2 * lattice.u - 1) ** 2, 1 - (2 * lattice.v - 1) ** 2
    bow_warp, bow_weft = np.sin(np.pi * lattice.v), np.sin(np.pi * lattice.u)
    lift = np.float32(between(rng, 0.3, 1.0))
    height = np.where(is_warp, np.sqrt(warp_round) + lift * bow_warp, np.sqrt(weft_round) + lift * bow_weft)
    height = height + np.float32(between(rng, 0.02, 0.25)) * fbm(rng, size, yarns * 2, 0.8)
    dyes = _draw_cloth_colours(rng, 4)
    if chance(rng, 0.45):  # one colour for the warp, one for the weft, as denim
        colour = np.where(is_warp, dyes[0][:, None, None], dyes[1 if chance(rng, 0.7) else 0][:, None, None])
    else:
        warp_sequence, weft_sequence = _draw_yarn_sequence(rng, repeat, 3), _draw_yarn_sequence(rng, repeat, 3)
        index = np.where(is_warp, warp_sequence[column % repeat], weft_sequence[row % repeat])
        colour = np.moveaxis(dyes[index], -1, 0)
    uneven = np.where(is_warp, uniforms(rng, repeat)[column % repeat], uniforms(rng, repeat)[row % repeat])
    colour = vary_albedo(colour, 2 * uneven - 1 + 0.5 * fbm(rng, size, yarns, 0.8), between(rng, 0.05, 0.3))
    gaps = smoothstep(np.where(is_warp, warp_round, weft_round), 0.0, between(rng, 0.1, 0.6))
    colour = colour * (np.float32(between(rng, 0.25, 0.7)) * (1 - gaps) + gaps)
    return assemble_maps(rng, colour, height, (0.15, 0.6), (0.03, 0.06), (0.6, 1))


def knit(rng: Rng, size: int) -> PeriodicMaps:
    """Draw a knit: stockinette or ribs, with stripes or a motif in it."""
    columns = log_between(rng, 8, 24)
    motif = pick(rng, (1, 1, 2, 4, 6))
    angle = between(rng, 0, math.pi) if motif < 4 else pick(rng, (0.0, math.pi / 2, math.pi / 4))
    bend = smooth_displacement(rng, size, 8, between(rng, 0, 0.004) * columns)
    lattice = CellLattice(size, columns, columns * between(rng, 1.0, 1.5), angle, 0, motif, motif, bend)
    lean, slim = between(rng, 0.45, 0.9), between(rng, 0.22, 0.36)
    side = np.abs(2 * lattice.u - 1)  # 0 in the middle of a stitch, 1 at its border
    height, stitch = np.zeros((size, size), np.float32), np.zeros((size, size), np.int64)
    strand = np.zeros((size, size), np.float32)
    for rows in (-1, 0, 1):
        across = lattice.v - np.float32(rows) - np.float32(lean) * (side - 0.5) - 0.5
        profile = 1 - (across / np.float32(slim * 1.7)) ** 2 - ((side - 0.5) / 0.62) ** 2
        bump = np.sqrt(np.clip(profile, 0, 1)) + 0.04 * rows
        higher = bump > height
        height, stitch = np.where(higher, bump, height), np.where(higher, lattice.row + rows, stitch)
        strand = np.where(higher, across, strand)
    twist = np.sin((strand * 2.5 + side) * np.float32(between(rng, 6, 16)))
    dyes = _draw_cloth_colours(rng, 4)
    tone = _draw_yarn_sequence(rng, motif * motif, 3).reshape(motif, motif)[stitch % motif, lattice.column % motif]
    colour = np.moveaxis(dyes[tone], -1, 0)
    wool = fbm(rng, size, columns * 2, 0.7)
    colour = vary_albedo(colour, 0.6 * wool + 0.5 * twist, between(rng, 0.05, 0.25)) * (
        0.3 + 0.7 * smoothstep(height, 0, 0.6)
    )
    rib = 0.8 * (lattice.column % 2) if motif % 2 == 0 and chance(rng, 0.5) else 0
    return assemble_maps(rng, colour, height + rib + 0.08 * twist + 0.12 * wool, (0.3, 0.9), (0.03, 0.05), (0.7, 1))


def stripes(rng: Rng, size: int) -> PeriodicMaps:
    """Draw stripes, corduroy, checks, zigzags or waves."""
    period = pick(rng, (1, 2, 2, 3, 4))
    bands = log_between(rng, 8, 30)
    angle = between(rng, 0, math.pi)
    kind = pick(rng, ("plain", "plain", "corduroy", "zigzag", "waves", "checks"))
    lattice = CellLattice(size, bands, bands, angle, 0, period, period)
    if kind in ("zigzag", "waves"):
        reach, length = between(rng, 0.4, 1.6), log_between(rng, 1.5, 4)
        along = CellLattice(size, bands / length, bands / length, angle)
        turn = np.abs(2 * along.u - 1) if kind == "zigzag" else 0.5 + 0.5 * np.sin(2 * np.pi * along.u)
        offset = (turn * np.float32(reach * 2)).astype(np.float32)
    else:
        offset = smooth_displacement(rng, size, 5, between(rng, 0, 0.008) * bands)[0]
    lattice = CellLattice(size, bands, bands, angle, 0, period, period, (offset, offset))
    shares = np.sort(uniforms(rng, period)) * 0.6 + 0.2
    soft = between(rng, 0.02, 0.15)
    share = shares[lattice.row % period]
    band = smoothstep(lattice.v, 0, soft) * smoothstep(lattice.v, share + soft, share)
    dyes = _draw_cloth_colours(rng, period + 1)
    colour = mix(uniform_colour(dyes[0], size), np.moveaxis(dyes[1 + lattice.row % period], -1, 0), band)
    if kind == "checks":
        column_band = smoothstep(lattice.u, 0, soft) * smoothstep(lattice.u, share + soft, share)
        colour = mix(colour, np.moveaxis(dyes[(1 + lattice.column) % (period + 1)], -1, 0), column_band * 0.5)
    threads = band_noise(rng, size, log_between(rng, 40, 90), 0.4, between(rng, 1, 12), angle)
    colour = vary_albedo(colour, threads, between(rng, 0.02, 0.2))
    if kind == "corduroy":
        wale = np.sqrt(np.clip(1 - (2 * lattice.v - 1) ** 2, 0, 1))
        colour = vary_albedo(uniform_colour(dyes[0], size), threads + 2 * wale - 1.5, between(rng, 0.1, 0.35))
        return assemble_maps(rng, colour, wale + 0.08 * threads, (0.2, 0.7), roughness=(0.7, 1))
    return assemble_maps(rng, colour, threads + between(rng, 0, 3) * band, (0.03, 0.3), roughness=(0.4, 1))


def leather(rng: Rng, size: int) -> PeriodicMaps:
    """Draw grained, creased or scaly hide."""
    colours = draw_palette(rng, "5a3218 7b4a26 2a1c14 8c5a3c a67b5b 1c1c1e 6b2020 d2b48c 3b4a5a 4a5240 e0d6c8", 2, 0.25)
    cells = log_between(rng, 9, 36)
    warp = smooth_displacement(rng, size, cells / 2, between(rng, 0.05, 0.25))
    grain = isotropic_cells(rng, size, cells, between(rng, 0.5, 0.95), warp, log_between(rng, 1, 2.5))
    pad = smoothstep(grain.edge, -0.02, between(rng, 0.1, 0.35))
    height = pad * (0.75 + 0.25 * uniforms(rng, grain.total)[grain.cell])
    if chance(rng, 0.5):  # a finer grain on the pads
        fine = isotropic_cells(rng, size, cells * 2.2, 0.9, warp)
        height = height + between(rng, 0.1, 0.5) * smoothstep(fine.edge, -0.02, 0.25)
    if chance(rng, 0.5):  # creases across the grain
        stretch, angle = between(rng, 1, 4), between(rng, 0, math.pi)
        crease = ridges(fbm(rng, size, cells / 3, 2.6, stretch, angle), log_between(rng, 0.05, 0.2))
        height = height - crease * between(rng, 0.3, 1.2)
    worn = fbm(rng, size, 5, 1.8)
    diffuse = colour_ramp(normal_to_uniform(0.5 * worn + between(rng, 0, 2) * (height - 0.8)), colours)
    diffuse = vary_albedo(diffuse, np.minimum(height - 0.7, 0.3), between(rng, 0.1, 1.5))
    roughness = np.clip(between(rng, 0.35, 0.75) - 0.1 * height + 0.06 * worn, 0.05, 1)
    relief = height + 0.03 * fbm(rng, size, cells * 1.5, 1.2)
    return assemble_maps(rng, diffuse, relief, (0.12, 0.6), (0.035, 0.06), roughness)
