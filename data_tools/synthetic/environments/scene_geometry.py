"""Scenes of a room or open ground with boxes, tree crowns and lamps, and their intersections with rays from the eye.

Lengths are metres, +y is up, the eye is the origin. Radiance is linear Rec.709 in kcd/m^2, irradiance in klx. Vectors
are float32 [3], or [3, N] for N rays.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from data_tools.readers.environment_maps import MAP_HEIGHT_PX, MAP_WIDTH_PX
from data_tools.synthetic.environments.patterns import BLACK, look_up_noise, vector
from data_tools.synthetic.environments.sky import Sky
from data_tools.synthetic.random_values import Field, Ids
from metapp.appearance.latlong import solid_angles, texel_directions

ROOM_SIDES = ("-x", "+x", "floor", "ceiling", "-z", "+z")  # names of a room's sides, in the order of their numbers
NO_SURFACE = -1  # stands for the number of a surface where a ray hits none
PLANE_AXES = ((2, 1), (0, 2), (0, 1))  # by the axis of a surface's normal: the axes across and along the surface

_FAR = 1e4  # m, beyond all surfaces
_NARROWEST = 0.02  # rad; smaller lamps are seen this large, and so much darker

Mask = npt.NDArray[np.bool_]


class Finish(NamedTuple):
    """The look of a surface.

    Attributes:
        colour: albedo [3].
        second_colour: albedo [3] that the pattern leads to; None for one colour.
        pattern: name of one of `shared_noises()`, or "tiles", "chequers", "stripes" or "patches".
        size: one period of the pattern, m.
        gloss: share of light from straight ahead that is mirrored.
        window_spacing_m: height and width of the fields in which each facade window sits; None for no windows.
        window_share: share of a field's height and width that its window takes.
        window_radiance: radiance [3] of the windows that are lit, three of ten; black by day.
    """

    colour: Field
    second_colour: Field | None = None
    pattern: str = "rough"
    size: float = 4.0
    gloss: float = 0.0
    window_spacing_m: tuple[float, float] | None = None
    window_share: tuple[float, float] = (0.6, 0.6)
    window_radiance: Field = BLACK


class Box(NamedTuple):
    """A block whose sides are parallel to the axes; the eye is outside.

    Attributes:
        low, high: its corners [3].
        finish: the look of its sides.
    """

    low: Field
    high: Field
    finish: Finish


class Crown(NamedTuple):
    """The leaves of a tree or bush, a loose ball.

    Attributes:
        centre: its middle [3].
        radius: its radius in m.
        colour: albedo [3] of the leaves.
    """

    centre: Field
    radius: float
    colour: Field


class Lamp(NamedTuple):
    """A flat emitter.

    Attributes:
        centre: its middle [3].
        right, up: vectors [3] from the middle to its sides.
        radiance: radiance [3] to the side to which right x up points.
        shape: "panel", "disc", or "ball", which turns to the eye and shines to all sides.
    """

    centre: Field
    right: Field
    up: Field
    radiance: Field
    shape: str = "panel"

    @property
    def halves(self) -> tuple[float, float]:
        """Half of the lamp's width and of its height in m."""
        return float(np.linalg.norm(self.right)), float(np.linalg.norm(self.up))

    @property
    def seen_halves(self) -> tuple[float, float]:
        """The lamp's halves in m as the eye sees them: enlarged where rays could otherwise miss it."""
        distance = float(np.linalg.norm(self.centre))
        slant = [float(axis @ self.centre) / distance for axis in (self.right, self.up)]
        first, second = (
            max(half, _NARROWEST * distance / max(math.sqrt(1 - min(1, along / half) ** 2), 0.3))
            for half, along in zip(self.halves, slant if self.shape != "ball" else (0, 0), strict=True)
        )
        return first, second

    @property
    def seen_radiance(self) -> Field:
        """The lamp's radiance [3] as the eye sees it: less by the factor by which the lamp is seen larger."""
        return self.radiance * np.float32(math.prod(self.halves) / math.prod(self.seen_halves))


class Window(NamedTuple):
    """An opening in a side of the room.

    Attributes:
        side: number of the side.
        low, high: its corners across and along the side, m.
        glass: colour [3] of its glass, the share of light that passes.
        bars: panes across and along.
    """

    side: int
    low: tuple[float, float]
    high: tuple[float, float]
    glass: Field
    bars: tuple[int, int] = (1, 1)  # panes across and along


class Backdrop(NamedTuple):
    """The sky and, in front of it, the far distance.

    Attributes:
        sky: the sky with its sun.
        radiance: function from directions [3, N], also below the horizon, to radiance [3, N] without the sun's disc.
        clearness: function from directions [3, N] to the share [N] of the sky that shows there.
    """

    sky: Sky
    radiance: Callable[[Field], Field]
    clearness: Callable[[Field], Field]


