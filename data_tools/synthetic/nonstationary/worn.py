"""Patches that time has been at: rust, flaking paint, puddles, stains, tracks, scratches, plaster that falls off."""

from __future__ import annotations

import math

import numpy as np

from data_tools.draws import Rng
from data_tools.synthetic.draws import between, chance, log_between, pick, whole
from data_tools.synthetic.nonstationary.materials import (
    CLOTHS,
    GRAY,
    GROUNDS,
    STONES,
    WARM,
    WOODS,
    metal,
    paint,
    piece,
    plain,
    polished,
    solid,
)
from data_tools.synthetic.nonstationary.shapes import anywhere, centred, grid, outline
from data_tools.synthetic.nonstationary.surface import (
    Surface,
    cloud,
    covers,
    distance,
    lay,
    overlay,
    raised,
    softened,
    tinted,
    towards,
)
from data_tools.synthetic.nonstationary.weather import (
    dented,
    dirty,
    rusted,
    scaled,
    scratched,
    smudged,
    stained,
    weathered,
    wet,
)
from data_tools.synthetic.patterns.cells import isotropic_cells
from data_tools.synthetic.patterns.fields import mix, ridges, step

_EARTHS = "8a6f4d 6b4a32 4e3b2a b5a18a 94826a 5c5349"


def corroded(rng: Rng, size: int) -> Surface:
    """Bare or painted metal that rusts, more on one side than on the other, dented and streaked."""
    bare = metal(rng, size, GRAY if chance(rng, 0.6) else WARM, (0.15, 0.45))
    surface = raised(paint(rng, size), 0.5 * bare.height) if chance(rng, 0.35) else bare
    surface = dented(rng, surface, whole(rng, 0, 6))
    place = anywhere(rng, size, 0.3)
    if chance(rng, 0.4):  # corrugated, or ribbed
        surface = raised(surface, between(rng, 1.0, 3.0) * np.sin(place.x * between(rng, 6, 25)))
    surface = scratched(rng, surface, whole(rng, 1, 20), 0.4)
    surface = rusted(rng, surface, between(rng, -0.6, 0.5), between(rng, 0, 0.9) * place.x)
    if chance(rng, 0.4):
        surface = rusted(rng, surface, between(rng, -1.8, -1.0))
    return smudged(rng, surface, between(rng, 0.05, 0.25))


def flaking(rng: Rng, size: int) -> Surface:
    """Coats of paint that crack, curl and fall off metal, wood or plaster, one coat below the other."""
    kind = pick(rng, ("metal", "metal", "wood", "plaster"))
    if kind == "metal":
        under = metal(rng, size, GRAY, (0.2, 0.5))
        under = rusted(rng, under, between(rng, -1.2, 1.0)) if chance(rng, 0.7) else under
    else:
        under = piece(rng, size, WOODS if kind == "wood" else ("grain", "bricks"), (0.5, 0.9))
    frequency = log_between(rng, 1.0, 2.5)
    where = cloud(rng, size, frequency, between(rng, 1.5, 2.3)) + between(rng, 0, 0.6) * anywhere(rng, size).x
    bend = tuple(0.12 * cloud(rng, size, 6, 2.2) for _ in range(2))
    cells = isotropic_cells(rng, size, log_between(rng, 3, 8), 0.9, (bend[0], bend[1]))
    level = between(rng, -0.7, 0.7)
    for coat in range(whole(rng, 1, 2)):
        # Flakes break along the cracks: what falls is a cell rather than a blotch.
        edge = where + between(rng, 0.1, 0.9) * (ridges(cells.edge, 0.08) - 0.4) + 0.2 * cloud(rng, size, 7, 1.6)
        inside = -distance(softened(edge - level + 0.45 * coat, 0.6))
        skin = paint(rng, size, roughness=(0.12, 0.55))
        skin = raised(skin, between(rng, 0.2, 0.9) * softened(under.height, 1.5))
        near = step(where, level - 1.8, level)
        crack = step(cells.edge, between(rng, 0.02, 0.07), 0.0) * near
        curl = between(rng, 0, 1.6) * np.exp(-np.clip(inside, 0, 30) / between(rng, 1.5, 4)) * near
        skin = tinted(raised(skin, curl - 0.8 * crack), 1 - 0.6 * crack)
        under = lay(under, skin, inside, between(rng, 0.5, 1.6), between(rng, 0.6, 1.5))
    return weathered(rng, under) if chance(rng, 0.6) else dirty(rng, under, between(rng, 0, 0.5))


