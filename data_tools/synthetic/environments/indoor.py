"""Environments under a roof: each function `<family>(rng)` draws a scene of its family.

Scenes are put together of what `fittings`, `sky` and `backdrop` draw; how they are lit and rendered is not known here.
"""

from __future__ import annotations

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.environments.backdrop import open_ground, skyline
from data_tools.synthetic.environments.fittings import (
    WALL_SIDES,
    add_beams,
    add_box_at_wall,
    add_bulb,
    add_ceiling_lamps,
    add_doors,
    add_downlights,
    add_furniture,
    add_skylights,
    add_softbox,
    add_windows,
    draw_near_white,
    draw_room,
)
from data_tools.synthetic.environments.patterns import BLACK, black_body_rgb, vector
from data_tools.synthetic.environments.scene_geometry import Backdrop, EnvironmentScene, Finish
from data_tools.synthetic.environments.sky import Sky, black_sky, day_sky, night_sky, overcast_sky
from data_tools.synthetic.random_values import between, chance, integer_between, log_between, pick


def apartment(rng: Rng) -> EnvironmentScene:
    """Draw a room by day: light comes through its windows."""
    scene = draw_room(rng, ((3, 8), (3, 8), (2.3, 3.2)), _draw_window_view(rng, _draw_day_sky(rng)))
    for _ in range(integer_between(rng, 1, 2)):
        add_windows(rng, scene, pick(rng, WALL_SIDES), integer_between(rng, 1, 3), (0.0, 1.0), (0.25, 0.85))
    if chance(rng, 0.4):
        add_downlights(
            rng,
            scene,
            integer_between(rng, 1, 3),
            integer_between(rng, 1, 3),
            (0.05, 0.25),
            (0.3, 2.0),
            _draw_kelvin(rng),
        )
    add_doors(rng, scene, integer_between(rng, 1, 6))
    add_furniture(rng, scene, integer_between(rng, 3, 10), (0.4, 1.4))
    return scene


def evening(rng: Rng) -> EnvironmentScene:
    """Draw a room by the light of its lamps, dark or dim outside."""
    sky = night_sky(rng) if chance(rng, 0.6) else day_sky(rng, (-0.06, 0.0))
    scene = draw_room(rng, ((3, 8), (3, 8), (2.3, 3.2)), _draw_window_view(rng, sky))
    add_windows(rng, scene, pick(rng, WALL_SIDES), integer_between(rng, 1, 3), (0.0, 1.0), (0.25, 0.8))
    kelvin = log_between(rng, 2200, 3600)
    if chance(rng, 0.6):
        add_downlights(
            rng, scene, integer_between(rng, 1, 4), integer_between(rng, 1, 4), (0.04, 0.2), (0.3, 1.2), kelvin
        )
    for _ in range(integer_between(rng, 1, 4)):
        add_bulb(rng, scene, (0.4, 1.5), (0.06, 0.25), kelvin)
    add_doors(rng, scene, integer_between(rng, 1, 6))
    add_furniture(rng, scene, integer_between(rng, 3, 10), (0.4, 1.4))
    return scene


def office(rng: Rng) -> EnvironmentScene:
    """Draw a room or corridor with luminous panels or tubes, often a band of windows."""
    is_corridor = chance(rng, 0.3)
    sizes = ((2, 4), (12, 30), (2.4, 3.4)) if is_corridor else ((5, 15), (5, 15), (2.4, 3.4))
    scene = draw_room(rng, sizes, _draw_window_view(rng, _draw_day_sky(rng)))
    halves = pick(rng, ((0.3, 0.3), (0.15, 0.6), (0.6, 0.15), (0.3, 0.6), (0.03, 0.7)))
    grid = (integer_between(rng, 1, 2) if is_corridor else integer_between(rng, 2, 5), integer_between(rng, 2, 6))
    add_ceiling_lamps(rng, scene, grid, halves, (2.0, 6.0), _draw_kelvin(rng))
    if chance(rng, 0.7):
        add_windows(rng, scene, pick(rng, WALL_SIDES), integer_between(rng, 1, 4), (0.3, 1.0), (0.5, 0.97))
    add_doors(rng, scene, integer_between(rng, 1, 6))
    add_furniture(rng, scene, integer_between(rng, 0, 3) if is_corridor else integer_between(rng, 4, 12), (0.6, 1.4))
    return scene


def warehouse(rng: Rng) -> EnvironmentScene:
    """Draw a hall with lamps high above, shelves, skylights or an open gate; or an underground garage."""
    is_garage = chance(rng, 0.25)
    height = (2.5, 3.2) if is_garage else (5.0, 11.0)
    scene = draw_room(rng, ((12, 40), (15, 60), height), _draw_window_view(rng, _draw_day_sky(rng)), is_hall=True)
    halves, shape = pick(rng, ((0.25, 0.25), (0.08, 0.7), (0.7, 0.08), (0.3, 0.8))), pick(rng, ("panel", "disc"))
    if is_garage or chance(rng, 0.85):
        flux = (2.0, 6.0) if is_garage else (8.0, 30.0)
        add_ceiling_lamps(
            rng, scene, (integer_between(rng, 2, 4), integer_between(rng, 3, 6)), halves, flux, _draw_kelvin(rng), shape
        )
    if not is_garage and (chance(rng, 0.4) or not scene.lamps):
        add_skylights(rng, scene)
    if chance(rng, 0.5):
        add_windows(rng, scene, pick(rng, WALL_SIDES), integer_between(rng, 1, 3), (0.0, 0.3), (0.15, 0.6))
    add_beams(rng, scene)
    add_furniture(rng, scene, integer_between(rng, 4, 14), (0.6, 5.0), colourful=True)
    return scene


