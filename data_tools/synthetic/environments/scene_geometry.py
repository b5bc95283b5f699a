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

ROOM_SIDES = ("-x", "+x", "floor", "ceiling", "-z", "+z")  # of a room, in the order of their numbers
NO_SURFACE = -1  # the number of what no surface hides
PLANE_AXES = ((2, 1), (0, 2), (0, 1))  # axes along a surface whose normal is this axis: across and along

_FAR = 1e4  # m
_NARROWEST = 0.02  # rad; smaller lamps are seen this large, and so much darker

Mask = npt.NDArray[np.bool_]


class Finish(NamedTuple):
    """The look of a surface.

    Attributes:
        colour: albedo [3].
        other: albedo [3] that the pattern leads to.
        pattern: name of one of `noises()`, or "tiles", "chequers", "stripes" or "patches".
        size: m, of one period of the pattern.
        gloss: share of light from straight ahead that is mirrored.
        panes: height and width in m of the fields in which each facade window sits; None for no windows.
        glazed: share of a field's height and width that its window takes.
        lit: radiance [3] behind the windows that are lit, a third of them; black by day.
    """

    colour: Field
    other: Field | None = None
    pattern: str = "rough"
    size: float = 4.0
    gloss: float = 0.0
    panes: tuple[float, float] | None = None
    glazed: tuple[float, float] = (0.6, 0.6)
    lit: Field = BLACK


class Box(NamedTuple):
    """A block between two corners [3]; the eye is outside."""

    low: Field
    high: Field
    finish: Finish


class Crown(NamedTuple):
    """The leaves of a tree or bush, a loose ball."""

    centre: Field
    radius: float
    colour: Field


class Lamp(NamedTuple):
    """A flat source: its middle, the halves of its sides, its radiance [3] to the side of right x up.

    Attributes:
        shape: "panel", "disc", or "ball", which turns to the eye and shines to all sides.
    """

    centre: Field
    right: Field
    up: Field
    radiance: Field
    shape: str = "panel"

    @property
    def halves(self) -> tuple[float, float]:
        """Half of its width and of its height in m."""
        return float(np.linalg.norm(self.right)), float(np.linalg.norm(self.up))

    @property
    def seen_halves(self) -> tuple[float, float]:
        """The same as it is seen: not so small that rays could miss it."""
        distance = float(np.linalg.norm(self.centre))
        slant = [float(axis @ self.centre) / distance for axis in (self.right, self.up)]
        first, second = (
            max(half, _NARROWEST * distance / max(math.sqrt(1 - min(1, along / half) ** 2), 0.3))
            for half, along in zip(self.halves, slant if self.shape != "ball" else (0, 0), strict=True)
        )
        return first, second

    @property
    def seen_radiance(self) -> Field:
        """Radiance [3] as it is seen: as much less as the lamp is seen larger."""
        return self.radiance * np.float32(math.prod(self.halves) / math.prod(self.seen_halves))


class Window(NamedTuple):
    """An opening in a side of the room: from and to [2] in m across and along it, the colour of its glass [3]."""

    side: int
    low: tuple[float, float]
    high: tuple[float, float]
    glass: Field
    bars: tuple[int, int] = (1, 1)  # panes across and along


class Backdrop(NamedTuple):
    """The sky and, in front of it, the far distance.

    Attributes:
        sky: with its sun.
        radiance: of directions [3, N]: [3, N], also of those below the horizon; without the sun's disc.
        clearness: share [N] of the sky that shows in directions [3, N].
    """

    sky: Sky
    radiance: Callable[[Field], Field]
    clearness: Callable[[Field], Field]


@dataclass
class EnvironmentScene:
    """All that is around the eye.

    Attributes:
        low, high: corners [3] of the room; infinite if it is open.
        sides: finishes of -x, +x, floor, ceiling, -z, +z.
        backdrop: beyond the open sides and the windows.
        closed: how much of the scattered light the surroundings keep, 0 (open country) to 1 (a room).
    """

    low: Field
    high: Field
    sides: list[Finish]
    backdrop: Backdrop
    closed: float = 1.0
    boxes: list[Box] = field(default_factory=list)
    crowns: list[Crown] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)

    @property
    def is_room(self) -> bool:
        """Whether it has walls on all sides."""
        return bool(np.isfinite(self.low).all() and np.isfinite(self.high).all())


class Hits(NamedTuple):
    """Intersections of N rays from the eye: numbers of surfaces (sides, boxes, crowns, lamps; BEYOND for none)."""

    surface: Ids
    distance: Field
    place: Field
    normal: Field
    glass: Field | None  # [3, N], what a ray has passed through on its way beyond


@functools.lru_cache(maxsize=2)
def view_rays(supersampling: int) -> tuple[Field, Field]:
    """Rays [3, N] of a grid so many times finer than the maps, row by row, and their solid angles [N]."""
    height, width = MAP_HEIGHT_PX * supersampling, MAP_WIDTH_PX * supersampling
    rays = texel_directions(height, width).flatten(1).numpy()
    angles = solid_angles(height, width).expand(height, width).flatten().numpy()
    return rays, angles


def rotate_about_vertical(rays: Field, angle_rad: float) -> Field:
    """Directions [3, N] turned about the vertical."""
    cos, sin = np.float32(math.cos(angle_rad)), np.float32(math.sin(angle_rad))
    return np.stack([rays[0] * cos - rays[2] * sin, rays[1], rays[0] * sin + rays[2] * cos])


def invert_components(rays: Field) -> Field:
    """1 over each component, which is kept off zero."""
    result: Field = 1 / np.copysign(np.maximum(np.abs(rays), np.float32(1e-6)), rays)
    return result