def puddles(rng: Rng, size: int) -> Surface:
    """Uneven ground after rain: water in the low parts, wet rims, dry rises."""
    ground = piece(rng, size, GROUNDS)
    swell = cloud(rng, size, log_between(rng, 1.0, 2.5), between(rng, 2.4, 3.4))
    ground = ground._replace(height=np.clip(ground.height, -2.5, 2.5) * between(rng, 0.4, 1.0))
    ground = raised(ground, between(rng, 1.5, 5) * swell + 0.1 * cloud(rng, size, 15, 1.0))
    if chance(rng, 0.4):
        earth = plain(rng, size, _EARTHS, (0.8, 0.95), 0.4)
        silt = step(-scaled(softened(ground.height, 2)), between(rng, 0.0, 0.8), 1.5)
        ground = overlay(ground, earth._replace(height=softened(ground.height, 2) + 0.2 * earth.height), silt)
    if chance(rng, 0.3):
        place = anywhere(rng, size, 0.4)
        ground = raised(ground, -between(rng, 1.5, 4) * np.exp(-((place.x / between(rng, 0.15, 0.4)) ** 2)))
    return wet(rng, ground, between(rng, 0.2, 0.6))


def stains(rng: Rng, size: int) -> Surface:
    """Cloth, wood, stone, paper or lacquer that much was spilled on."""
    kind = pick(rng, ("cloth", "wood", "stone", "paper", "paint", "metal"))
    if kind == "paper":
        surface = plain(rng, size, "e8e0cc d9c9a8 c9b58a f2ede0", (0.7, 0.9), 0.15)
        for _ in range(whole(rng, 0, 3)):  # folds
            crease = np.abs(anywhere(rng, size, 0.8).x)
            surface = raised(surface, between(rng, -6, 6) * crease)
    elif kind == "metal":
        surface = metal(rng, size)
    elif kind == "paint":
        surface = paint(rng, size)
    else:
        surface = piece(rng, size, {"cloth": CLOTHS, "wood": WOODS, "stone": STONES}[kind])
    surface = stained(rng, surface, whole(rng, 2, 5))
    if chance(rng, 0.4):  # drips of paint, wax, or tar
        blot = cloud(rng, size, log_between(rng, 2, 5), between(rng, 2.2, 3.0)) - between(rng, 0.7, 1.4)
        inside = distance(blot)
        drop = raised(paint(rng, size, roughness=(0.1, 0.3)), 0.5 * softened(surface.height, 2))
        surface = lay(surface, drop, inside, between(rng, 0.8, 3.0), log_between(rng, 2, 8))
    return smudged(rng, surface, between(rng, 0.1, 0.5))