@dataclass
class EnvironmentScene:
    """A scene: all that is around the eye.

    Attributes:
        low, high: corners [3] of the room; infinite if it is open.
        sides: finishes of -x, +x, floor, ceiling, -z, +z.
        backdrop: the view beyond the open sides and the windows.
        kept_light_share: how much of the scattered light the surroundings keep, 0 (open country) to 1 (a room).
        boxes, crowns, lamps, windows: what is in the scene.
    """

    low: Field
    high: Field
    sides: list[Finish]
    backdrop: Backdrop
    kept_light_share: float = 1.0
    boxes: list[Box] = field(default_factory=list)
    crowns: list[Crown] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)

    @property
    def is_room(self) -> bool:
        """Whether the scene has walls on all sides."""
        return bool(np.isfinite(self.low).all() and np.isfinite(self.high).all())

    def add_box(self, clearance_m: float, box: Box) -> None:
        """Add a box unless the eye would be in it or less than `clearance_m` metres from it."""
        if (np.maximum(box.low, -box.high)[[0, 2]] > clearance_m).any():
            self.boxes.append(box)


class Hits(NamedTuple):
    """The first intersections of N rays from the eye.

    Attributes:
        surface: numbers [N] of the surfaces (sides, boxes, crowns, lamps); NO_SURFACE for none.
        distance: [N] in m.
        place: [3, N] in m.
        normal: [3, N].
        glass: [3, N], the share of light that passes the windows on the ray's way out; None without windows.
    """

    surface: Ids
    distance: Field
    place: Field
    normal: Field
    glass: Field | None  # [3, N], what a ray has passed through on its way beyond


@functools.lru_cache(maxsize=2)
def view_rays(supersampling: int) -> tuple[Field, Field]:
    """Return rays [3, N] of a grid `supersampling` times finer than maps, row by row, and their solid angles [N]."""
    height, width = MAP_HEIGHT_PX * supersampling, MAP_WIDTH_PX * supersampling
    rays = texel_directions(height, width).flatten(1).numpy()
    angles = solid_angles(height, width).expand(height, width).flatten().numpy()
    return rays, angles


def rotate_about_vertical(rays: Field, angle_rad: float) -> Field:
    """Return directions [3, N] turned about the vertical."""
    cos, sin = np.float32(math.cos(angle_rad)), np.float32(math.sin(angle_rad))
    return np.stack([rays[0] * cos - rays[2] * sin, rays[1], rays[0] * sin + rays[2] * cos])


def invert_components(rays: Field) -> Field:
    """Return 1 over each component, which is kept off zero."""
    result: Field = 1 / np.copysign(np.maximum(np.abs(rays), np.float32(1e-6)), rays)
    return result


def intersect_box(low: Field, high: Field, inverse: Field) -> tuple[Field, Field]:
    """Return the distances at which rays, prolonged in both directions, enter and leave a box.

    Args:
        low: corner of the box from the ray's start [3], or [3, N].
        high: the opposite corner.
        inverse: 1 over the components of the rays' directions, [3, N], or [3, 1].

    Returns:
        Both distances [N]; a ray misses the box if the first is larger, or the second negative.
    """
    entry_distance: Field = np.array(-np.inf, np.float32)
    exit_distance = -entry_distance
    for axis in range(3):  # axis by axis, since small arrays stay in the processor's cache
        first, second = low[axis] * inverse[axis], high[axis] * inverse[axis]
        entry_distance, exit_distance = (
            np.maximum(entry_distance, np.minimum(first, second)),
            np.minimum(exit_distance, np.maximum(first, second)),
        )
    return entry_distance, exit_distance


