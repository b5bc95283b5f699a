"""Environments under the open sky: each function `<family>(rng)` draws a scene of its family.

Scenes are put together of what `scenery` and `sky` draw; how they are lit and rendered is not known here.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.environments.patterns import black_body_rgb, vector
from data_tools.synthetic.environments.scene_geometry import Box, EnvironmentScene, Finish, Lamp
from data_tools.synthetic.environments.scenery import (
    NATURAL_GROUNDS,
    PAVED_GROUNDS,
    add_bushes,
    add_courtyard_walls,
    add_garden_walls,
    add_paths,
    add_porch,
    add_street_houses,
    add_surrounding_houses,
    add_trees,
    add_vehicles,
    draw_open_scene,
)
from data_tools.synthetic.environments.sky import Sky, day_sky, night_sky, overcast_sky
from data_tools.synthetic.random_values import between, chance, integer_between, log_between


def meadow(rng: Rng) -> EnvironmentScene:
    """Draw open country with hills, woods or nothing at the horizon and a few trees."""
    scene = draw_open_scene(rng, day_sky(rng), NATURAL_GROUNDS, ("hills", "woods", "woods", "none"), (0.08, 0.45))
    add_paths(rng, scene, integer_between(rng, 0, 2))
    add_garden_walls(rng, scene, integer_between(rng, 0, 2))
    add_trees(rng, scene, integer_between(rng, 0, 6), (5, 30))
    add_bushes(rng, scene, integer_between(rng, 0, 4), (4, 15))
    return scene


def shore(rng: Rng) -> EnvironmentScene:
    """Draw calm water under a sky that it mirrors, often with a beach on one side."""
    scene = draw_open_scene(
        rng, day_sky(rng, clear_share=0.2), NATURAL_GROUNDS, ("hills", "none", "none", "town"), (0.02, 0.12)
    )
    land, bottom = scene.sides[2], float(scene.low[1])
    scene.sides[2] = Finish(vector(0.01, 0.025, 0.03) * np.float32(log_between(rng, 0.6, 3)), gloss=0.02)
    if chance(rng, 0.6):
        edge = between(rng, 0.5, 6)
        scene.boxes.append(Box(vector(-400, bottom - 0.05, -400), vector(edge, bottom + 0.1, 400), land))
        add_trees(rng, scene, integer_between(rng, 0, 3), (5, 20))
        scene.crowns = [crown for crown in scene.crowns if crown.centre[0] < edge]
        scene.boxes = scene.boxes[:1] + [box for box in scene.boxes[1:] if box.low[0] < edge]
    return scene


def dull(rng: Rng) -> EnvironmentScene:
    """Draw open country or a place in a town, under closed clouds or in fog."""
    scene = draw_open_scene(
        rng, overcast_sky(rng), NATURAL_GROUNDS + PAVED_GROUNDS, ("hills", "woods", "town", "none"), (0.05, 0.4)
    )
    add_paths(rng, scene, integer_between(rng, 0, 2))
    add_garden_walls(rng, scene, integer_between(rng, 0, 2))
    add_trees(rng, scene, integer_between(rng, 0, 4), (4, 25))
    add_bushes(rng, scene, integer_between(rng, 0, 3), (4, 15))
    add_vehicles(rng, scene, integer_between(rng, 0, 4), (4, 15))
    return scene


def dusk(rng: Rng) -> EnvironmentScene:
    """Draw a scene with the sun at the horizon, just above or just below it."""
    sky = day_sky(rng, (-0.06, 0.16), clear_share=0.5)
    scene = draw_open_scene(rng, sky, NATURAL_GROUNDS + PAVED_GROUNDS, ("hills", "woods", "town", "none"), (0.06, 0.4))
    add_paths(rng, scene, integer_between(rng, 0, 2))
    add_garden_walls(rng, scene, integer_between(rng, 0, 2))
    add_trees(rng, scene, integer_between(rng, 0, 5), (5, 25))
    return scene


def forest(rng: Rng) -> EnvironmentScene:
    """Draw trees all around, the sky in between."""
    sky = day_sky(rng, (0.3, 1.25), 0.7) if chance(rng, 0.8) else overcast_sky(rng)
    scene = draw_open_scene(rng, sky, ("dirt", "dirt", "dirt", "grass", "meadow", "snow"), ("woods",), (0.4, 1.0))
    add_trees(rng, scene, integer_between(rng, 9, 17), (4, 11), (2.5, 5.5))
    add_bushes(rng, scene, integer_between(rng, 0, 5), (2.5, 8))
    scene.kept_light_share = 0.6
    return scene


def street(rng: Rng) -> EnvironmentScene:
    """Draw houses in a row on both sides."""
    scene = draw_open_scene(rng, _draw_town_sky(rng), PAVED_GROUNDS, ("town", "woods"), (0.05, 0.2))
    add_street_houses(rng, scene)
    return scene


def square(rng: Rng) -> EnvironmentScene:
    """Draw houses at some distance all around."""
    scene = draw_open_scene(rng, _draw_town_sky(rng), (*PAVED_GROUNDS, "grass"), ("town", "woods"), (0.05, 0.25))
    add_surrounding_houses(rng, scene, log_between(rng, 12, 50))
    return scene


def courtyard(rng: Rng) -> EnvironmentScene:
    """Draw walls close by, and often a roof over the eye."""
    scene = draw_open_scene(rng, _draw_town_sky(rng), (*PAVED_GROUNDS, "dirt", "grass"), ("woods", "town"), (0.1, 0.3))
    add_courtyard_walls(rng, scene)
    if chance(rng, 0.6):
        add_porch(rng, scene)
    add_trees(rng, scene, integer_between(rng, 0, 2), (3, 9))
    add_vehicles(rng, scene, integer_between(rng, 0, 4), (2, 7))
    return scene


def night(rng: Rng) -> EnvironmentScene:
    """Draw a street or square by the light of its lamps and windows."""
    window_radiance = black_body_rgb(log_between(rng, 2500, 5000)) * np.float32(log_between(rng, 0.002, 0.03))
    scene = draw_open_scene(rng, night_sky(rng), PAVED_GROUNDS, ("town",), (0.05, 0.3), window_radiance)
    if chance(rng, 0.6):
        add_street_houses(rng, scene, window_radiance)
    else:
        add_surrounding_houses(rng, scene, log_between(rng, 8, 30), window_radiance)
    distance, radius, flux = between(rng, 2.5, 7), log_between(rng, 0.12, 0.35), log_between(rng, 3, 20)
    radiance = black_body_rgb(log_between(rng, 2000, 5500)) * np.float32(flux / (2 * math.pi * radius) ** 2)
    for number in range(-3, 4):
        for sign in (-1, 1) if chance(rng, 0.7) else (1,):
            centre = vector(sign * distance, between(rng, 2, 4.5), number * between(rng, 9, 14) + between(rng, -2, 2))
            scene.lamps.append(Lamp(centre, vector(radius, 0, 0), vector(0, radius, 0), radiance, "ball"))
    return scene


def _draw_town_sky(rng: Rng) -> Sky:
    """Draw a sky by day: overcast in one of five draws, else clear or with broken clouds."""
    return overcast_sky(rng) if chance(rng, 0.2) else day_sky(rng, clear_share=0.5)
