"""The light in a scene and the radiance that reaches the eye: from a scene to an environment map.

Light goes straight from the sun, the sky, windows and lamps to visible surfaces, with shadows. From there it goes once
more to all of these, without shadows. Light that is scattered more often is equal everywhere.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import torch

from data_tools.readers.environment_maps import MAP_HEIGHT_PX, MAP_WIDTH_PX
from data_tools.synthetic.environments.emitters import Emitters, list_emitters
from data_tools.synthetic.environments.patterns import look_up_noise
from data_tools.synthetic.environments.scene_geometry import (
    NO_SURFACE,
    PLANE_AXES,
    ROOM_SIDES,
    Box,
    EnvironmentScene,
    Hits,
    cast_rays,
    intersect_box,
    invert_components,
    lies_in_glass,
    rotate_about_vertical,
    view_rays,
)
from data_tools.synthetic.environments.sky import Sky, angles_between
from data_tools.synthetic.environments.surfaces import surface_properties
from data_tools.synthetic.random_values import Field, Ids
from metapp.appearance.latlong import resample_maps, solid_angles

_Number = TypeVar("_Number", bound=np.generic)

_SUN_RADIUS = math.radians(0.2665)  # rad
_CASTERS = 12  # boxes that cast shadows, at most
_FLAT = 0.2  # m; lower boxes lie on the ground
_CELLS = (8, 16)  # rows and columns of cells of directions; each scatters light from one point
_PARTS = 8  # parts of the places that are computed at a time
_SHADE = np.float32(0.85)  # share of light that a tree's crown takes away


def render_environment(
    scene: EnvironmentScene, turn_rad: float, supersampling: int = 2, rows: int = MAP_HEIGHT_PX
) -> Field:
    """Render the environment map of a scene.

    Args:
        scene: the scene around the eye.
        turn_rad: angle by which the eye is turned about the vertical.
        supersampling: rays per texel of a map of 64 rows, along each side.
        rows: rows of the map, at most 64 times `supersampling`.

    Returns:
        Radiance [3, rows, 2 * rows], kcd/m^2.
    """
    rays, angles = view_rays(supersampling)
    rays = rotate_about_vertical(rays, turn_rad)
    hits = cast_rays(scene, rays)
    albedo, gloss, glow = surface_properties(scene, hits, rays)
    sun = direct_sun_irradiance(scene, hits.place, hits.normal)
    scattered = _scattered_irradiance(scene, hits, albedo, glow, sun, supersampling)
    radiance = albedo * (sun + scattered) * np.float32(1 / math.pi) + glow
    sky_rays = np.flatnonzero(hits.surface == NO_SURFACE)
    sky_radiance = scene.backdrop.radiance(rays[:, sky_rays])
    radiance[:, sky_rays] = sky_radiance if hits.glass is None else sky_radiance * hits.glass[:, sky_rays]
    radiance += sun_disc(scene.backdrop.sky, rays, angles) * _visible_sun_share(scene)[:, None]
    if gloss.any():
        radiance += _mirrored_radiance(radiance, rays, hits.normal, gloss, turn_rad)
    fine = torch.from_numpy(radiance).unflatten(1, (MAP_HEIGHT_PX * supersampling, MAP_WIDTH_PX * supersampling))
    result: Field = np.maximum(resample_maps(fine, rows, 2 * rows).numpy(), 0)
    return result


def sun_disc(sky: Sky, rays: Field, angles: Field) -> Field:
    """Return the radiance [3, N] of the sun's disc along a grid's rays.

    The sun's irradiance is spread over the texels around it.

    Args:
        sky: the sky that the sun is in.
        rays: [3, N], all directions of the grid.
        angles: their solid angles [N] in sr.
    """
    if not sky.sunlight.any():
        return np.zeros_like(rays)
    spacing = math.sqrt(float(angles.max()))
    radius = max(_SUN_RADIUS, 0.75 * spacing)  # rad; no smaller than the grid can hold
    weight = np.clip((radius - angles_between(sky.sun, rays)) / np.float32(spacing) + np.float32(0.5), 0, 1)
    result: Field = sky.sunlight[:, None] * (weight / np.float32(weight @ angles))
    return result


def _visible_sun_share(scene: EnvironmentScene) -> Field:
    """Return the share [3] of the sun's disc that the eye sees: mean of a ray to its middle and four to its rim."""
    offsets = np.array([[0, 1, -1, 0, 0], [0, 0, 0, 1, -1], [0, 0.5, 0.5, 0, 0]], np.float32)
    rays = scene.backdrop.sky.sun[:, None] + np.float32(_SUN_RADIUS) * offsets
    rays /= np.linalg.norm(rays, axis=0)
    hits = cast_rays(scene, rays)
    share = (hits.surface == NO_SURFACE) * scene.backdrop.clearness(rays)
    result: Field = (share * (np.ones_like(rays) if hits.glass is None else hits.glass)).mean(1)
    return result