def tracks(rng: Rng, size: int) -> Surface:
    """Paths worn into floors, tyres over earth or asphalt, skid marks: bands across the patch."""
    place = anywhere(rng, size, 0.6)
    bend = place.x + between(rng, 0, 0.3) * np.sin(place.y * between(rng, 0.8, 2.5) + between(rng, 0, 6))
    half = between(rng, 0.2, 0.45)
    inside = (half - np.abs(bend) + 0.04 * cloud(rng, size, 5, 2.2)) * place.unit
    if chance(rng, 0.45):  # a tyre's profile, pressed in
        ground = plain(rng, size, _EARTHS + " d8dde0 e8ecee", (0.75, 0.95), between(rng, 0.3, 0.8))
        ground = overlay(ground, piece(rng, size, ("gravel", "cracks", "grain")), 0.5 * chance(rng, 0.5))
        lugs = grid(
            place._replace(x=bend, y=place.y + between(rng, -0.8, 0.8) * np.abs(bend)),
            half / 2,
            between(rng, 0.12, 0.3),
        )
        pressed = -between(rng, 1.5, 4.5) * step(inside, -1, 3) * (0.3 + 0.7 * step(lugs.inside * place.unit, 0, 2.5))
        rim = between(rng, 0.3, 1.5) * np.exp(-((inside / 4) ** 2))
        surface = tinted(raised(ground, pressed + rim), 1 - between(rng, 0.15, 0.6) * step(-pressed, 0.3, 2.0))
        packed = step(-pressed, 0.5, 2.5) * between(rng, 0.15, 0.5)
        surface = surface._replace(roughness=surface.roughness - packed)
        return wet(rng, surface, between(rng, 0.1, 0.3)) if chance(rng, 0.5) else surface
    ground = solid(rng, size) if chance(rng, 0.6) else piece(rng, size, GROUNDS + CLOTHS)
    share = step(inside + 4 * cloud(rng, size, 5, 2.4), -4, between(rng, 4, 14)) * between(rng, 0.6, 1.0)
    polish = pick(rng, (-1, -1, 1)) * between(rng, 0.15, 0.5)
    worn = tinted(ground, pick(rng, (between(rng, 0.4, 0.75), between(rng, 1.15, 1.6))))._replace(
        roughness=ground.roughness + polish
    )
    if chance(rng, 0.3):
        worn = scratched(rng, worn, whole(rng, 20, 60), 0.4)
    trough = step(half - np.abs(bend), -0.15, 0.2)
    flat = mix(worn.height, 0.35 * softened(worn.height, 1.0) - between(rng, 0.3, 2.0), trough)
    surface = overlay(ground, worn, share)._replace(height=flat)
    if chance(rng, 0.3):  # rubber of tyres
        skid = covers(outline(bend, half * 0.6) * place.unit) * step(cloud(rng, size, 8, 0.9), -1.5, 0.8)
        surface = tinted(surface, 1 - 0.8 * skid)
        surface = surface._replace(roughness=towards(surface.roughness, 0.5, skid))
    return weathered(rng, surface)


def scratches(rng: Rng, size: int) -> Surface:
    """Polished metal, lacquer, plastic or stone in use: scratches, dents, fingerprints, smears."""
    kind = pick(rng, ("metal", "metal", "paint", "stone", "wood"))
    if kind == "metal":
        surface = metal(rng, size, roughness=(0.1, 0.3))
    elif kind == "paint":
        surface = paint(rng, size, roughness=(0.1, 0.25))
    else:
        surface = polished(piece(rng, size, STONES if kind == "stone" else WOODS), between(rng, 0.1, 0.2), 0.9)
    surface = dented(rng, surface, whole(rng, 0, 5))
    if kind == "paint" and chance(rng, 0.5):  # down to the metal
        below = metal(rng, size, GRAY, (0.2, 0.4))
        gash = distance(np.abs(cloud(rng, size, 2, 2.6)) - between(rng, 0.04, 0.12))
        gash = np.where(cloud(rng, size, 2, 2.0) > 0.2, -gash, -9)
        surface = lay(surface, below, gash, -between(rng, 0.4, 1.2))
    surface = smudged(rng, surface, between(rng, 0.15, 0.5))
    for _ in range(whole(rng, 0, 4)):
        place = anywhere(rng, size, 0.9, 0, between(rng, 0.15, 0.3))
        whorl = np.hypot(place.x * 1.5, place.y) + 0.2 * place.x + 0.04 * cloud(rng, size, 5, 2.5)
        line = (0.5 + 0.5 * np.sin(whorl * between(rng, 18, 30))) * step(whorl, 1.0, 0.8)
        surface = surface._replace(roughness=surface.roughness + np.float32(between(rng, 0.1, 0.35)) * line)
    for _ in range(whole(rng, 1, 2)):
        surface = scratched(rng, surface, whole(rng, 15, 90), between(rng, 0.2, 0.6))
    return surface


