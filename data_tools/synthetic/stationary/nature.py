"""Procedural growth and decay: rust, grass, foliage, camouflage, and dots of all kinds.

Each function `<family>(rng, size)` draws periodic maps of size x size texels.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.cells import CellLattice, isotropic_cells, worley_noise
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
from data_tools.synthetic.patterns.strokes import scatter_strokes
from data_tools.synthetic.random_values import Field, between, chance, integer_between, log_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import (
    PeriodicMaps,
    assemble_maps,
    draw_dye_colours,
    draw_palette,
    uniform_colour,
    vary_albedo,
)

_LEAVES = "3f6b2a 6b8e23 2e4d1f 8fae4b 55702f a9b665 b5762a 7a3b1e c9a227 46583a"
_STRAW = "c9b26a a08a4a d9c88f 7d6b3a 6b7a3a 4f6b2a 8a7a5a e3d7a8"


def rust(rng: Rng, size: int) -> PeriodicMaps:
    """Draw rust or patina that eats a coat."""
    frequency = log_between(rng, 4, 10)
    stretch = log_between(rng, 1, 4) if chance(rng, 0.4) else 1.0  # where water runs down
    spread = fbm(rng, size, frequency, between(rng, 1.3, 2.6), stretch, between(rng, 0, math.pi))
    level = between(rng, -0.8, 0.8)
    eaten = smoothstep(spread, level, level + log_between(rng, 0.05, 0.6))
    scale = fbm(rng, size, frequency * 2, between(rng, 0.7, 1.5))
    rusts = draw_palette(rng, "3b1d10 6e2f14 a34a1a c8702a 8a4b2a d98f4a 4a2a1e", 4, 0.1)
    if chance(rng, 0.2):
        rusts = draw_palette(rng, "2f6f63 4f9a8a 87bfa8 1e4a48 b5c9a8", 4, 0.1)  # patina of copper
    crust = colour_ramp(normal_to_uniform(0.8 * scale + 0.5 * spread), rusts)
    coat = (
        draw_dye_colours(rng, 1)[0] if chance(rng, 0.6) else draw_palette(rng, "5f6266 8f9499 3a3b3d b8b2a8", 1, 0.1)[0]
    )
    body = vary_albedo(uniform_colour(coat, size), fbm(rng, size, 6, 1.3), between(rng, 0.04, 0.2))
    halo = ridges(spread - np.float32(level), 0.5) * between(rng, 0, 0.6)
    diffuse = mix(mix(body, uniform_colour(rusts[2], size), halo), crust, eaten)
    height = eaten * (between(rng, -1, 0.6) + 0.3 * scale) + 0.03 * scale
    roughness = mix(np.full_like(eaten, between(rng, 0.25, 0.6)), np.full_like(eaten, 0.92), eaten)
    specular = mix(np.full_like(eaten, between(rng, 0.04, 0.4)), np.full_like(eaten, 0.04), eaten)
    return assemble_maps(rng, diffuse, height, (0.1, 0.6), specular, roughness)


def grass(rng: Rng, size: int) -> PeriodicMaps:
    """Draw overlapping blades, needles, hay or hair."""
    kind = pick(rng, ("blades", "hay", "needles", "fur"))
    angle = between(rng, 0, 2 * math.pi)
    count, length, width, spread, curl = {
        "blades": (integer_between(rng, 1200, 2200), (0.08, 0.2), (0.006, 0.016), between(rng, 0.5, math.pi), 1.2),
        "hay": (integer_between(rng, 700, 1300), (0.2, 0.45), (0.006, 0.012), between(rng, 0.3, math.pi), 0.5),
        "needles": (integer_between(rng, 2000, 3500), (0.05, 0.12), (0.004, 0.009), math.pi, 0.3),
        "fur": (integer_between(rng, 2500, 4000), (0.1, 0.2), (0.003, 0.008), between(rng, 0.15, 0.6), 1.5),
    }[kind]
    zoom = log_between(rng, 0.8, 1.6)
    length, width = (length[0] * zoom, length[1] * zoom), (width[0] * zoom, width[1] * zoom)
    blades = scatter_strokes(
        rng, size, int(count / zoom**1.5), length, width, (angle, spread), curl, 0 if kind == "hay" else 1
    )
    colours = draw_palette(rng, _STRAW if kind == "hay" or chance(rng, 0.3) else _LEAVES, 4, 0.2)
    if kind == "fur":
        colours = draw_palette(rng, "4a3425 8a6a4a c9a97f 2a2220 b5b0a8 e6dccb 7a3f22", 3, 0.25)
    tone = blades.of_each(uniforms(rng, blades.total))
    rounded = np.sqrt(np.clip(1 - blades.across**2, 0, 1))
    diffuse = colour_ramp(0.15 + 0.7 * tone + 0.15 * blades.along, colours)
    diffuse = diffuse * (0.25 + 0.75 * blades.depth ** np.float32(between(rng, 0.5, 1.5))) * (0.6 + 0.4 * rounded)
    ground = uniform_colour(colours[0] * np.float32(0.2), size)
    diffuse = mix(ground, diffuse, blades.covered)
    return assemble_maps(rng, diffuse, blades.depth * 2 + 0.6 * rounded, (0.3, 0.8), (0.03, 0.06), (0.4, 0.8))


def foliage(rng: Rng, size: int) -> PeriodicMaps:
    """Draw leaves on leaves, petals, moss or tufts."""
    colours = draw_palette(rng, _LEAVES, 4, 0.2)
    if chance(rng, 0.25):
        colours = draw_dye_colours(rng, 4)
    if chance(rng, 0.35):
        return _draw_clumps(rng, size, colours)
    zoom = log_between(rng, 0.05, 0.16)
    slim = between(rng, 0.3, 0.9)
    count = int(between(rng, 3.0, 6.0) / (zoom * zoom * slim))
    spread = math.pi if chance(rng, 0.7) else between(rng, 0.4, 1)
    angle = between(rng, 0, 2 * math.pi)
    span = (0.6 * zoom, 1.2 * zoom)
    leaves = scatter_strokes(rng, size, count, span, (span[0] * slim, span[1] * slim), (angle, spread), 0.8, 2)
    draws = uniforms(rng, 2, leaves.total)
    tone, shade = leaves.of_each(draws[0]), leaves.of_each(draws[1])
    middle = ridges(leaves.across, between(rng, 0.05, 0.15))
    veins = np.sin((leaves.along * 2 + np.abs(leaves.across)) * np.float32(between(rng, 10, 30))) * between(rng, 0, 0.6)
    diffuse = colour_ramp(tone * 0.8 + 0.2 * np.abs(leaves.across), colours)
    diffuse = vary_albedo(diffuse, veins + middle + shade - 0.5, between(rng, 0.1, 0.4))
    diffuse = diffuse * (0.2 + 0.8 * leaves.depth ** np.float32(between(rng, 0.5, 1.5)))
    diffuse = mix(uniform_colour(colours[0] * np.float32(0.12), size), diffuse, leaves.covered)
    cup = between(rng, -0.5, 0.5) * leaves.across**2
    height = 1.5 * leaves.depth + cup - 0.15 * middle + 0.08 * veins
    return assemble_maps(rng, diffuse, height, (0.2, 0.7), (0.03, 0.06), (0.3, 0.8))


def _draw_clumps(rng: Rng, size: int, colours: Field) -> PeriodicMaps:
    """Draw domes on domes, such as moss, broccoli or a lawn of tufts from above."""
    coarse = log_between(rng, 6, 16)
    height = np.zeros((size, size), np.float32)
    tone = np.zeros((size, size), np.float32)
    for octave in range(3):
        cells = isotropic_cells(
            rng, size, coarse * 2.1**octave, 0.9, smooth_displacement(rng, size, coarse * 2**octave, 0.08)
        )
        height = height + np.clip(1 - cells.nearest**2, 0, 1) * np.float32(0.55**octave)
        tone = tone + (uniforms(rng, cells.total)[cells.cell] - 0.5) * np.float32(0.7**octave)
    height = height + 0.04 * fbm(rng, size, coarse * 4, 0.8)
    light = normal_to_uniform(between(rng, 0.8, 2) * (height - height.mean()) / height.std() + tone)
    return assemble_maps(rng, colour_ramp(light, colours), height, (0.4, 1.0), roughness=(0.7, 1))


def camouflage(rng: Rng, size: int) -> PeriodicMaps:
    """Draw blotches in layers, zebra stripes, leopard spots or lichen."""
    stretch, angle = log_between(rng, 1, 3), between(rng, 0, math.pi)
    frequency = log_between(rng, 5, 15) * math.sqrt(stretch)
    kind = pick(rng, ("layers", "layers", "stripes", "spots", "lichen"))
    count = integer_between(rng, 2, 5)
    colours = draw_palette(rng, "4b5320 78866b c2b280 3b3024 8a7f5a 2f3b2a 9c8f70 5a4a3a", count, 0.4)
    colours = colours * np.linspace(0.6, 1.6, count, dtype=np.float32)[:, None]
    if chance(rng, 0.4):
        colours = draw_dye_colours(rng, count)
    soft = log_between(rng, 0.03, 0.4)
    diffuse = uniform_colour(colours[0], size)
    edge = np.zeros((size, size), np.float32)
    for index in range(1, count if kind == "layers" else 2):
        if kind == "stripes":
            blot = band_noise(rng, size, frequency * 1.4, 0.18, 1.2 * stretch, angle)
        elif kind == "spots":
            blot = band_noise(rng, size, frequency * 1.8, 0.22) - np.float32(between(rng, 0.2, 0.9))
        else:
            blot = fbm(rng, size, frequency, between(rng, 1.6, 3.2), stretch, angle)
            blot = blot - np.float32(between(rng, -0.2, 0.6))
        patch = smoothstep(blot, 0, soft)
        edge = np.maximum(edge, patch)
        diffuse = mix(diffuse, uniform_colour(colours[index], size), patch)
        if kind == "spots" and chance(rng, 0.5):  # with a lighter heart
            diffuse = mix(diffuse, uniform_colour(colours[-1] * np.float32(0.8), size), smoothstep(blot, 0.7, 0.9))
    ground = band_noise(rng, size, log_between(rng, 40, 90), 0.4, between(rng, 1, 6), angle)
    if kind == "lichen":
        ground = fbm(rng, size, frequency * 2, 0.7)
    diffuse = vary_albedo(diffuse, ground, between(rng, 0.02, 0.2))
    return assemble_maps(rng, diffuse, ground + between(rng, 0, 3) * edge, (0.03, 0.4), roughness=(0.5, 1))


def dots(rng: Rng, size: int) -> PeriodicMaps:
    """Draw printed dots, perforated plates, studs or bubbles."""
    kind = pick(rng, ("printed", "printed", "perforated", "studs", "bubbles", "bubbles"))
    if kind == "bubbles":
        return _draw_bubbles(rng, size)
    count, hexagonal = log_between(rng, 7, 26), chance(rng, 0.6)
    rows = count * 2 / math.sqrt(3) if hexagonal else count
    jitter = 0.0 if kind == "perforated" or chance(rng, 0.5) else between(rng, 0.2, 0.8)
    lattice = CellLattice(size, count, rows, between(rng, 0, math.pi), 0.5 if hexagonal else 0, 2 if hexagonal else 1)
    spots = worley_noise(rng, lattice, jitter)
    draws = uniforms(rng, 2, spots.total)[:, spots.cell]
    radius = np.float32(between(rng, 0.2, 0.42)) * (1 - np.float32(jitter * between(rng, 0, 0.7)) * draws[0])
    inside = smoothstep(spots.nearest, radius, radius - 0.06)
    colours = draw_dye_colours(rng, integer_between(rng, 2, 5))
    fine = fbm(rng, size, 20, 0.7)
    ground = vary_albedo(uniform_colour(colours[0], size), fine, between(rng, 0.02, 0.15))
    if kind == "printed":
        colour_number = 1 + (draws[1] * (len(colours) - 1)).astype(np.int64)
        threads = band_noise(rng, size, log_between(rng, 40, 90), 0.4, between(rng, 1, 6), between(rng, 0, math.pi))
        diffuse = vary_albedo(
            mix(ground, np.moveaxis(colours[colour_number], -1, 0), inside), threads, between(rng, 0.02, 0.15)
        )
        return assemble_maps(rng, diffuse, threads + between(rng, 0, 2) * inside, (0.03, 0.25), roughness=(0.4, 1))
    if kind == "perforated":
        metal = vary_albedo(
            uniform_colour(draw_palette(rng, "b8bcc0 8f9499 c9c5bd 3f4246 d4af6a", 1, 0.3)[0], size), fine, 0.1
        )
        diffuse = mix(metal, uniform_colour(np.full(3, between(rng, 0.01, 0.05), np.float32), size), inside)
        shine = np.full_like(inside, between(rng, 0.2, 0.7)) * (1 - inside) + 0.02
        return assemble_maps(rng, diffuse, -inside + 0.02 * fine, (0.1, 0.4), shine, 0.35 + 0.6 * inside)
    round_top = np.sqrt(np.clip(1 - (spots.nearest / radius) ** 2, 0, 1))
    diffuse = mix(ground, uniform_colour(colours[-1] if chance(rng, 0.4) else colours[0], size), inside)
    return assemble_maps(rng, diffuse, round_top * 3 + 0.02 * fine, (0.2, 0.7), (0.04, 0.06), (0.2, 0.7))


def _draw_bubbles(rng: Rng, size: int) -> PeriodicMaps:
    """Draw foam or blisters: domes of several sizes, large ones over small ones."""
    coarse = log_between(rng, 6, 14)
    height, tone = np.zeros((size, size), np.float32), np.zeros((size, size), np.float32)
    rim = np.zeros((size, size), np.float32)
    for octave in (2, 1, 0):
        cells = isotropic_cells(rng, size, coarse * 1.8**octave, 0.9)
        draws = uniforms(rng, 2, cells.total)[:, cells.cell]
        radius = 0.25 + 0.3 * draws[0]
        inside = np.clip(1 - (cells.nearest / radius) ** 2, 0, 1)
        dome = np.sqrt(inside) * radius * np.float32(1.8**-octave)
        higher = dome > height * (0.3 if octave == 0 else 1)
        height = np.where(higher & (inside > 0), dome + 0.1, height)
        tone = np.where(higher & (inside > 0), draws[1], tone)
        rim = np.where(higher & (inside > 0), ridges(inside, 0.3), rim)
    colours = (
        draw_dye_colours(rng, 3)
        if chance(rng, 0.5)
        else draw_palette(rng, "f2f0ea d9e3e6 c9b79c 8a6a4a 5f7a80", 3, 0.3)
    )
    diffuse = vary_albedo(colour_ramp(tone, colours), rim - blur_periodic(rim, 0.02), between(rng, -0.5, 0.5))
    holes = chance(rng, 0.35)  # a sponge rather than a foam
    relief = -height if holes else height
    diffuse = diffuse * (1 - np.float32(0.7) * smoothstep(height, 0.1, 0.4)) if holes else diffuse
    return assemble_maps(rng, diffuse, relief, (0.3, 0.9), (0.03, 0.06), (0.2, 0.8))