def visibility(
    scene: EnvironmentScene, positions: Field, directions: Field, reach: Field | float, softness: float
) -> Field:
    """Return how much of a distant point is seen from positions, past boxes and crowns.

    Args:
        scene: the scene, of which the largest boxes cast shadows.
        positions: [3, N] in m.
        directions: unit directions to the point, [3, N] or [3, 1].
        reach: distance of the point in m.
        softness: of shadows: a box is opaque to rays whose way through it is longer than `softness` times the distance
            to it.

    Returns:
        The visibility [N] in [0, 1].
    """
    inverse = invert_components(directions)
    free_share = np.ones(positions.shape[1], np.float32)
    for box in shadow_casters(scene):
        entry_distance, exit_distance = intersect_box(
            box.low[:, None] - positions, box.high[:, None] - positions, inverse
        )
        entry_distance = np.maximum(entry_distance, 0)
        free_share *= 1 - np.clip(
            (np.minimum(exit_distance, reach) - entry_distance) / (softness * entry_distance + np.float32(0.02)), 0, 1
        )
    holes: Field | float = 0.0
    if scene.crowns and softness < 0.1:  # the sun shines through, in spots
        holes = look_up_noise("leaves", positions[0] * np.float32(0.12), positions[2] * np.float32(0.12))
    for crown in scene.crowns:
        offset = crown.centre[:, None] - positions
        middle = (directions * offset).sum(0)
        inwards = 1 - ((offset**2).sum(0) - middle**2) / np.float32(crown.radius**2)
        is_before = (inwards > 0) & (middle > 0) & (middle < reach)
        free_share *= 1 - _SHADE * np.clip(2 * inwards + holes, 0, 1) * is_before
    return free_share


def shadow_casters(scene: EnvironmentScene) -> list[Box]:
    """Return the boxes that cast shadows: the ones that look largest from the eye."""

    def negative_size(box: Box) -> float:
        """Return the negative apparent size of a box, by which boxes are sorted."""
        size, offset = box.high - box.low, np.maximum(np.maximum(box.low, -box.high), 0)
        return -float(size[0] * size[1] + size[1] * size[2] + size[2] * size[0]) / (1 + float(offset @ offset))

    return sorted((box for box in scene.boxes if box.high[1] - box.low[1] > _FLAT), key=negative_size)[:_CASTERS]


def direct_sun_irradiance(scene: EnvironmentScene, positions: Field, normal: Field) -> Field:
    """Return the irradiance [3, N] by the sun at positions, past all that is in its way; in rooms through windows."""
    sky = scene.backdrop.sky
    facing = np.maximum(sky.sun @ normal, 0)
    result = np.zeros_like(positions)
    if not sky.sunlight.any():
        return result
    share = _window_transmittance(scene, positions, sky.sun) if scene.is_room else np.ones_like(positions)
    lit_points = np.flatnonzero(facing * share.any(0))
    free_share = visibility(scene, positions[:, lit_points], sky.sun[:, None], np.inf, 0.01)
    result[:, lit_points] = sky.sunlight[:, None] * (facing[lit_points] * free_share) * share[:, lit_points]
    return result


def _window_transmittance(scene: EnvironmentScene, positions: Field, direction: Field) -> Field:
    """Return the share [3, N] of light from a direction that reaches positions in a room through its windows."""
    share = np.zeros_like(positions)
    inverse = invert_components(direction)[:, None]
    end_distances = (np.where(inverse > 0, scene.high[:, None], scene.low[:, None]) - positions) * inverse
    axis = end_distances.argmin(0)
    leaving = positions + direction[:, None] * end_distances.min(0)
    for window in scene.windows:
        across = window.side // 2
        if (direction[across] > 0) == window.side % 2:
            first, second = PLANE_AXES[across]
            share += window.glass[:, None] * (lies_in_glass(window, leaving[first], leaving[second]) & (axis == across))
    return share