def overgrown(rng: Rng, size: int) -> Surface:
    """One thing over another: plaster off bricks, moss, sand, snow or leaves on stone, tiles of wood under concrete."""
    kind = pick(rng, ("plaster", "plaster", "moss", "sand", "snow", "any"))
    under = piece(rng, size, {"plaster": ("bricks",), "any": GROUNDS + STONES}.get(kind, GROUNDS))
    where = (
        cloud(rng, size, log_between(rng, 1.2, 3), between(rng, 1.2, 2.2))
        + between(rng, 0, 0.8) * anywhere(rng, size).x
    )
    if kind in ("moss", "sand", "snow"):  # they settle in joints first
        low = -scaled(under.height - softened(under.height, 6))
        where = where + between(rng, 0.5, 1.4) * low
    inside = distance(softened(where + between(rng, -0.5, 0.6), 0.8))
    bed = softened(under.height, 3)
    if kind == "plaster":
        over = plain(rng, size, "e8dcc8 d9c7a8 c98f6b b7c3c9 9c8f80", (0.7, 0.95), 0.2)
        over = paint(rng, size, roughness=(0.15, 0.5)) if chance(rng, 0.4) else over
        surface = lay(under, raised(over, 0.3 * bed), inside, between(rng, 1.5, 4), between(rng, 1.0, 3))
    elif kind == "any":
        over = solid(rng, size) if chance(rng, 0.5) else piece(rng, size, GROUNDS)
        surface = lay(under, raised(over, bed), inside, between(rng, -3, 3), between(rng, 1.5, 8))
    else:
        over = piece(rng, size, ("foliage",), (0.7, 1.0)) if kind == "moss" else plain(
            rng, size, "eef2f5 e3e9ee" if kind == "snow" else "c9a878 b08d5c d9c49a", (0.6, 0.95), 0.3
        )  # fmt: skip
        dunes = between(rng, 0, 1.2) * cloud(rng, size, between(rng, 3, 8), 2.0)
        surface = lay(under, raised(over, bed + dunes), inside, between(rng, 0.8, 2.5), between(rng, 3, 10))
    return wet(rng, surface, between(rng, 0.1, 0.35)) if chance(rng, 0.35) else weathered(rng, surface)


def crumpled(rng: Rng, size: int) -> Surface:
    """Foil, paper or film that was crumpled and laid flat again: facets between sharp creases."""
    kind = pick(rng, ("foil", "foil", "paper", "film"))
    patch, relief = centred(size), np.zeros((size, size), np.float32)
    bend = [between(rng, 0.01, 0.05) * cloud(rng, size, 2, 3.0) for _ in range(2)]
    patch = patch._replace(x=patch.x + bend[0], y=patch.y + bend[1])
    folds, longest = whole(rng, 12, 50), between(rng, 0.3, 1.2)
    for _ in range(folds):  # a fold has two slopes and no step; where they cross there are facets
        fold = patch.moved(between(rng, -1, 1), between(rng, -1, 1), between(rng, 0, math.tau))
        half = between(rng, 0.2, longest)
        steep = between(rng, -1, 1) * step(np.abs(fold.y), half + 0.3, half)
        relief += np.abs(fold.x) * steep * fold.unit
    relief = softened(relief, 0.5) * np.float32(log_between(rng, 0.15, 0.8) / math.sqrt(folds))
    if kind == "foil":
        surface = metal(rng, size, ("aluminium", "gold", "copper", "silver"), (0.12, 0.35))
    elif kind == "film":
        surface = paint(rng, size, roughness=(0.1, 0.25))
    else:
        surface = plain(rng, size, "e8e0cc c9b58a f2ede0 b08d5c", (0.6, 0.9), 0.1)
        surface = tinted(surface, 1 - 0.25 * step(-scaled(relief - softened(relief, 2)), 0.5, 2.5))
    surface = raised(surface._replace(height=0.4 * surface.height), relief)
    surface = smudged(rng, surface, between(rng, 0.15, 0.5))
    return stained(rng, surface, 1) if chance(rng, 0.4) else surface