def cast_rays(scene: EnvironmentScene, rays: Field) -> Hits:
    """Return the first intersections of rays [3, N] from the eye."""
    inverse = invert_components(rays)
    end_distances = np.where(inverse > 0, scene.high[:, None], scene.low[:, None]) * inverse
    axis = end_distances.argmin(0)
    columns = np.arange(rays.shape[1])
    distance = np.minimum(end_distances[axis, columns], np.float32(_FAR))
    surface = np.where(distance < _FAR, 2 * axis + (inverse[axis, columns] > 0), NO_SURFACE)
    positions = rays * distance
    glass = _open_windows(scene, surface, positions)
    normal = np.zeros_like(rays)
    normal[axis, columns] = -np.sign(rays[axis, columns])
    number = len(ROOM_SIDES)
    for box in scene.boxes:
        hit_distance, exit_distance = intersect_box(box.low, box.high, inverse)
        hit_rays = np.flatnonzero((hit_distance < exit_distance) & (hit_distance > 0) & (hit_distance < distance))
        distance[hit_rays], surface[hit_rays] = hit_distance[hit_rays], number
        side = np.minimum(box.low[:, None] * inverse[:, hit_rays], box.high[:, None] * inverse[:, hit_rays]).argmax(0)
        normal[:, hit_rays] = 0
        normal[side, hit_rays] = -np.sign(rays[side, hit_rays])
        number += 1
    for crown in scene.crowns:
        hit_rays, hit_distance = _hit_crown(crown, rays, distance)
        distance[hit_rays], surface[hit_rays] = hit_distance, number
        normal[:, hit_rays] = (rays[:, hit_rays] * hit_distance - crown.centre[:, None]) / np.float32(crown.radius)
        number += 1
    for lamp in scene.lamps:
        hit_rays, hit_distance = _hit_lamp(lamp, rays, distance)
        distance[hit_rays], surface[hit_rays] = hit_distance, number
        number += 1
    return Hits(surface, distance, rays * distance, normal, glass)


def _open_windows(scene: EnvironmentScene, surface: Ids, positions: Field) -> Field | None:
    """Set the surface of rays that leave through a window to NO_SURFACE, and return the glass that they pass."""
    if not scene.windows:
        return None
    glass = np.ones_like(positions)
    for window in scene.windows:
        on_side = np.flatnonzero(surface == window.side)
        across, along = (positions[axis, on_side] for axis in PLANE_AXES[window.side // 2])
        leaving = on_side[lies_in_glass(window, across, along)]
        surface[leaving] = NO_SURFACE
        glass[:, leaving] = window.glass[:, None]
    return glass


def lies_in_glass(window: Window, across: Field, along: Field) -> Mask:
    """Return whether places on the window's side [N] are in its glass."""
    is_glass = np.ones(across.shape, np.bool_)
    for values, low, high, panes in zip((across, along), window.low, window.high, window.bars, strict=True):
        share = (values - low) / np.float32(high - low)
        is_glass &= (share > 0) & (share < 1)
        if panes > 1:
            is_glass &= np.abs((share * panes) % 1 - np.float32(0.5)) < 0.5 - 0.04 * panes / (high - low)
    return is_glass


def _hit_crown(crown: Crown, rays: Field, nearest_hit: Field) -> tuple[Ids, Field]:
    """Return which rays meet leaves, and how far away: a crown is a ball with more and more holes to its rim."""
    middle = crown.centre @ rays
    squared_offset = (float(crown.centre @ crown.centre) - middle**2) / np.float32(crown.radius**2)
    hit_rays = np.flatnonzero((squared_offset < 1) & (middle > 0) & (middle < nearest_hit + crown.radius))
    depth = np.sqrt(1 - squared_offset[hit_rays])
    turn = np.arctan2(rays[2, hit_rays], rays[0, hit_rays]) * np.float32(0.5 / math.pi) * 3
    leaves = look_up_noise("leaves", turn + crown.radius, rays[1, hit_rays])
    clumps = look_up_noise("rough", turn + crown.radius, rays[1, hit_rays])
    is_leaf = 0.6 * leaves + 1.1 * clumps > 1.9 - 4.5 * depth
    hit_distance = middle[hit_rays] - crown.radius * depth
    is_leaf &= (hit_distance > 0.3) & (hit_distance < nearest_hit[hit_rays])
    return hit_rays[is_leaf], hit_distance[is_leaf]


def _hit_lamp(lamp: Lamp, rays: Field, nearest_hit: Field) -> tuple[Ids, Field]:
    """Return which rays meet a lamp's front, and how far away."""
    normal, right, up = -lamp.centre, lamp.right, lamp.up
    if lamp.shape == "ball":
        right = np.cross(lamp.centre, vector(0.1, 1, 0.2))
        up = np.cross(lamp.centre, right)
    else:
        normal = np.cross(right, up)
    if normal @ lamp.centre >= 0:  # seen from behind
        return np.zeros(0, np.int64), np.zeros(0, np.float32)
    distance = float(normal @ lamp.centre) * invert_components(normal @ rays)
    offsets = []
    for axis, half in zip((right, up), lamp.seen_halves, strict=True):
        axis = axis / np.float32(np.linalg.norm(axis) * half)
        offsets.append(np.abs(axis @ rays * distance - float(axis @ lamp.centre)))
    rim_share = np.maximum(*offsets) if lamp.shape == "panel" else np.hypot(*offsets)
    hit_rays = np.flatnonzero((rim_share < 1) & (distance > 0) & (distance < nearest_hit + np.float32(0.05)))
    return hit_rays, distance[hit_rays]