def emitter_irradiance(scene: EnvironmentScene, lights: list[Emitters], positions: Field, normal: Field) -> Field:
    """Return the irradiance [3, N] straight from emitters at positions [3, N] on surfaces with normals [3, N]."""
    total = np.zeros_like(positions)
    for light in lights:
        share_below, share_above = (np.zeros((len(light.areas), positions.shape[1]), np.float32) for _ in range(2))
        for number, (emitter_place, axis, area) in enumerate(
            zip(light.places, light.normals, light.areas, strict=True)
        ):
            if light.is_far:
                directions = emitter_place[:, None] / np.linalg.norm(emitter_place)
                share_below[number] = np.maximum(emitter_place @ normal, 0) * visibility(
                    scene, positions, directions, np.inf, 0.4
                )
                continue
            directions = emitter_place[:, None] - positions
            squared = (directions**2).sum(0)
            distance = np.sqrt(squared) + np.float32(1e-4)
            directions /= distance
            leaving = np.maximum(-(axis @ directions), 0) if axis.any() else np.float32(1)
            # The term beside the square of the distance makes it exact right before a disc, and finite.
            share = np.maximum((directions * normal).sum(0), 0) * leaving / (squared + area / np.float32(math.pi))
            share *= visibility(scene, positions, directions, distance - np.float32(0.05), 0.25)
            downwards = np.clip(directions[1] * 8 + np.float32(0.3), 0, 1)
            share_below[number], share_above[number] = share * downwards, share * (1 - downwards)
        total += light.power.T @ share_below + light.power_up.T @ share_above
    return total


def _scattered_irradiance(
    scene: EnvironmentScene, hits: Hits, albedo: Field, glow: Field, sun: Field, supersampling: int
) -> Field:
    """Return the irradiance [3, N] by everything but the sun, at the hits of a grid.

    It is computed on the coarser grid of the maps, and spread to the rays.
    """
    fine = (MAP_HEIGHT_PX, supersampling, MAP_WIDTH_PX, supersampling)

    def coarse(values: Field) -> Field:
        """Return values of the rays at the first ray of each of the maps' texels."""
        return values.reshape(-1, *fine)[:, :, 0, :, 0].reshape(-1, MAP_HEIGHT_PX * MAP_WIDTH_PX)

    surface = hits.surface.reshape(fine)[:, 0, :, 0]
    positions, normal, is_surface = coarse(hits.place), coarse(hits.normal), surface.ravel() != NO_SURFACE
    direct = emitter_irradiance(scene, list_emitters(scene), positions + normal * np.float32(0.03), normal)
    first_lamp = len(ROOM_SIDES) + len(scene.boxes) + len(scene.crowns)  # lamps are among the emitters already
    leaving = coarse(albedo) * (direct + coarse(sun)) * np.float32(1 / math.pi)
    leaving += coarse(glow) * (surface.ravel() < first_lamp)
    once_scattered = _bounced_irradiance(scene, leaving * is_surface, positions, normal, is_surface)
    weights = solid_angles(MAP_HEIGHT_PX, MAP_WIDTH_PX).expand(
        MAP_HEIGHT_PX, MAP_WIDTH_PX
    ).flatten().numpy() / np.float32(4 * math.pi)
    reflected_share = scene.kept_light_share * (coarse(albedo) @ weights)
    mean = (once_scattered * is_surface) @ weights / max(float(is_surface @ weights), 1e-3)
    total = direct + once_scattered + (mean * reflected_share / (1 - reflected_share))[:, None]
    return _spread_to_rays(total.reshape(3, MAP_HEIGHT_PX, MAP_WIDTH_PX), surface, hits.surface, supersampling)


