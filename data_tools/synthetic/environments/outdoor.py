"""Environments under the open sky: `<family>(rng)` draws one."""

from __future__ import annotations

import math

import numpy as np

from data_tools.draws import Rng
from data_tools.synthetic.draws import between, chance, log_between, whole
from data_tools.synthetic.environments.patterns import BLACK, glowing, vector
from data_tools.synthetic.environments.scene import Box, Finish, Lamp, Scene
from data_tools.synthetic.environments.scenery import (
    BUILT,
    NATURAL,
    bushes,
    canyon,
    open_scene,
    paths,
    porch,
    ring,
    trees,
    vehicles,
    walls,
    yard,
)
from data_tools.synthetic.environments.sky import Sky, day_sky, night_sky, overcast


def meadow(rng: Rng) -> Scene:
    """Open country with hills, woods or nothing at the horizon and a few trees."""
    scene = open_scene(rng, day_sky(rng), NATURAL, ("hills", "woods", "woods", "none"), (0.08, 0.45))
    paths(rng, scene, whole(rng, 0, 2))
    walls(rng, scene, whole(rng, 0, 2))
    trees(rng, scene, whole(rng, 0, 6), (5, 30))
    bushes(rng, scene, whole(rng, 0, 4), (4, 15))
    return scene


def shore(rng: Rng) -> Scene:
    """Calm water under a sky that it mirrors, often with a beach on one side."""
    scene = open_scene(rng, day_sky(rng, clear_share=0.2), NATURAL, ("hills", "none", "none", "town"), (0.02, 0.12))
    land, bottom = scene.sides[2], float(scene.low[1])
    scene.sides[2] = Finish(vector(0.01, 0.025, 0.03) * np.float32(log_between(rng, 0.6, 3)), gloss=0.02)
    if chance(rng, 0.6):
        edge = between(rng, 0.5, 6)
        scene.boxes.append(Box(vector(-400, bottom - 0.05, -400), vector(edge, bottom + 0.1, 400), land))
        trees(rng, scene, whole(rng, 0, 3), (5, 20))
        scene.crowns = [crown for crown in scene.crowns if crown.centre[0] < edge]
        scene.boxes = scene.boxes[:1] + [box for box in scene.boxes[1:] if box.low[0] < edge]
    return scene


def dull(rng: Rng) -> Scene:
    """Under closed clouds or in fog."""
    scene = open_scene(rng, overcast(rng), NATURAL + BUILT, ("hills", "woods", "town", "none"), (0.05, 0.4))
    paths(rng, scene, whole(rng, 0, 2))
    walls(rng, scene, whole(rng, 0, 2))
    trees(rng, scene, whole(rng, 0, 4), (4, 25))
    bushes(rng, scene, whole(rng, 0, 3), (4, 15))
    vehicles(rng, scene, whole(rng, 0, 4), (4, 15))
    return scene


def dusk(rng: Rng) -> Scene:
    """The sun at the horizon, just above or just below it."""
    sky = day_sky(rng, (-0.06, 0.16), clear_share=0.5)
    scene = open_scene(rng, sky, NATURAL + BUILT, ("hills", "woods", "town", "none"), (0.06, 0.4))
    paths(rng, scene, whole(rng, 0, 2))
    walls(rng, scene, whole(rng, 0, 2))
    trees(rng, scene, whole(rng, 0, 5), (5, 25))
    return scene


def forest(rng: Rng) -> Scene:
    """Trees all around, the sky in between."""
    sky = day_sky(rng, (0.3, 1.25), 0.7) if chance(rng, 0.8) else overcast(rng)
    scene = open_scene(rng, sky, ("dirt", "dirt", "dirt", "grass", "meadow", "snow"), ("woods",), (0.4, 1.0))
    trees(rng, scene, whole(rng, 9, 17), (4, 11), (2.5, 5.5))
    bushes(rng, scene, whole(rng, 0, 5), (2.5, 8))
    scene.closed = 0.6
    return scene


def street(rng: Rng) -> Scene:
    """Houses in a row on both sides."""
    scene = open_scene(rng, _town_sky(rng), BUILT, ("town", "woods"), (0.05, 0.2))
    canyon(rng, scene, BLACK)
    return scene


def square(rng: Rng) -> Scene:
    """Houses at some distance all around."""
    scene = open_scene(rng, _town_sky(rng), (*BUILT, "grass"), ("town", "woods"), (0.05, 0.25))
    ring(rng, scene, log_between(rng, 12, 50), BLACK)
    return scene


def courtyard(rng: Rng) -> Scene:
    """Walls close by, and often a roof over the eye."""
    scene = open_scene(rng, _town_sky(rng), (*BUILT, "dirt", "grass"), ("woods", "town"), (0.1, 0.3))
    yard(rng, scene)
    if chance(rng, 0.6):
        porch(rng, scene)
    trees(rng, scene, whole(rng, 0, 2), (3, 9))
    vehicles(rng, scene, whole(rng, 0, 4), (2, 7))
    return scene


def night(rng: Rng) -> Scene:
    """A street or square by the light of its lamps and windows."""
    lit = glowing(log_between(rng, 2500, 5000)) * np.float32(log_between(rng, 0.002, 0.03))
    scene = open_scene(rng, night_sky(rng), BUILT, ("town",), (0.05, 0.3), lit)
    if chance(rng, 0.6):
        canyon(rng, scene, lit)
    else:
        ring(rng, scene, log_between(rng, 8, 30), lit)
    away, radius, flux = between(rng, 2.5, 7), log_between(rng, 0.12, 0.35), log_between(rng, 3, 20)
    radiance = glowing(log_between(rng, 2000, 5500)) * np.float32(flux / (2 * math.pi * radius) ** 2)
    for place in range(-3, 4):
        for sign in (-1, 1) if chance(rng, 0.7) else (1,):
            centre = vector(sign * away, between(rng, 2, 4.5), place * between(rng, 9, 14) + between(rng, -2, 2))
            scene.lamps.append(Lamp(centre, vector(radius, 0, 0), vector(0, radius, 0), radiance, "ball"))
    return scene


def _town_sky(rng: Rng) -> Sky:
    return overcast(rng) if chance(rng, 0.2) else day_sky(rng, clear_share=0.5)