def intersect_box(low: Field, high: Field, over: Field) -> tuple[Field, Field]:
    """Distances at which rays enter and leave a box, or would.

    Args:
        low: corner of the box from the ray's start [3], or [3, N].
        high: the opposite corner.
        over: 1 over the components of the rays' directions, [3, N], or [3, 1].

    Returns:
        Both [N]; a ray misses the box if the first is larger, or the second negative.
    """
    near: Field = np.array(-np.inf, np.float32)
    far = -near
    for axis in range(3):  # axis by axis, since small arrays stay in the processor's cache
        first, second = low[axis] * over[axis], high[axis] * over[axis]
        near, far = np.maximum(near, np.minimum(first, second)), np.minimum(far, np.maximum(first, second))
    return near, far


def cast_rays(scene: EnvironmentScene, rays: Field) -> Hits:
    """The first intersections of rays [3, N] from the eye."""
    over = invert_components(rays)
    ends = np.where(over > 0, scene.high[:, None], scene.low[:, None]) * over
    axis = ends.argmin(0)
    columns = np.arange(rays.shape[1])
    distance = np.minimum(ends[axis, columns], np.float32(_FAR))
    surface = np.where(distance < _FAR, 2 * axis + (over[axis, columns] > 0), NO_SURFACE)
    place = rays * distance
    glass = _open_windows(scene, surface, place)
    normal = np.zeros_like(rays)
    normal[axis, columns] = -np.sign(rays[axis, columns])
    number = len(ROOM_SIDES)
    for box in scene.boxes:
        near, far = intersect_box(box.low, box.high, over)
        seen = np.flatnonzero((near < far) & (near > 0) & (near < distance))
        distance[seen], surface[seen] = near[seen], number
        side = np.minimum(box.low[:, None] * over[:, seen], box.high[:, None] * over[:, seen]).argmax(0)
        normal[:, seen] = 0
        normal[side, seen] = -np.sign(rays[side, seen])
        number += 1
    for crown in scene.crowns:
        seen, near = _crown(crown, rays, distance)
        distance[seen], surface[seen] = near, number
        normal[:, seen] = (rays[:, seen] * near - crown.centre[:, None]) / np.float32(crown.radius)
        number += 1
    for lamp in scene.lamps:
        seen, near = _lamp(lamp, rays, distance)
        distance[seen], surface[seen] = near, number
        number += 1
    return Hits(surface, distance, rays * distance, normal, glass)


def _open_windows(scene: EnvironmentScene, surface: Ids, place: Field) -> Field | None:
    """Rays that leave through a window go BEYOND: changes `surface`, returns the glass that they pass."""
    if not scene.windows:
        return None
    glass = np.ones_like(place)
    for window in scene.windows:
        on_side = np.flatnonzero(surface == window.side)
        across, along = (place[axis, on_side] for axis in PLANE_AXES[window.side // 2])
        through = on_side[lies_in_glass(window, across, along)]
        surface[through] = NO_SURFACE
        glass[:, through] = window.glass[:, None]
    return glass


def lies_in_glass(window: Window, across: Field, along: Field) -> Mask:
    """Whether places on the window's side [N] are in its glass."""
    open_here = np.ones(across.shape, np.bool_)
    for values, low, high, panes in zip((across, along), window.low, window.high, window.bars, strict=True):
        share = (values - low) / np.float32(high - low)
        open_here &= (share > 0) & (share < 1)
        if panes > 1:
            open_here &= np.abs((share * panes) % 1 - np.float32(0.5)) < 0.5 - 0.04 * panes / (high - low)
    return open_here


def _crown(crown: Crown, rays: Field, before: Field) -> tuple[Ids, Field]:
    """Which rays meet leaves, and how far away: a ball with more and more holes to its rim."""
    middle = crown.centre @ rays
    apart = (float(crown.centre @ crown.centre) - middle**2) / np.float32(crown.radius**2)
    seen = np.flatnonzero((apart < 1) & (middle > 0) & (middle < before + crown.radius))
    depth = np.sqrt(1 - apart[seen])
    turn = np.arctan2(rays[2, seen], rays[0, seen]) * np.float32(0.5 / math.pi) * 3
    leaves = look_up_noise("leaves", turn + crown.radius, rays[1, seen])
    clumps = look_up_noise("rough", turn + crown.radius, rays[1, seen])
    dense = 0.6 * leaves + 1.1 * clumps > 1.9 - 4.5 * depth
    near = middle[seen] - crown.radius * depth
    dense &= (near > 0.3) & (near < before[seen])
    return seen[dense], near[dense]


def _lamp(lamp: Lamp, rays: Field, before: Field) -> tuple[Ids, Field]:
    """Which rays meet a lamp's front, and how far away."""
    normal, right, up = -lamp.centre, lamp.right, lamp.up
    if lamp.shape == "ball":
        right = np.cross(lamp.centre, vector(0.1, 1, 0.2))
        up = np.cross(lamp.centre, right)
    else:
        normal = np.cross(right, up)
    if normal @ lamp.centre >= 0:  # seen from behind
        return np.zeros(0, np.int64), np.zeros(0, np.float32)
    distance = float(normal @ lamp.centre) * invert_components(normal @ rays)
    apart = []
    for axis, half in zip((right, up), lamp.seen_halves, strict=True):
        axis = axis / np.float32(np.linalg.norm(axis) * half)
        apart.append(np.abs(axis @ rays * distance - float(axis @ lamp.centre)))
    within = np.maximum(*apart) if lamp.shape == "panel" else np.hypot(*apart)
    seen = np.flatnonzero((within < 1) & (distance > 0) & (distance < before + np.float32(0.05)))
    return seen, distance[seen]