def _bounced_irradiance(
    scene: EnvironmentScene, leaving: Field, positions: Field, normal: Field, is_surface: Field
) -> Field:
    """Return the irradiance [3, N] at positions by the radiance that leaves all that is seen, without shadows.

    The visible surfaces are cut into cells of directions; each sends its mean radiance from one of its points.
    """
    rows, columns = _CELLS
    grid = (rows, MAP_HEIGHT_PX // rows, columns, MAP_WIDTH_PX // columns)
    middle = np.arange(MAP_HEIGHT_PX * MAP_WIDTH_PX).reshape(grid)[:, grid[1] // 2, :, grid[3] // 2].ravel()
    mean = leaving.reshape(3, *grid).mean((2, 4)).reshape(3, -1)
    origin, axis = positions[:, middle], normal[:, middle]
    distance2 = (origin**2).sum(0)
    facing = np.maximum(-(origin * axis).sum(0) / np.sqrt(distance2), np.float32(0.15))
    angles = solid_angles(rows, columns).expand(rows, columns).flatten().numpy()
    area = np.minimum(angles / facing, 1) * distance2 * is_surface[middle]

    def cell_irradiance(positions: Field, normal: Field) -> Field:
        """Return the irradiance [3, M] that all cells send to positions [3, M] with normals [3, M]."""
        squared = np.maximum((positions**2).sum(0)[:, None] + distance2 - 2 * (positions.T @ origin), 0)
        arriving = normal.T @ origin - (normal * positions).sum(0)[:, None]
        departing = positions.T @ axis - (origin * axis).sum(0)
        weight = np.maximum(arriving, 0) * np.maximum(departing, 0) * area
        weight /= squared * (squared + area * np.float32(1 / math.pi)) + np.float32(1e-6)
        if scene.is_room:  # a place in a room sees nothing but the room
            weight *= np.float32(math.pi) / np.maximum(weight.sum(1, keepdims=True), np.float32(0.5))
        result: Field = mean @ weight.T
        return result

    # The places are cut into parts that fit into the processor's cache.
    parts = zip(np.split(positions, _PARTS, axis=1), np.split(normal, _PARTS, axis=1), strict=True)
    return np.concatenate([cell_irradiance(*part) for part in parts], axis=1)


def _spread_to_rays(coarse: Field, surface: Ids, fine_surface: Ids, supersampling: int) -> Field:
    """Return the values [3, N] of texels [3, H, W] at fine rays.

    A ray gets the value of its own texel, or of a neighbour that shows the surface that the ray hits.
    """

    def enlarge(values: npt.NDArray[_Number]) -> npt.NDArray[_Number]:
        """Repeat each texel as often as there are rays in it."""
        return values.repeat(supersampling, -2).repeat(supersampling, -1)

    fine = fine_surface.reshape(MAP_HEIGHT_PX * supersampling, MAP_WIDTH_PX * supersampling)
    result = enlarge(coarse)
    missing = enlarge(surface) != fine
    for shift in ((0, -1), (-1, 0), (0, 1), (1, 0)):
        matching = missing & (enlarge(np.roll(surface, shift, (0, 1))) == fine)
        result[:, matching] = enlarge(np.roll(coarse, shift, (1, 2)))[:, matching]
        missing &= ~matching
    return result.reshape(3, -1)


def _mirrored_radiance(radiance: Field, rays: Field, normal: Field, gloss: Field, turn_rad: float) -> Field:
    """Return the radiance [3, N] that glossy surfaces mirror, by Schlick's Fresnel factor.

    They mirror the map itself, a little blurred.
    """
    height = math.isqrt(rays.shape[1] // 2)
    members = np.flatnonzero(gloss)
    cosine = (rays[:, members] * normal[:, members]).sum(0)
    mirrored = rotate_about_vertical(rays[:, members] - 2 * cosine * normal[:, members], -turn_rad)
    row = np.arccos(np.clip(mirrored[1], -1, 1)) * np.float32(height / math.pi)
    column = np.arctan2(mirrored[0], -mirrored[2]) * np.float32(height / math.pi) + 2 * height
    texel = np.minimum(row.astype(np.int64), height - 1) * 2 * height + column.astype(np.int64) % (2 * height)
    image = radiance.reshape(3, height, 2 * height)
    image = image + np.roll(image, 1, 2) + np.roll(image, -1, 2)
    image = np.sum([np.roll(image, step, 1) for step in range(-2, 3)], axis=0).reshape(3, -1) / 15
    share = gloss[members] + (1 - gloss[members]) * (1 - np.abs(cosine)) ** 5
    result = np.zeros_like(rays)
    result[:, members] = image[:, texel] * share
    return result
