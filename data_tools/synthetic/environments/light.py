"""Light of scenes, and the radiance that reaches the eye: from a scene to a map.

Light goes straight from the sun, the sky, windows and lamps to visible surfaces, with shadows; from there once more to
all of these, without; light that is scattered more often is the same everywhere.
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

_SUN_RADIUS = math.radians(0.2665)
_CASTERS = 12  # boxes that cast shadows, at most
_FLAT = 0.2  # m; lower boxes lie on the ground
_CELLS = (8, 16)  # of directions; each scatters light from one point
_PARTS = 8
_SHADE = np.float32(0.85)  # share of light that a tree's crown takes away


def render_environment(
    scene: EnvironmentScene, turn_rad: float, supersampling: int = 2, rows: int = MAP_HEIGHT_PX
) -> Field:
    """The map of a scene.

    Args:
        scene: around the eye.
        turn_rad: of the eye about the vertical.
        supersampling: rays per texel of 64 rows, along each side.
        rows: of the map, up to 64 times that.

    Returns:
        Radiance [3, rows, 2 * rows], kcd/m^2.
    """
    rays, angles = view_rays(supersampling)
    rays = rotate_about_vertical(rays, turn_rad)
    hits = cast_rays(scene, rays)
    albedo, gloss, glow = surface_properties(scene, hits, rays)
    sun = direct_sun_irradiance(scene, hits.place, hits.normal)
    scattered = _scattered(scene, hits, albedo, glow, sun, supersampling)
    radiance = albedo * (sun + scattered) * np.float32(1 / math.pi) + glow
    beyond = np.flatnonzero(hits.surface == NO_SURFACE)
    seen = scene.backdrop.radiance(rays[:, beyond])
    radiance[:, beyond] = seen if hits.glass is None else seen * hits.glass[:, beyond]
    radiance += sun_disc(scene.backdrop.sky, rays, angles) * _sun_seen(scene)[:, None]
    if gloss.any():
        radiance += _mirrored(radiance, rays, hits.normal, gloss, turn_rad)
    fine = torch.from_numpy(radiance).unflatten(1, (MAP_HEIGHT_PX * supersampling, MAP_WIDTH_PX * supersampling))
    result: Field = np.maximum(resample_maps(fine, rows, 2 * rows).numpy(), 0)
    return result


def sun_disc(sky: Sky, rays: Field, angles: Field) -> Field:
    """The sun's disc as radiance [3, N] of a grid's rays: its irradiance, spread over the texels around it.

    Args:
        sky: the sun's.
        rays: [3, N], all directions.
        angles: their solid angles [N] in sr.
    """
    if not sky.sunlight.any():
        return np.zeros_like(rays)
    spacing = math.sqrt(float(angles.max()))
    radius = max(_SUN_RADIUS, 0.75 * spacing)  # no smaller than the grid can hold
    weight = np.clip((radius - angles_between(sky.sun, rays)) / np.float32(spacing) + np.float32(0.5), 0, 1)
    result: Field = sky.sunlight[:, None] * (weight / np.float32(weight @ angles))
    return result


def _sun_seen(scene: EnvironmentScene) -> Field:
    """Share [3] of the sun's disc that the eye sees: mean of a ray to its middle and four to its rim."""
    offsets = np.array([[0, 1, -1, 0, 0], [0, 0, 0, 1, -1], [0, 0.5, 0.5, 0, 0]], np.float32)
    rays = scene.backdrop.sky.sun[:, None] + np.float32(_SUN_RADIUS) * offsets
    rays /= np.linalg.norm(rays, axis=0)
    hits = cast_rays(scene, rays)
    share = (hits.surface == NO_SURFACE) * scene.backdrop.clearness(rays)
    result: Field = (share * (np.ones_like(rays) if hits.glass is None else hits.glass)).mean(1)
    return result


def visibility(scene: EnvironmentScene, place: Field, way: Field, reach: Field | float, soft: float) -> Field:
    """How much of a distant point is seen from places, past boxes and crowns.

    Args:
        scene: its largest boxes cast shadows.
        place: [3, N].
        way: unit directions to the point, [3, N] or [3, 1].
        reach: distance of the point in m.
        soft: a box is opaque to rays whose way through it is longer than so many times the distance to it.

    Returns:
        [N] in [0, 1].
    """
    over = invert_components(way)
    free = np.ones(place.shape[1], np.float32)
    for box in shadow_casters(scene):
        near, far = intersect_box(box.low[:, None] - place, box.high[:, None] - place, over)
        near = np.maximum(near, 0)
        free *= 1 - np.clip((np.minimum(far, reach) - near) / (soft * near + np.float32(0.02)), 0, 1)
    holes: Field | float = 0.0
    if scene.crowns and soft < 0.1:  # the sun shines through, in spots
        holes = look_up_noise("leaves", place[0] * np.float32(0.12), place[2] * np.float32(0.12))
    for crown in scene.crowns:
        offset = crown.centre[:, None] - place
        middle = (way * offset).sum(0)
        inwards = 1 - ((offset**2).sum(0) - middle**2) / np.float32(crown.radius**2)
        before = (inwards > 0) & (middle > 0) & (middle < reach)
        free *= 1 - _SHADE * np.clip(2 * inwards + holes, 0, 1) * before
    return free


