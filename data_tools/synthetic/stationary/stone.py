"""Procedural stone and earth: grain, terrazzo, gravel, cracks, marble, granite.

Each function `<family>(rng, size)` draws periodic maps of size x size texels.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.cells import isotropic_cells
from data_tools.synthetic.patterns.fields import (
    band_noise,
    blur_periodic,
    colour_ramp,
    fbm,
    mix,
    normal_to_uniform,
    ridges,
    smooth_displacement,
    smoothstep,
)
from data_tools.synthetic.random_values import Field, between, chance, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import (
    PeriodicMaps,
    assemble_maps,
    draw_dye_colours,
    draw_palette,
    uniform_colour,
    vary_albedo,
)

_EARTHS = "8a6f4d c2b280 6b4a32 a0522d 7d7468 b5a18a 4e3b2a cdb79e 94826a 5c5349"
_STONES = "8c8c8c b0a99f 6e6a66 d6d0c4 4b4a4d a38f78 7c8478 c9b8a8 5a5f66 e6e2da"


def grain(rng: Rng, size: int) -> PeriodicMaps:
    """Draw sandpaper, concrete or stucco."""
    return pick(rng, (_draw_sandpaper, _draw_sandpaper, _draw_concrete, _draw_concrete, _draw_stucco))(rng, size)


def _draw_sandpaper(rng: Rng, size: int) -> PeriodicMaps:
    """Draw sandpaper: lumps of several shades, some of which glint."""
    cells = isotropic_cells(rng, size, log_between(rng, 20, 60))
    shade = uniforms(rng, cells.total)[cells.cell]
    lump = smoothstep(cells.nearest, between(rng, 0.4, 0.8), 0.0)
    colours = draw_palette(rng, _EARTHS + " 303030 8b1a1a 2f4f4f", 3)
    spread = between(rng, 0.3, 1.0)
    diffuse = colour_ramp(0.5 + spread * (shade - 0.5) + 0.1 * fbm(rng, size, 4, 1.0), colours)
    glints = smoothstep(shade, 0.9, 0.95) * chance(rng, 0.5)
    diffuse = mix(diffuse, uniform_colour(draw_palette(rng, "fff4e0 e8e8f0", 1)[0], size), glints * 0.7)
    return assemble_maps(rng, diffuse, lump * (0.4 + shade), (0.15, 0.8), (0.03, 0.06), 0.9 - 0.5 * glints)


def _draw_concrete(rng: Rng, size: int) -> PeriodicMaps:
    """Draw concrete with stains and pores, often with the print of boards."""
    stains = fbm(rng, size, log_between(rng, 3, 8), between(rng, 1.2, 2.2))
    fine = fbm(rng, size, 30, 0.7)
    pores = band_noise(rng, size, log_between(rng, 12, 45), 0.4)
    holes = smoothstep(pores, between(rng, 1.5, 2.3), 2.6)
    diffuse = colour_ramp(0.5 + 0.18 * stains + 0.08 * fine, draw_palette(rng, _STONES, 2, 0.15))
    diffuse = vary_albedo(diffuse, -holes, between(rng, 0.3, 1.2))
    if chance(rng, 0.4):  # the print of boards or of a broom
        angle = between(rng, 0, math.pi)
        lines = band_noise(rng, size, log_between(rng, 15, 60), 0.3, between(rng, 8, 30), angle)
        return assemble_maps(rng, vary_albedo(diffuse, lines, 0.08), 0.2 * fine + lines - 4 * holes, (0.08, 0.35))
    return assemble_maps(rng, diffuse, 0.3 * stains + 0.3 * fine - 4 * holes, (0.08, 0.4))


def _draw_stucco(rng: Rng, size: int) -> PeriodicMaps:
    """Draw stucco: lumps or ridges of one scale."""
    frequency = log_between(rng, 8, 26)
    body = band_noise(rng, size, frequency, 0.5, log_between(rng, 1, 2.5), between(rng, 0, math.pi))
    kind = between(rng, 0, 3)
    lumps = np.abs(body) if kind < 1 else smoothstep(body, -0.4, 0.9) if kind < 2 else -np.abs(body)
    height = lumps + 0.06 * fbm(rng, size, frequency * 2, 0.8)
    colours = draw_palette(rng, "e8dcc8 d9c7a8 f0ece4 c98f6b b7c3c9 e3b778 9c8f80", 2)
    diffuse = colour_ramp(normal_to_uniform(lumps * 1.5 - 1) * between(rng, 0.2, 1), colours)
    return assemble_maps(rng, vary_albedo(diffuse, fbm(rng, size, 4, 1.5), 0.06), height, (0.2, 0.7))


def terrazzo(rng: Rng, size: int) -> PeriodicMaps:
    """Draw chips of stone, of several sizes, in a binder."""
    count = pick(rng, (2, 3, 4, 5))
    chips = draw_palette(rng, _STONES + " b03a2e 2e6b5e d9a441 283747 f2efe9", count, 0.3)
    if chance(rng, 0.3):
        chips = draw_dye_colours(rng, count)
    binder = draw_palette(rng, _STONES + " f2efe9 ddd5c5 3a3a3c", 1)[0]
    diffuse = vary_albedo(uniform_colour(binder, size), fbm(rng, size, 24, 0.6), between(rng, 0.02, 0.15))
    covered = np.zeros((size, size), np.float32)
    coarse = log_between(rng, 6, 16)
    for octave in range(pick(rng, (1, 2, 3, 3))):
        bend = smooth_displacement(rng, size, coarse * 2, between(rng, 0.0, 0.08))
        cells = isotropic_cells(rng, size, coarse * 1.9**octave, warp=bend)
        draws = uniforms(rng, 3, cells.total)
        is_chip = draws[0] < between(rng, 0.4, 0.95)
        inside = (
            smoothstep(cells.edge, between(rng, 0.03, 0.16), between(rng, 0.17, 0.2))
            * is_chip[cells.cell]
            * (1 - covered)
        )
        tint = chips[(draws[1] * count).astype(np.int64)] * (0.75 + 0.5 * draws[2])[:, None]
        colour = np.moveaxis(tint[cells.cell], -1, 0) * np.exp(0.08 * fbm(rng, size, 20, 1.0))
        diffuse = mix(diffuse, colour, inside)
        covered = np.maximum(covered, inside)
    polished = between(rng, 0.12, 0.5)
    roughness = mix(np.full_like(covered, min(1, polished * 1.8)), np.full_like(covered, polished), covered)
    return assemble_maps(rng, diffuse, covered + 0.1 * fbm(rng, size, 30, 0.5), (0.01, 0.1), (0.035, 0.06), roughness)


def gravel(rng: Rng, size: int) -> PeriodicMaps:
    """Draw pebbles or broken stones, small ones between large ones."""
    coarse, aspect = log_between(rng, 6, 22), between(rng, 1, 1.9)
    sharp = chance(rng, 0.35)  # broken stones are flat and angular, pebbles are round
    colours = draw_palette(rng, _STONES + " " + _EARTHS, pick(rng, (2, 3, 5)), 0.2)
    diffuse, height = _draw_stone_bed(rng, size, coarse * 2.3, aspect, sharp, colours)
    cells = isotropic_cells(
        rng, size, coarse, between(rng, 0.6, 0.9), smooth_displacement(rng, size, coarse, 0.05), aspect
    )
    draws = uniforms(rng, 4, cells.total)
    uneven = 0.015 * fbm(rng, size, coarse * 3, 2.0)
    narrow, spread = between(rng, 0.03, 0.08), between(rng, 0, 0.15)
    rim = uneven + np.float32(narrow) + np.float32(spread) * draws[0][cells.cell]
    present = (draws[1] < between(rng, 0.7, 1.0))[cells.cell]
    inside = smoothstep(cells.edge, rim, rim + 0.05) * present
    dome = _stone_profile(cells.edge - rim, sharp) * (0.6 + 0.4 * draws[2][cells.cell])
    if sharp:
        tilt = (draws[2] - 0.5)[cells.cell] * cells.across_x + (draws[3] - 0.5)[cells.cell] * cells.across_y
        dome = dome + tilt * 0.8
    stone = _draw_stone_albedo(rng, size, draws[3][cells.cell], colours, coarse)
    diffuse, height = mix(diffuse * np.float32(0.6), stone, inside), mix(height * 0.4, 0.5 + dome, inside)
    return assemble_maps(rng, diffuse, height, (0.35, 1.1), (0.03, 0.06), (0.35, 0.9))


def _stone_profile(edge: Field, sharp: bool) -> Field:
    """Return the profile of a stone, 0 .. 1, from the distance to its rim."""
    inside = np.clip(edge / 0.35, 0, 1)
    result: Field = np.minimum(inside * 3, 1) if sharp else np.sqrt(inside * (2 - inside))
    return result


def _draw_stone_albedo(rng: Rng, size: int, tone: Field, colours: Field, coarse: float) -> Field:
    """Draw the albedo [3, S, S] of stones from their tones [S, S] along a ramp of colours."""
    body = colour_ramp(tone, colours)
    return vary_albedo(body, fbm(rng, size, coarse * 2, 0.8), between(rng, 0.05, 0.25))


def _draw_stone_bed(
    rng: Rng, size: int, cells: float, aspect: float, sharp: bool, colours: Field
) -> tuple[Field, Field]:
    """Draw a bed of small stones: its albedo [3, S, S] and its height [S, S]."""
    small = isotropic_cells(rng, size, cells, 0.85, None, aspect)
    tone = uniforms(rng, small.total)[small.cell]
    diffuse = _draw_stone_albedo(rng, size, tone, colours, cells)
    inside = smoothstep(small.edge, 0.0, 0.1)
    return diffuse * (0.35 + 0.65 * inside), _stone_profile(small.edge, sharp)


def cracks(rng: Rng, size: int) -> PeriodicMaps:
    """Draw dry mud, or paint that flakes off."""
    coarse = log_between(rng, 5, 16)
    rough = fbm(rng, size, coarse, between(rng, 1.9, 2.6)), fbm(rng, size, coarse, 2.3)
    bend = np.float32(between(rng, 0.03, 0.1))
    warp = (rough[0] * bend, rough[1] * bend)
    plates = isotropic_cells(rng, size, coarse, 0.9, warp, between(rng, 1, 1.6))
    fine = isotropic_cells(rng, size, coarse * between(rng, 1.8, 3.2), 0.9, (warp[0] * 1.6, warp[1] * 1.6))
    width = log_between(rng, 0.02, 0.08)
    gap = smoothstep(plates.edge, width * 1.4, width * 0.5)
    branches = smoothstep(fine.edge, width * 1.5, width * 0.6) * (uniforms(rng, plates.total) < 0.6)[plates.cell]
    gap = np.maximum(gap, branches * between(rng, 0.2, 0.9))
    tone = uniforms(rng, plates.total)[plates.cell]
    grit = fbm(rng, size, coarse * 2, 1.2)
    if chance(rng, 0.5):
        colours = draw_palette(rng, _EARTHS, 3, 0.15)
        diffuse = vary_albedo(
            colour_ramp(0.5 + 0.6 * (tone - 0.5) + 0.15 * grit, colours), -gap, between(rng, 0.8, 2.0)
        )
        curl = between(rng, 0, 0.8) * smoothstep(plates.edge, 0.25, 0.05)
        return assemble_maps(rng, diffuse, 0.15 * grit + curl - 1.5 * gap, (0.2, 0.8), roughness=(0.7, 1))
    paint, ground = draw_dye_colours(rng, 1)[0], draw_palette(rng, _EARTHS + " d9d4c8 3b3b3b", 2)
    is_flaked = (uniforms(rng, fine.total) < between(rng, 0, 0.35))[fine.cell]
    bare = np.maximum(gap, smoothstep(blur_periodic(is_flaked.astype(np.float32), 0.003), 0.4, 0.6))
    coat = vary_albedo(uniform_colour(paint, size), 0.5 * grit + (tone - 0.5) * 2, between(rng, 0.03, 0.15))
    diffuse = mix(coat, colour_ramp(normal_to_uniform(fbm(rng, size, 10, 1.2)), ground), bare)
    roughness = mix(np.full_like(bare, between(rng, 0.2, 0.6)), np.float32(0.9) + 0 * bare, bare)
    return assemble_maps(rng, diffuse, 0.05 * grit - bare, (0.1, 0.5), (0.04, 0.06), roughness)


def marble(rng: Rng, size: int) -> PeriodicMaps:
    """Draw veined stone, polished."""
    stretch, angle = log_between(rng, 1, 4), between(rng, 0, math.pi)
    frequency, slope = log_between(rng, 3.2, 6.5) * math.sqrt(stretch), between(rng, 2.0, 3.0)
    cloud = fbm(rng, size, frequency, slope, stretch, angle)
    colours = draw_palette(rng, "f2efe9 d8d2c6 bfc4c4 8f9a94 3d4a44 1f1f22 b98d6c e8c9b0 6d7b8a 70463a", 3, 0.2)
    weight = between(rng, 0.15, 0.5)
    if chance(rng, 0.35):  # bands rather than clouds
        diffuse = colour_ramp(0.5 + 0.5 * np.sin(cloud * np.float32(between(rng, 1.5, 3.5))), colours)
    else:
        diffuse = colour_ramp(0.5 + weight * cloud, colours)
    vein_colour = draw_palette(rng, "f7f5f0 2b2b2d 7a5c3e c9a66b 5a6660", 1)[0]
    for octave in range(pick(rng, (1, 2, 3))):
        vein = fbm(rng, size, frequency * 1.7**octave, 2.9, stretch, angle + between(rng, -0.3, 0.3))
        line = ridges(vein, log_between(rng, 0.06, 0.2)) * smoothstep(fbm(rng, size, frequency, 2.0), -0.8, 0.8)
        diffuse = mix(diffuse, uniform_colour(vein_colour, size), line * between(rng, 0.4, 1.0))
    height = fbm(rng, size, 20, 0.7)
    return assemble_maps(rng, diffuse, height, (0.004, 0.03), (0.035, 0.06), (0.08, 0.4))


def granite(rng: Rng, size: int) -> PeriodicMaps:
    """Draw crystals of three to five minerals."""
    fine = log_between(rng, 14, 50)
    tones = "e8e0d8 b9a9a0 c98f7a 8a8580 45413f 1e1d1f 9aa3a8 a8553e 5d6b5a"
    minerals = draw_palette(rng, tones, pick(rng, (3, 4, 5)), 0.15)
    warp = smooth_displacement(rng, size, fine, between(rng, 0.0, 0.2))
    cells = isotropic_cells(rng, size, fine, 0.95, warp, between(rng, 1, 1.6))
    clumps = band_noise(rng, size, fine / between(rng, 1.5, 5), 0.5)
    cell_tone = uniforms(rng, cells.total)[cells.cell] - 0.5
    tone = normal_to_uniform(np.float32(between(rng, 0.2, 0.9)) * clumps + 2.2 * cell_tone)
    places = np.minimum((tone * len(minerals)).astype(np.int64), len(minerals) - 1)
    diffuse = np.moveaxis(minerals[places], -1, 0) * np.exp(0.12 * fbm(rng, size, fine, 0.6))
    mica = smoothstep(band_noise(rng, size, fine * 0.8, 0.4), 1.3, 1.6) * between(rng, 0, 1)
    diffuse = mix(diffuse, uniform_colour(draw_palette(rng, "1a1a1c 2e2622 3c3f45", 1)[0], size), mica)
    polished = between(rng, 0.1, 0.6)
    roughness = np.clip(polished + 0.2 * mica + 0.1 * (tone - 0.5), 0.05, 1)
    return assemble_maps(rng, diffuse, tone + 0.3 * fbm(rng, size, 30, 0.6), (0.01, 0.25), (0.035, 0.07), roughness)
