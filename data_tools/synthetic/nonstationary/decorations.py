"""Families of patches that bear a design: ornaments, labels, leather with seams, carpets.

Each function `<family>(rng, size)` draws a patch of size x size texels.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.nonstationary.materials import (
    CLOTH_FAMILIES,
    GRAY_METALS,
    STONE_FAMILIES,
    WARM_METALS,
    WOOD_FAMILIES,
    bare_metal,
    paint_coat,
    plain_material,
    procedural_piece,
    varnish_surface,
)
from data_tools.synthetic.nonstationary.patch_surface import (
    PatchSurface,
    add_relief,
    blend_surfaces,
    blur_mirrored,
    cloud_noise,
    lay_surface,
    rim_coverage,
    tint_surface,
)
from data_tools.synthetic.nonstationary.shapes import (
    PatchCoordinates,
    box_distance,
    disc_distance,
    letter_distance,
    motif_distance,
    outline_distance,
    panel_grid,
    random_coordinates,
    star_distance,
    text_distance,
)
from data_tools.synthetic.nonstationary.weathering import (
    add_dirt,
    add_random_wear,
    add_scratches,
    add_smudges,
    add_stains,
    wear_edges,
)
from data_tools.synthetic.patterns.fields import mix, smoothstep
from data_tools.synthetic.random_values import Field, between, chance, integer_between, pick, uniforms
from data_tools.synthetic.stationary.periodic_maps import draw_dye_colours, draw_palette, uniform_colour


def frieze_distance(rng: Rng, along: Field, across: Field, period: float) -> Field:
    """Return the distance to the outline of a band of ornament, positive inside.

    Args:
        rng: random numbers for the kind of ornament.
        along: coordinates along the band.
        across: coordinates across the band, which reaches from -1 to 1.
        period: length along the band after which the ornament repeats.
    """
    kind = pick(rng, ("beads", "waves", "meander", "leaves", "lines"))
    u = along / period
    u = u - np.floor(u) - np.float32(0.5)
    if kind == "beads":
        return np.maximum(
            disc_distance(PatchCoordinates(2 * u, across, 1), 0.75), outline_distance(np.abs(across) - 0.95, 0.08)
        )
    if kind == "waves":
        return outline_distance(across - 0.5 * np.sin(u * math.tau), 0.2)
    if kind == "leaves":
        result: Field = np.maximum(
            0.8 - np.abs(across) - np.abs(2.4 * u - 0.5 * np.abs(across)), outline_distance(across, 0.08)
        )
        return result
    if kind == "meander":
        bars = (
            (0.0, -0.8, 0.5, 0.14),
            (-0.4, 0.0, 0.08, 0.9),
            (0.0, 0.8, 0.4, 0.14),
            (0.3, 0.4, 0.08, 0.5),
            (0.1, 0.0, 0.25, 0.14),
        )
        result = np.maximum.reduce(
            [box_distance(PatchCoordinates(u, across, 1).moved(x, y), w, h) for x, y, w, h in bars]
        )
        return result
    return np.maximum(outline_distance(np.abs(across) - 0.7, 0.12), outline_distance(across, 0.2))


def ornament(rng: Rng, size: int) -> PatchSurface:
    """Draw a carved, cast or chased relief of stone, wood or metal: motifs, friezes, inscriptions; often gilt."""
    kind = pick(rng, ("metal", "metal", "stone", "wood", "painted"))
    if kind == "metal":
        base = bare_metal(rng, size, roughness=(0.15, 0.45))
    elif kind == "painted":
        base = paint_coat(rng, size)
    else:
        base = procedural_piece(rng, size, STONE_FAMILIES if kind == "stone" else WOOD_FAMILIES)
        base = base._replace(height=np.clip(base.height, -1.5, 1.5) * 0.4)
    place = random_coordinates(rng, size, 0.5, 0.5)
    inside = np.full((size, size), -9, np.float32)
    for _ in range(integer_between(rng, 1, 3)):
        motif_place = place.moved(
            between(rng, -0.6, 0.6), between(rng, -0.6, 0.6), between(rng, -0.4, 0.4), between(rng, 0.35, 0.9)
        )
        inside = np.maximum(inside, motif_distance(rng, motif_place) * motif_place.unit)
    if chance(rng, 0.5):
        half_width, position = between(rng, 0.1, 0.2), between(rng, 0.5, 0.9)
        rail = np.abs(place.y) if chance(rng, 0.5) else place.y
        band = frieze_distance(rng, place.x, (rail - position) / half_width, between(rng, 0.2, 0.5)) * (
            half_width * place.unit
        )
        band_inside = (np.abs(rail - position) - half_width * 1.2) * place.unit
        inside = np.maximum(np.minimum(inside, band_inside), np.where(band_inside < 0, band, -9))
    elif chance(rng, 0.5):
        inside = np.maximum(
            inside,
            text_distance(rng, place.moved(0, between(rng, 0.3, 0.8)), 1.0, 0.2, integer_between(rng, 1, 2), 0.2)
            * place.unit,
        )
    depth = between(rng, 1.2, 4.5) * pick(rng, (1, 1, -1))
    rounded = pick(rng, (1.5, 2.5, 5.0, 9.0))
    surface = add_relief(base, depth * smoothstep(inside, -1.0, rounded))
    gilt = bare_metal(rng, size, WARM_METALS, (0.15, 0.4))
    if chance(rng, 0.4):
        share = rim_coverage(inside) if chance(rng, 0.7) else 1 - rim_coverage(inside)
        surface = blend_surfaces(surface, gilt._replace(height=surface.height), share)
    amount = between(rng, 0.2, 0.8)
    surface = add_dirt(
        rng, surface, amount, pick(rng, ("2a231c 3b3024 1f1e1c", "2f6f63 4f9a8a 1e4a48", "1a1a1a 2a2a2e"))
    )
    if kind in ("metal", "painted"):
        bare = (
            bare_metal(rng, size, GRAY_METALS, (0.12, 0.3))
            if kind == "painted"
            else varnish_surface(base, between(rng, 0.12, 0.25))
        )
        surface = wear_edges(rng, surface, bare, between(rng, 0.0, 0.6))
    return add_smudges(rng, surface, between(rng, 0.05, 0.3))


def label(rng: Rng, size: int) -> PatchSurface:
    """Draw stickers, prints and stencils on plastic, metal, board or wood: lines of text, bars, signs, torn corners."""
    kind = pick(rng, ("plastic", "metal", "metal", "board", "wood"))
    if kind == "metal":
        surface = bare_metal(rng, size, GRAY_METALS)
    elif kind == "board":
        surface = plain_material(rng, size, "b08d5c a07f50 c9ae7e", (0.7, 0.9), 0.1)
        surface = add_relief(surface, 0.3 * np.sin(random_coordinates(rng, size).x * between(rng, 30, 60)))
    else:
        surface = paint_coat(rng, size) if kind == "plastic" else procedural_piece(rng, size, WOOD_FAMILIES)
    for _ in range(integer_between(rng, 1, 2)):
        place = random_coordinates(rng, size, 0.5, 0.4)
        if chance(rng, 0.3):  # stencilled onto the surface itself
            ink = paint_coat(rng, size, roughness=(0.3, 0.7))
            half = between(rng, 0.3, 0.8)
            lines = (
                text_distance(rng, place, 1.0, half, integer_between(rng, 1, 3), between(rng, 0.15, 0.3)) * place.unit
            )
            surface = blend_surfaces(surface, ink._replace(height=surface.height), 0.9 * rim_coverage(lines))
        else:
            surface = _add_sticker(rng, surface, place)
    surface = add_random_wear(rng, surface)
    return add_scratches(rng, surface, integer_between(rng, 5, 40), 0.3) if chance(rng, 0.4) else surface


def _add_sticker(rng: Rng, surface: PatchSurface, place: PatchCoordinates) -> PatchSurface:
    """Add a sticker with two designs to a surface."""
    size = surface.height.shape[-1]
    half_width, half_height = between(rng, 0.4, 0.95), between(rng, 0.3, 0.75)
    inside = box_distance(place, half_width, half_height, pick(rng, (0.0, 0.05, 0.15))) * place.unit
    if chance(rng, 0.3):
        inside = disc_distance(place, half_width) * place.unit
        half_width, half_height = half_width * 0.7, half_width * 0.6
    tones = draw_dye_colours(rng, 2)
    if chance(rng, 0.6):
        tones = draw_palette(rng, "f4f2ec e8e0cc ffffff d9a017 c03028", 1, 0.02)[[0, 0]] * np.array(
            [[1], [0.05]], np.float32
        )
    is_metal = chance(rng, 0.25)
    sheet = (
        bare_metal(rng, size, GRAY_METALS + WARM_METALS, (0.15, 0.35))
        if is_metal
        else paint_coat(rng, size, tones[0], (0.1, 0.8))
    )
    sheet = sheet._replace(height=0.3 * sheet.height + between(rng, 0.0, 0.7) * blur_mirrored(surface.height, 1.5))
    ink = sheet._replace(
        diffuse=uniform_colour(np.clip(tones[1], 0.02, 0.8), size),
        specular=np.full((3, size, size), 0.045, np.float32),
        roughness=sheet.roughness + between(rng, -0.2, 0.3),
    )
    split = between(rng, -0.5, 0.5) * half_height
    upper, lower = place.moved(0, (split - half_height) / 2), place.moved(0, (split + half_height) / 2)
    for design_place, half in ((upper, (half_height + split) * 0.4), (lower, (half_height - split) * 0.4)):
        width, kind = half_width * 0.85, pick(rng, ("text", "text", "bars", "sign", "block"))
        if kind == "text":
            design = text_distance(
                rng,
                design_place,
                width,
                half,
                min(integer_between(rng, 1, 4), max(1, int(half / 0.09))),
                between(rng, 0.14, 0.26),
            )
        elif kind == "bars":
            bars = uniforms(rng, 4096)[np.floor(design_place.x * 40).astype(np.int64) % 4096] - 0.5
            design = np.minimum(bars * 0.1, box_distance(design_place, width, half))
        elif kind == "sign":
            design = motif_distance(
                rng, design_place.moved(between(rng, -0.4, 0.4) * width, 0, 0, max(half, 0.1))
            ) * max(half, 0.1)
        else:
            number = integer_between(rng, 0, 24)
            hollow = letter_distance(design_place.moved(0, 0, 0, max(half * 0.8, 0.1)), number, 0.22) * max(
                half * 0.8, 0.1
            )
            design = np.minimum(box_distance(design_place, width, half), -hollow)
        sheet = blend_surfaces(sheet, ink, rim_coverage(design * place.unit))
    if chance(rng, 0.4):
        sheet = blend_surfaces(sheet, ink, rim_coverage(outline_distance(inside - 3, 0.8)))
    tear_field = cloud_noise(rng, size, 2.5, 1.4) - between(rng, 0.8, 2.2)
    if chance(rng, 0.5):
        inside = np.minimum(inside, -tear_field * 8)
    curl = between(rng, 0, 1.5) * np.exp(-np.clip(inside, 0, 40) / 3) * smoothstep(cloud_noise(rng, size, 2, 2), 0, 1)
    thickness = between(rng, 1.0, 2.5) if is_metal else between(rng, 0.25, 0.9)
    return lay_surface(surface, add_relief(sheet, curl), inside, thickness, between(rng, 0.7, 1.5))


def stitched(rng: Rng, size: int) -> PatchSurface:
    """Draw panels of leather or heavy cloth sewn together, quilted, with studs: seams sink in, threads stand out."""
    hides = [procedural_piece(rng, size, ("leather",) if chance(rng, 0.8) else CLOTH_FAMILIES) for _ in range(2)]
    if chance(rng, 0.5):
        hides = [hide._replace(roughness=hide.roughness - between(rng, 0.05, 0.3)) for hide in hides]
    place = random_coordinates(rng, size, 0.6, 0.3)
    bend = between(rng, 0, 0.3) * np.sin(place.y * between(rng, 0.5, 2) + between(rng, 0, 6))
    line = (place.x + bend) * place.unit
    quilted = chance(rng, 0.4)
    if quilted:
        field_width = between(rng, 0.4, 0.9)
        cells = panel_grid(
            place.moved(0, 0, pick(rng, (0.0, math.pi / 4))), field_width, field_width * pick(rng, (1.0, 1.0, 3.0))
        )
        seam: Field = cells.inside * place.unit
        surface = blend_surfaces(hides[0], hides[1], float(chance(rng, 0.3)) * ((cells.column + cells.row) % 2 == 0))
        along: Field = (
            np.where(field_width / 2 - np.abs(cells.u) < seam / place.unit + 1e-3, cells.v, cells.u) * place.unit
        )
        pillow = between(rng, 2, 6) * (1 - np.exp(-seam / between(rng, 3, 10)))
        rows = [seam]
    else:
        surface = lay_surface(hides[0], hides[1], line, between(rng, -0.5, 2.0), 3)
        seam = np.abs(line)
        along = place.y * place.unit
        pillow = between(rng, 0.8, 3.5) * (1 - np.exp(-seam / between(rng, 2, 7)))
        row_distance = between(rng, 3, 7)
        rows = [np.abs(seam - row_distance)] if chance(rng, 0.7) else [np.abs(line - row_distance)]
    crease = np.exp(-((seam / 1.0) ** 2))
    surface = tint_surface(add_relief(surface, pillow - crease), 1 - 0.5 * crease)
    thread = paint_coat(rng, size, roughness=(0.35, 0.8))
    pitch, half = between(rng, 4.5, 9), between(rng, 0.8, 1.4)
    phase = along / pitch - np.floor(along / pitch)
    for row in rows:
        ditch = np.exp(-((row / 2.2) ** 2))
        surface = add_relief(surface, -between(rng, 0.4, 1.2) * ditch)
        stitch = np.minimum(half - row, (0.36 - np.abs(phase - 0.5)) * pitch)
        hole = np.exp(-(row**2 + ((np.abs(phase - 0.5) - 0.5) * pitch) ** 2) / 1.2)
        surface = tint_surface(add_relief(surface, -hole), 1 - 0.6 * hole)
        surface = lay_surface(surface, thread._replace(height=surface.height), stitch, between(rng, 0.6, 1.4))
    if chance(rng, 0.45):  # studs, buttons, buckles
        studs = panel_grid(place.moved(between(rng, 0, 1), 0), between(rng, 0.5, 0.9), between(rng, 0.3, 0.9))
        radius = between(rng, 0.06, 0.13)
        nearest: Field = np.hypot(studs.u, studs.v)
        dome = np.sqrt(np.clip(1 - (nearest / np.float32(radius)) ** 2, 0, 1)) * (
            radius * place.unit * between(rng, 0.3, 0.8)
        )
        stud = bare_metal(rng, size, roughness=(0.12, 0.35))._replace(height=blur_mirrored(surface.height, 3))
        surface = add_relief(lay_surface(surface, stud, (radius - nearest) * place.unit), dome)
    worn = tint_surface(surface, between(rng, 1.1, 1.7))._replace(roughness=surface.roughness * between(rng, 0.5, 0.9))
    return add_random_wear(
        rng, wear_edges(rng, surface, worn._replace(height=0 * surface.height), between(rng, 0.1, 0.7))
    )


def carpet(rng: Rng, size: int) -> PatchSurface:
    """Draw carpets, brocades and embroideries: ground, border, motifs in pile or thread, and the floor at the edge."""
    place = random_coordinates(rng, size, 0.9, 0.4, between(rng, 0.8, 1.3))
    tones = (
        draw_dye_colours(rng, 4)
        if chance(rng, 0.4)
        else draw_palette(rng, "6b1f22 1f2f4f c9a86a e8dcc0 2f4a35 8a4a2a", 4, 0.2)
    )
    half_width, half_height = between(rng, 0.8, 1.5), between(rng, 0.7, 1.3)
    inside = box_distance(place, half_width, half_height)
    hem = between(rng, 0.2, 0.35)  # width of the border
    zones = np.zeros((size, size), np.int64)
    repeat = panel_grid(place, between(rng, 0.35, 0.8), between(rng, 0.35, 0.8), pick(rng, (0.0, 0.5)))
    zones[motif_distance(rng, PatchCoordinates(repeat.u * 4, repeat.v * 4, place.unit / 4)) > 0] = 1
    medal = star_distance(
        place, integer_between(rng, 4, 16), between(rng, 0.35, 0.6), between(rng, 0.1, 0.5), float(chance(rng, 0.6))
    )
    if chance(rng, 0.6):
        zones[medal > 0] = 2
        zones[outline_distance(medal, 0.06) > 0] = 3
    border = inside < hem
    zones[border] = 2
    side = np.abs(place.x) / half_width > np.abs(place.y) / half_height
    along = np.where(side, place.y, place.x)
    zones[border & (frieze_distance(rng, along, (inside - hem / 2) / (hem / 2), between(rng, 0.2, 0.4)) > 0)] = (
        integer_between(rng, 0, 1)
    )
    zones[np.abs(inside - hem) < 0.03] = 3
    knots = between(rng, 40, 64)
    cells = panel_grid(place, 2 / knots, 2 / knots * between(rng, 1, 2), 0.5)
    fluff = cloud_noise(rng, size, 25, 0.6)
    pile = 0.5 * smoothstep(cells.inside * place.unit, -0.3, 0.8) + between(rng, 0.1, 0.4) * fluff
    tone = np.moveaxis(tones[zones], -1, 0) * (1 + 0.15 * (uniforms(rng, cells.total)[cells.cell] - 0.5))
    diffuse = tone * np.exp(0.08 * fluff + 0.12 * cloud_noise(rng, size, 2, 1.8))
    specular = np.full((3, size, size), 0.04, np.float32)
    rug = PatchSurface(diffuse, specular, np.full((size, size), between(rng, 0.75, 0.95), np.float32), pile)
    if chance(rng, 0.5):  # threads of silk or metal, couched on top
        gold = bare_metal(rng, size, ("gold", "silver", "copper"), (0.3, 0.5))
        silk = rug._replace(roughness=np.full((size, size), between(rng, 0.3, 0.45), np.float32))
        ribs = 0.4 * np.sin((place.x + place.y) * between(rng, 40, 90))
        threads = add_relief((gold if chance(rng, 0.5) else silk)._replace(height=0.5 * pile), ribs + 0.6)
        rug = blend_surfaces(
            rug, threads, rim_coverage(blur_mirrored((zones == integer_between(rng, 1, 3)) - np.float32(0.5), 0.5) * 3)
        )
    else:
        lift = blur_mirrored((zones > 0).astype(np.float32), 0.8)
        rug = add_relief(rug, between(rng, -0.8, 1.5) * lift)
    floor = procedural_piece(rng, size, STONE_FAMILIES + WOOD_FAMILIES * 3)
    floor = varnish_surface(floor, between(rng, 0.12, 0.4), 0.7)
    fringe = np.where(np.abs(np.sin(along * between(rng, 25, 45))) > 0.4, inside + 0.12, inside)
    shade = 1 - 0.5 * smoothstep(inside * place.unit, -8, 0)
    surface = lay_surface(
        tint_surface(floor, shade), rug, np.where(side, inside, fringe) * place.unit, between(rng, 1.2, 3), 2
    )
    if chance(rng, 0.5):  # worn where people walk
        trodden = smoothstep(cloud_noise(rng, size, 1.5, 1.8), 0.3, 1.2) * (inside > 0)
        surface = surface._replace(
            diffuse=surface.diffuse * (1 - 0.3 * trodden),
            roughness=mix(surface.roughness, surface.roughness * 0.7, trodden),
        )
    return add_stains(rng, surface, 1) if chance(rng, 0.3) else surface
