"""Environments under the open sky: each function `<family>(rng)` draws a scene of its family.

Scenes are put together of what `scenery` and `sky` draw; how they are lit and rendered is not known here.
"""

from __future__ import annotations

from data_tools.random_streams import Rng
from data_tools.synthetic.environments.scene_geometry import EnvironmentScene
from data_tools.synthetic.environments.scenery import (
    NATURAL_GROUNDS,
    PAVED_GROUNDS,
    add_bushes,
    add_garden_walls,
    add_paths,
    add_street_houses,
    add_trees,
    draw_open_scene,
)
from data_tools.synthetic.environments.sky import day_sky, overcast_sky
from data_tools.synthetic.random_values import chance, integer_between


def meadow(rng: Rng) -> EnvironmentScene:
    """Draw open country with hills, woods or nothing at the horizon and a few trees."""
    scene = draw_open_scene(rng, day_sky(rng), NATURAL_GROUNDS, ("hills", "woods", "woods", "none"), (0.08, 0.45))
    add_paths(rng, scene, integer_between(rng, 0, 2))
    add_garden_walls(rng, scene, integer_between(rng, 0, 2))
    add_trees(rng, scene, integer_between(rng, 0, 6), (5, 30))
    add_bushes(rng, scene, integer_between(rng, 0, 4), (4, 15))
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
    sky = overcast_sky(rng) if chance(rng, 0.2) else day_sky(rng, clear_share=0.5)
    scene = draw_open_scene(rng, sky, PAVED_GROUNDS, ("town", "woods"), (0.05, 0.2))
    add_street_houses(rng, scene)
    return scene