def shadow_casters(scene: EnvironmentScene) -> list[Box]:
    """The boxes that cast shadows: those that look largest from the eye."""

    def apparent(box: Box) -> float:
        size, near = box.high - box.low, np.maximum(np.maximum(box.low, -box.high), 0)
        return -float(size[0] * size[1] + size[1] * size[2] + size[2] * size[0]) / (1 + float(near @ near))

    return sorted((box for box in scene.boxes if box.high[1] - box.low[1] > _FLAT), key=apparent)[:_CASTERS]


def direct_sun_irradiance(scene: EnvironmentScene, place: Field, normal: Field) -> Field:
    """Irradiance [3, N] by the sun at places, past all that is in its way; in a room only through windows."""
    sky = scene.backdrop.sky
    facing = np.maximum(sky.sun @ normal, 0)
    result = np.zeros_like(place)
    if not sky.sunlight.any():
        return result
    share = _through_windows(scene, place, sky.sun) if scene.is_room else np.ones_like(place)
    lit = np.flatnonzero(facing * share.any(0))
    free = visibility(scene, place[:, lit], sky.sun[:, None], np.inf, 0.01)
    result[:, lit] = sky.sunlight[:, None] * (facing[lit] * free) * share[:, lit]
    return result


def _through_windows(scene: EnvironmentScene, place: Field, way: Field) -> Field:
    """Which share [3, N] of light from this direction reaches places in a room."""
    share = np.zeros_like(place)
    over = invert_components(way)[:, None]
    ends = (np.where(over > 0, scene.high[:, None], scene.low[:, None]) - place) * over
    axis = ends.argmin(0)
    leaving = place + way[:, None] * ends.min(0)
    for window in scene.windows:
        across = window.side // 2
        if (way[across] > 0) == window.side % 2:
            first, second = PLANE_AXES[across]
            share += window.glass[:, None] * (lies_in_glass(window, leaving[first], leaving[second]) & (axis == across))
    return share


def emitter_irradiance(scene: EnvironmentScene, lights: list[Emitters], place: Field, normal: Field) -> Field:
    """Irradiance [3, N] straight from sources at places [3, N] on surfaces with these normals [3, N]."""
    total = np.zeros_like(place)
    for light in lights:
        below, above = (np.zeros((len(light.areas), place.shape[1]), np.float32) for _ in range(2))
        for number, (where, axis, area) in enumerate(zip(light.places, light.normals, light.areas, strict=True)):
            if light.far:
                way = where[:, None] / np.linalg.norm(where)
                below[number] = np.maximum(where @ normal, 0) * visibility(scene, place, way, np.inf, 0.4)
                continue
            way = where[:, None] - place
            squared = (way**2).sum(0)
            distance = np.sqrt(squared) + np.float32(1e-4)
            way /= distance
            leaving = np.maximum(-(axis @ way), 0) if axis.any() else np.float32(1)
            # The term beside the square of the distance makes it exact right before a disc, and finite.
            share = np.maximum((way * normal).sum(0), 0) * leaving / (squared + area / np.float32(math.pi))
            share *= visibility(scene, place, way, distance - np.float32(0.05), 0.25)
            downwards = np.clip(way[1] * 8 + np.float32(0.3), 0, 1)
            below[number], above[number] = share * downwards, share * (1 - downwards)
        total += light.power.T @ below + light.power_up.T @ above
    return total


def _scattered(
    scene: EnvironmentScene, hits: Hits, albedo: Field, glow: Field, sun: Field, supersampling: int
) -> Field:
    """Irradiance [3, N] by everything but the sun, at the hits of a grid: reckoned on the maps' coarser grid."""
    fine = (MAP_HEIGHT_PX, supersampling, MAP_WIDTH_PX, supersampling)

    def coarse(values: Field) -> Field:
        return values.reshape(-1, *fine)[:, :, 0, :, 0].reshape(-1, MAP_HEIGHT_PX * MAP_WIDTH_PX)

    surface = hits.surface.reshape(fine)[:, 0, :, 0]
    place, normal, solid = coarse(hits.place), coarse(hits.normal), surface.ravel() != NO_SURFACE
    straight = emitter_irradiance(scene, list_emitters(scene), place + normal * np.float32(0.03), normal)
    first_lamp = len(ROOM_SIDES) + len(scene.boxes) + len(scene.crowns)  # lamps are among the sources already
    leaving = coarse(albedo) * (straight + coarse(sun)) * np.float32(1 / math.pi)
    leaving += coarse(glow) * (surface.ravel() < first_lamp)
    bounced = _bounced(scene, leaving * solid, place, normal, solid)
    weights = solid_angles(MAP_HEIGHT_PX, MAP_WIDTH_PX).expand(
        MAP_HEIGHT_PX, MAP_WIDTH_PX
    ).flatten().numpy() / np.float32(4 * math.pi)
    again = scene.closed * (coarse(albedo) @ weights)
    mean = (bounced * solid) @ weights / max(float(solid @ weights), 1e-3)
    total = straight + bounced + (mean * again / (1 - again))[:, None]
    return _spread(total.reshape(3, MAP_HEIGHT_PX, MAP_WIDTH_PX), surface, hits.surface, supersampling)