def workshop(rng: Rng) -> EnvironmentScene:
    """Draw a garage or hall with a large open door, high windows, machines, and lamps here and there."""
    scene = draw_room(rng, ((6, 18), (6, 25), (3, 7)), _draw_window_view(rng, _draw_day_sky(rng)), is_hall=True)
    if chance(rng, 0.7):
        add_windows(rng, scene, pick(rng, WALL_SIDES), 1, (0.0, 0.1), (0.3, 0.7))
    add_windows(rng, scene, pick(rng, WALL_SIDES), integer_between(rng, 2, 5), (1.5, 2.5), (0.4, 0.9))
    if chance(rng, 0.7):
        halves = pick(rng, ((0.05, 0.7), (0.7, 0.05), (0.2, 0.2)))
        add_ceiling_lamps(
            rng, scene, (integer_between(rng, 1, 3), integer_between(rng, 2, 4)), halves, (4, 15), _draw_kelvin(rng)
        )
    if chance(rng, 0.4):
        add_beams(rng, scene)
    add_furniture(rng, scene, integer_between(rng, 10, 22), (0.7, 3.0), colourful=True)
    return scene


def lobby(rng: Rng) -> EnvironmentScene:
    """Draw a large room with a glass front, downlights, and bright furniture."""
    scene = draw_room(rng, ((8, 25), (8, 30), (3, 8)), _draw_window_view(rng, _draw_day_sky(rng)))
    for _ in range(integer_between(rng, 1, 2)):
        add_windows(rng, scene, pick(rng, WALL_SIDES), integer_between(rng, 3, 8), (0.0, 0.4), (0.8, 0.98))
    if chance(rng, 0.3):
        add_skylights(rng, scene)
    kelvin = _draw_kelvin(rng)
    if chance(rng, 0.8):
        add_downlights(rng, scene, integer_between(rng, 2, 5), integer_between(rng, 2, 6), (0.06, 0.3), (1, 5), kelvin)
    if chance(rng, 0.4):
        halves = pick(rng, ((0.06, 0.9), (0.9, 0.06)))
        add_ceiling_lamps(rng, scene, (integer_between(rng, 1, 2), integer_between(rng, 2, 5)), halves, (4, 12), kelvin)
    add_doors(rng, scene, integer_between(rng, 0, 5))
    add_furniture(rng, scene, integer_between(rng, 3, 12), (0.4, 1.3), colourful=True)
    return scene


def studio(rng: Rng) -> EnvironmentScene:
    """Draw a dark or white studio with soft boxes, strips, bare lamps, and a backdrop."""
    scene = draw_room(rng, ((5, 14), (5, 14), (3, 6)), open_ground(black_sky(), BLACK))
    level = log_between(rng, 0.01, 0.12) if chance(rng, 0.7) else between(rng, 0.4, 0.8)
    wall = Finish(draw_near_white(rng, 0.1) * np.float32(level))
    floor = Finish(
        draw_near_white(rng, 0.1) * np.float32(log_between(rng, 0.03, 0.6)), gloss=pick(rng, (0.0, 0.02, 0.05))
    )
    scene.sides = [wall, wall, floor, wall, wall, wall]
    kelvin = log_between(rng, 3200, 7500)
    for _ in range(integer_between(rng, 1, 5)):
        add_softbox(rng, scene, kelvin)
    for _ in range(integer_between(rng, 0, 4) if chance(rng, 0.6) else 0):
        add_bulb(rng, scene, (0.5, 5), (0.04, 0.15), kelvin)
    if chance(rng, 0.6):
        sheet = Finish(draw_near_white(rng, 0.3 if chance(rng, 0.3) else 0.03) * np.float32(between(rng, 0.2, 0.75)))
        size = (between(rng, 2, 5), between(rng, 2, 3.5), 0.1)
        add_box_at_wall(scene, pick(rng, WALL_SIDES), between(rng, 0.2, 0.8), float(scene.low[1]), size, sheet)
    add_furniture(rng, scene, integer_between(rng, 0, 6), (0.5, 2.2))
    return scene


def _draw_kelvin(rng: Rng) -> float:
    """Draw a colour temperature of lamps, K."""
    return log_between(rng, 2600, 6000)


def _draw_day_sky(rng: Rng) -> Sky:
    """Draw a sky by day: overcast in 35 % of draws, else clear or with broken clouds."""
    return overcast_sky(rng) if chance(rng, 0.35) else day_sky(rng, (0.1, 1.1))


def _draw_window_view(rng: Rng, sky: Sky) -> Backdrop:
    """Draw the view through windows; a town has lit ones where the sun is below the horizon."""
    ground = vector(*pick(rng, ((0.07, 0.1, 0.04), (0.15, 0.15, 0.15), (0.3, 0.28, 0.25))))
    ground = ground * draw_near_white(rng, 0.1) * np.float32(between(rng, 0.6, 1.4))
    kind = pick(rng, ("town", "town", "woods", "none"))
    if kind == "none":
        return open_ground(sky, ground)
    window_radiance = black_body_rgb(3000) * np.float32(0.01) if sky.sun[1] < 0 else BLACK
    return skyline(rng, sky, ground, kind, log_between(rng, 0.08, 0.8), window_radiance)
