"""Environments under a roof: `<family>(rng)` draws one."""

from __future__ import annotations

import numpy as np

from data_tools.draws import Rng
from data_tools.synthetic.draws import between, chance, log_between, pick, whole
from data_tools.synthetic.environments.backdrop import open_ground, skyline
from data_tools.synthetic.environments.fittings import (
    WALLS,
    against,
    beams,
    bulb,
    ceiling_lamps,
    doors,
    downlights,
    furniture,
    room,
    skylights,
    softbox,
    tone,
    windows,
)
from data_tools.synthetic.environments.patterns import BLACK, glowing, vector
from data_tools.synthetic.environments.scene import Backdrop, Finish, Scene
from data_tools.synthetic.environments.sky import Sky, black_sky, day_sky, night_sky, overcast


def apartment(rng: Rng) -> Scene:
    """A room by day: light comes through its windows."""
    scene = room(rng, ((3, 8), (3, 8), (2.3, 3.2)), _outside(rng, _daytime(rng)))
    for _ in range(whole(rng, 1, 2)):
        windows(rng, scene, pick(rng, WALLS), whole(rng, 1, 3), (0.0, 1.0), (0.25, 0.85))
    if chance(rng, 0.4):
        downlights(rng, scene, whole(rng, 1, 3), whole(rng, 1, 3), (0.05, 0.25), (0.3, 2.0), _kelvin(rng))
    doors(rng, scene, whole(rng, 1, 6))
    furniture(rng, scene, whole(rng, 3, 10), (0.4, 1.4))
    return scene


def evening(rng: Rng) -> Scene:
    """A room by the light of its lamps, dark or dim outside."""
    sky = night_sky(rng) if chance(rng, 0.6) else day_sky(rng, (-0.06, 0.0))
    scene = room(rng, ((3, 8), (3, 8), (2.3, 3.2)), _outside(rng, sky))
    windows(rng, scene, pick(rng, WALLS), whole(rng, 1, 3), (0.0, 1.0), (0.25, 0.8))
    kelvin = log_between(rng, 2200, 3600)
    if chance(rng, 0.6):
        downlights(rng, scene, whole(rng, 1, 4), whole(rng, 1, 4), (0.04, 0.2), (0.3, 1.2), kelvin)
    for _ in range(whole(rng, 1, 4)):
        bulb(rng, scene, (0.4, 1.5), (0.06, 0.25), kelvin)
    doors(rng, scene, whole(rng, 1, 6))
    furniture(rng, scene, whole(rng, 3, 10), (0.4, 1.4))
    return scene


def office(rng: Rng) -> Scene:
    """A room or corridor with luminous panels or tubes, often a band of windows."""
    long = chance(rng, 0.3)
    scene = room(rng, ((2, 4), (12, 30), (2.4, 3.4)) if long else ((5, 15), (5, 15), (2.4, 3.4)),
                 _outside(rng, _daytime(rng)))  # fmt: skip
    halves = pick(rng, ((0.3, 0.3), (0.15, 0.6), (0.6, 0.15), (0.3, 0.6), (0.03, 0.7)))
    grid = (whole(rng, 1, 2) if long else whole(rng, 2, 5), whole(rng, 2, 6))
    ceiling_lamps(rng, scene, grid, halves, (2.0, 6.0), _kelvin(rng))
    if chance(rng, 0.7):
        windows(rng, scene, pick(rng, WALLS), whole(rng, 1, 4), (0.3, 1.0), (0.5, 0.97))
    doors(rng, scene, whole(rng, 1, 6))
    furniture(rng, scene, whole(rng, 0, 3) if long else whole(rng, 4, 12), (0.6, 1.4))
    return scene


def warehouse(rng: Rng) -> Scene:
    """A hall with lamps high above, shelves, skylights or an open gate; or an underground garage."""
    low = chance(rng, 0.25)
    height = (2.5, 3.2) if low else (5.0, 11.0)
    scene = room(rng, ((12, 40), (15, 60), height), _outside(rng, _daytime(rng)), rough=True)
    halves, shape = pick(rng, ((0.25, 0.25), (0.08, 0.7), (0.7, 0.08), (0.3, 0.8))), pick(rng, ("panel", "disc"))
    if low or chance(rng, 0.85):
        flux = (2.0, 6.0) if low else (8.0, 30.0)
        ceiling_lamps(rng, scene, (whole(rng, 2, 4), whole(rng, 3, 6)), halves, flux, _kelvin(rng), shape)
    if not low and (chance(rng, 0.4) or not scene.lamps):
        skylights(rng, scene)
    if chance(rng, 0.5):
        windows(rng, scene, pick(rng, WALLS), whole(rng, 1, 3), (0.0, 0.3), (0.15, 0.6))
    beams(rng, scene)
    furniture(rng, scene, whole(rng, 4, 14), (0.6, 5.0), colourful=True)
    return scene