def _bounced(scene: EnvironmentScene, leaving: Field, place: Field, normal: Field, solid: Field) -> Field:
    """Irradiance [3, N] at places from the radiance that leaves all that is seen, without shadows.

    The visible surfaces are cut into cells of directions; each sends its mean radiance from one of its points.
    """
    rows, columns = _CELLS
    grid = (rows, MAP_HEIGHT_PX // rows, columns, MAP_WIDTH_PX // columns)
    middle = np.arange(MAP_HEIGHT_PX * MAP_WIDTH_PX).reshape(grid)[:, grid[1] // 2, :, grid[3] // 2].ravel()
    mean = leaving.reshape(3, *grid).mean((2, 4)).reshape(3, -1)
    origin, axis = place[:, middle], normal[:, middle]
    distance2 = (origin**2).sum(0)
    facing = np.maximum(-(origin * axis).sum(0) / np.sqrt(distance2), np.float32(0.15))
    angles = solid_angles(rows, columns).expand(rows, columns).flatten().numpy()
    area = np.minimum(angles / facing, 1) * distance2 * solid[middle]

    def received(place: Field, normal: Field) -> Field:
        squared = np.maximum((place**2).sum(0)[:, None] + distance2 - 2 * (place.T @ origin), 0)
        arriving = normal.T @ origin - (normal * place).sum(0)[:, None]
        departing = place.T @ axis - (origin * axis).sum(0)
        weight = np.maximum(arriving, 0) * np.maximum(departing, 0) * area
        weight /= squared * (squared + area * np.float32(1 / math.pi)) + np.float32(1e-6)
        if scene.is_room:  # all that a place sees is room
            weight *= np.float32(math.pi) / np.maximum(weight.sum(1, keepdims=True), np.float32(0.5))
        result: Field = mean @ weight.T
        return result

    # In parts that fit into the processor's cache.
    parts = zip(np.split(place, _PARTS, axis=1), np.split(normal, _PARTS, axis=1), strict=True)
    return np.concatenate([received(*part) for part in parts], axis=1)


def _spread(coarse: Field, surface: Ids, fine_surface: Ids, supersampling: int) -> Field:
    """Values [3, H, W] at every fine ray [3, N]: its own texel's, or a neighbour's that is of the same surface."""

    def enlarged(values: npt.NDArray[_Number]) -> npt.NDArray[_Number]:
        return values.repeat(supersampling, -2).repeat(supersampling, -1)

    fine = fine_surface.reshape(MAP_HEIGHT_PX * supersampling, MAP_WIDTH_PX * supersampling)
    result = enlarged(coarse)
    missing = enlarged(surface) != fine
    for shift in ((0, -1), (-1, 0), (0, 1), (1, 0)):
        matching = missing & (enlarged(np.roll(surface, shift, (0, 1))) == fine)
        result[:, matching] = enlarged(np.roll(coarse, shift, (1, 2)))[:, matching]
        missing &= ~matching
    return result.reshape(3, -1)


def _mirrored(radiance: Field, rays: Field, normal: Field, gloss: Field, turn_rad: float) -> Field:
    """Radiance [3, N] that glossy surfaces mirror by Schlick's Fresnel factor: the map itself, a little blurred."""
    height = math.isqrt(rays.shape[1] // 2)
    members = np.flatnonzero(gloss)
    cosine = (rays[:, members] * normal[:, members]).sum(0)
    way = rotate_about_vertical(rays[:, members] - 2 * cosine * normal[:, members], -turn_rad)
    row = np.arccos(np.clip(way[1], -1, 1)) * np.float32(height / math.pi)
    column = np.arctan2(way[0], -way[2]) * np.float32(height / math.pi) + 2 * height
    texel = np.minimum(row.astype(np.int64), height - 1) * 2 * height + column.astype(np.int64) % (2 * height)
    image = radiance.reshape(3, height, 2 * height)
    image = image + np.roll(image, 1, 2) + np.roll(image, -1, 2)
    image = np.sum([np.roll(image, step, 1) for step in range(-2, 3)], axis=0).reshape(3, -1) / 15
    share = gloss[members] + (1 - gloss[members]) * (1 - np.abs(cosine)) ** 5
    result = np.zeros_like(rays)
    result[:, members] = image[:, texel] * share
    return result
