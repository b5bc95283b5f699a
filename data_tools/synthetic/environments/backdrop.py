"""The far distance: hills, woods and towns before the sky, and the ground that windows look down on.

All of it is a function of direction, since nothing in it is near enough to move with the eye.
"""

from __future__ import annotations

import math

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.environments.patterns import BLACK, hash_numbers, look_up_noise, vector
from data_tools.synthetic.environments.scene_geometry import Backdrop, Mask
from data_tools.synthetic.environments.sky import Sky
from data_tools.synthetic.random_values import Field, between, log_between, uniforms
from metapp.appearance.latlong import solid_angles, texel_directions

_GRID = (16, 32)  # directions over which the sky's light is summed: rows, columns
_PANES = 400.0  # columns of windows around the horizon
_COLOURS = {  # darkest and lightest albedo, linear RGB
    "hills": np.array([[0.1, 0.13, 0.07], [0.18, 0.16, 0.12]], np.float32),
    "woods": np.array([[0.03, 0.05, 0.015], [0.09, 0.12, 0.035]], np.float32),
}
_HAZE = {"hills": 0.35, "woods": 0.08, "town": 0.08}  # the largest share of the sky's colour in that of the distance


def sky_irradiance(sky: Sky) -> Field:
    """Return the irradiance [3] in klx of the sky, without its sun, on level ground."""
    height, width = _GRID
    rays = texel_directions(height, width)[:, : height // 2].flatten(1).numpy()
    angles = solid_angles(height, width)[: height // 2].expand(-1, width).flatten().numpy()
    result: Field = sky.radiance(rays) @ (rays[1] * angles)
    return result


def open_ground(sky: Sky, albedo: Field) -> Backdrop:
    """Return level ground of an albedo [3] up to the horizon, lit by sky and sun."""
    sunlight = sky.sunlight * max(float(sky.sun[1]), 0.0)
    ground_radiance = (albedo * (sky_irradiance(sky) + sunlight) * np.float32(1 / math.pi))[:, None]

    def radiance(rays: Field) -> Field:
        return np.where(rays[1] < 0, ground_radiance, sky.radiance(rays))

    return Backdrop(sky, radiance, lambda rays: (rays[1] >= 0).astype(np.float32))


def skyline(rng: Rng, sky: Sky, ground: Field, kind: str, height: float, window_radiance: Field = BLACK) -> Backdrop:
    """Draw open ground whose horizon is not level.

    Args:
        rng: random numbers for its shape and its colours.
        sky: the sky behind it.
        ground: albedo [3] of the ground before it.
        kind: "hills", "woods", or "town".
        height: sine of the elevation that it reaches, about.
        window_radiance: radiance [3] of the lit windows of a town.
    """
    level_ground, ambient, shift = open_ground(sky, ground), sky_irradiance(sky)[:, None], float(rng.random())
    haze = np.float32(between(rng, 0.0, _HAZE[kind]))
    horizon_radiance = sky.radiance(vector(-sky.sun[0], 0, -sky.sun[2])[:, None])
    colours = _COLOURS.get(kind, (0.1 + 0.4 * uniforms(rng, 2, 1)) * (0.8 + 0.4 * uniforms(rng, 2, 3)))
    houses, storey = round(log_between(rng, 14, 70)), np.float32(log_between(rng, 0.02, 0.05))

    def azimuth_share(rays: Field) -> Field:
        result: Field = np.arctan2(rays[2], rays[0]) * np.float32(0.5 / math.pi) + np.float32(0.5)
        return result

    def is_hidden(rays: Field) -> Mask:
        """Return which rays [3, N] the skyline hides from the sky, [N]."""
        angle = azimuth_share(rays)
        if kind == "town":
            result: Mask = height * (0.25 + 0.75 * hash_numbers(np.floor(angle * houses), shift)) > rays[1]
            return result
        coarse = look_up_noise("soft", angle, shift)
        if kind == "hills":
            result = height * (0.6 + 0.35 * coarse) > rays[1]
            return result
        height_above = height * (0.75 + 0.25 * coarse + 0.12 * look_up_noise("leaves", angle, shift)) - rays[1]
        leaves = look_up_noise("leaves", 3 * angle, rays[1] + np.float32(shift))
        result = (height_above > 0) & (leaves > 1.2 - height_above * np.float32(7 / height))
        return result

    def town_look(angle: Field, up: Field) -> tuple[Field, Mask]:
        """Return how light houses are, and which windows are lit, both [N]."""
        row, column = np.floor(up / storey), np.floor(angle * _PANES)
        pane = (np.abs(up / storey - row - 0.5) < 0.3) & (np.abs(angle * _PANES - column - 0.5) < 0.3)
        lightness = hash_numbers(np.floor(angle * houses), shift + 0.3) * np.where(pane, np.float32(0.1), np.float32(1))
        return lightness, pane & (hash_numbers(row * 1009 + column, shift) > 0.6)

    def radiance(rays: Field) -> Field:
        result = level_ground.radiance(rays)
        skyline_rays = np.flatnonzero((rays[1] >= 0) & is_hidden(rays))
        angle, up = azimuth_share(rays[:, skyline_rays]), rays[1, skyline_rays]
        if kind == "town":
            lightness, lit_windows = town_look(angle, up)
        else:
            texture = look_up_noise("leaves" if kind == "woods" else "rough", 3 * angle, 3 * up)
            lightness, lit_windows = np.clip(0.5 + 0.35 * texture, 0, 1), np.zeros(up.shape, np.bool_)
        sun_facing = np.maximum(-(sky.sun[[0, 2]] @ rays[:, skyline_rays][[0, 2]]), 0) + np.float32(0.05)
        light = sky.sunlight[:, None] * sun_facing + np.float32(0.5) * ambient
        albedo = colours[0][:, None] + (colours[1] - colours[0])[:, None] * lightness
        surface_radiance = albedo * light * np.float32(1 / math.pi) + window_radiance[:, None] * lit_windows
        result[:, skyline_rays] = surface_radiance + (horizon_radiance - surface_radiance) * haze
        return result

    return Backdrop(sky, radiance, lambda rays: level_ground.clearness(rays) * ~is_hidden(rays))