def workshop(rng: Rng) -> Scene:
    """A garage or hall with a large open door, high windows, machines, and lamps here and there."""
    scene = room(rng, ((6, 18), (6, 25), (3, 7)), _outside(rng, _daytime(rng)), rough=True)
    if chance(rng, 0.7):
        windows(rng, scene, pick(rng, WALLS), 1, (0.0, 0.1), (0.3, 0.7))
    windows(rng, scene, pick(rng, WALLS), whole(rng, 2, 5), (1.5, 2.5), (0.4, 0.9))
    if chance(rng, 0.7):
        halves = pick(rng, ((0.05, 0.7), (0.7, 0.05), (0.2, 0.2)))
        ceiling_lamps(rng, scene, (whole(rng, 1, 3), whole(rng, 2, 4)), halves, (4, 15), _kelvin(rng))
    if chance(rng, 0.4):
        beams(rng, scene)
    furniture(rng, scene, whole(rng, 10, 22), (0.7, 3.0), colourful=True)
    return scene


def lobby(rng: Rng) -> Scene:
    """A large room with a glass front, downlights, and bright furniture."""
    scene = room(rng, ((8, 25), (8, 30), (3, 8)), _outside(rng, _daytime(rng)))
    for _ in range(whole(rng, 1, 2)):
        windows(rng, scene, pick(rng, WALLS), whole(rng, 3, 8), (0.0, 0.4), (0.8, 0.98))
    if chance(rng, 0.3):
        skylights(rng, scene)
    kelvin = _kelvin(rng)
    if chance(rng, 0.8):
        downlights(rng, scene, whole(rng, 2, 5), whole(rng, 2, 6), (0.06, 0.3), (1, 5), kelvin)
    if chance(rng, 0.4):
        halves = pick(rng, ((0.06, 0.9), (0.9, 0.06)))
        ceiling_lamps(rng, scene, (whole(rng, 1, 2), whole(rng, 2, 5)), halves, (4, 12), kelvin)
    doors(rng, scene, whole(rng, 0, 5))
    furniture(rng, scene, whole(rng, 3, 12), (0.4, 1.3), colourful=True)
    return scene


def studio(rng: Rng) -> Scene:
    """A dark or white studio with soft boxes, strips, bare lamps, and a backdrop."""
    scene = room(rng, ((5, 14), (5, 14), (3, 6)), open_ground(black_sky(), BLACK))
    level = log_between(rng, 0.01, 0.12) if chance(rng, 0.7) else between(rng, 0.4, 0.8)
    wall = Finish(tone(rng, 0.1) * np.float32(level))
    floor = Finish(tone(rng, 0.1) * np.float32(log_between(rng, 0.03, 0.6)), gloss=pick(rng, (0.0, 0.02, 0.05)))
    scene.sides = [wall, wall, floor, wall, wall, wall]
    kelvin = log_between(rng, 3200, 7500)
    for _ in range(whole(rng, 1, 5)):
        softbox(rng, scene, kelvin)
    for _ in range(whole(rng, 0, 4) if chance(rng, 0.6) else 0):
        bulb(rng, scene, (0.5, 5), (0.04, 0.15), kelvin)
    if chance(rng, 0.6):
        sheet = Finish(tone(rng, 0.3 if chance(rng, 0.3) else 0.03) * np.float32(between(rng, 0.2, 0.75)))
        size = (between(rng, 2, 5), between(rng, 2, 3.5), 0.1)
        against(scene, pick(rng, WALLS), between(rng, 0.2, 0.8), float(scene.low[1]), size, sheet)
    furniture(rng, scene, whole(rng, 0, 6), (0.5, 2.2))
    return scene


def _kelvin(rng: Rng) -> float:
    return log_between(rng, 2600, 6000)


def _daytime(rng: Rng) -> Sky:
    return overcast(rng) if chance(rng, 0.35) else day_sky(rng, (0.1, 1.1))


def _outside(rng: Rng, sky: Sky) -> Backdrop:
    """The view through windows."""
    ground = vector(*pick(rng, ((0.07, 0.1, 0.04), (0.15, 0.15, 0.15), (0.3, 0.28, 0.25))))
    ground = ground * tone(rng, 0.1) * np.float32(between(rng, 0.6, 1.4))
    kind = pick(rng, ("town", "town", "woods", "none"))
    lit = glowing(3000) * np.float32(0.01) if sky.sun[1] < 0 else BLACK
    return (
        open_ground(sky, ground)
        if kind == "none"
        else skyline(rng, sky, ground, kind, log_between(rng, 0.08, 0.8), lit)
    )
