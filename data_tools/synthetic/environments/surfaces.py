"""The look of surfaces at intersections: albedo, mirroring, and light of their own."""

from __future__ import annotations

import math

import numpy as np

from data_tools.synthetic.environments.patterns import hash_numbers, look_up_noise
from data_tools.synthetic.environments.scene_geometry import (
    NO_SURFACE,
    PLANE_AXES,
    EnvironmentScene,
    Finish,
    Hits,
    Mask,
)
from data_tools.synthetic.random_values import Field, Ids

_TEXEL_RAD = 0.03  # about how far rays are apart
_PANE_ALBEDO, _PANE_GLOSS = np.float32(0.03), np.float32(0.12)  # of a facade's windows


def surface_properties(scene: EnvironmentScene, hits: Hits, rays: Field) -> tuple[Field, Field, Field]:
    """Albedo [3, N], the share [N] that is mirrored straight ahead, and radiance of its own [3, N]; 0 beyond."""
    albedo, gloss, glow = np.zeros_like(rays), np.zeros(rays.shape[1], np.float32), np.zeros_like(rays)
    finishes = [*scene.sides, *(box.finish for box in scene.boxes)]
    order = np.argsort(hits.surface, kind="stable")
    numbers, starts = np.unique(hits.surface[order], return_index=True)
    for number, members in zip(numbers.tolist(), np.split(order, starts[1:]), strict=True):
        crown, lamp = number - len(finishes), number - len(finishes) - len(scene.crowns)
        if number == NO_SURFACE:
            continue
        if crown < 0:
            finish = finishes[number]
            albedo[:, members], panes, lit = _finished(finish, hits, rays, members)
            gloss[members] = np.where(panes, _PANE_GLOSS, np.float32(finish.gloss))
            glow[:, members] = finish.lit[:, None] * lit
        elif lamp < 0:
            turn = np.arctan2(rays[2, members], rays[0, members]) * np.float32(2 / math.pi)
            leaves = look_up_noise("rough", turn + scene.crowns[crown].radius, 2 * rays[1, members])
            albedo[:, members] = scene.crowns[crown].colour[:, None] * np.exp(np.float32(0.4) * leaves)
        else:
            glow[:, members] = scene.lamps[lamp].seen_radiance[:, None]
    return np.clip(albedo, 0, 0.9), gloss, glow


def _finished(finish: Finish, hits: Hits, rays: Field, members: Ids) -> tuple[Field, Mask, Mask]:
    """Albedo [3, M] of one surface's hits, which are windows, and which are lit, both [M]."""
    place, normal = hits.place[:, members], hits.normal[:, members]
    axis, columns = np.abs(normal).argmax(0), np.arange(len(members))
    across, along = (place[np.array(PLANE_AXES)[axis, which], columns] for which in (0, 1))
    albedo = np.repeat(finish.colour[:, None], len(members), 1)
    if finish.other is not None:
        facing = np.maximum(np.abs((rays[:, members] * normal).sum(0)), np.float32(0.1))
        footprint = hits.distance[members] / facing * np.float32(_TEXEL_RAD / 0.12 / finish.size)
        weight = 0.5 + (_pattern(finish, across, along) - 0.5) / (1 + footprint**2)  # no finer than texels
        albedo += (finish.other - finish.colour)[:, None] * weight
    if finish.panes is None:
        none = np.zeros(len(members), np.bool_)
        return albedo, none, none
    row, column = along / np.float32(finish.panes[0]), across / np.float32(finish.panes[1])
    apart = np.maximum(
        *(np.abs(at % 1 - 0.5) / (share / 2) for at, share in zip((row, column), finish.glazed, strict=True))
    )
    panes = (apart < 1) & (axis != 1)
    lit = panes & (hash_numbers(np.floor(row) * 1009 + np.floor(column), 0.5) < 0.3)
    return np.where(panes, _PANE_ALBEDO, albedo), panes, lit


def _pattern(finish: Finish, across: Field, along: Field) -> Field:
    """How far a finish goes from its colour to the other, [N] in [0, 1]."""
    across, along = across / np.float32(finish.size), along / np.float32(finish.size)
    if finish.pattern == "tiles":
        result: Field = (np.maximum(np.abs(across % 1 - 0.5), np.abs(along % 1 - 0.5)) > 0.46).astype(np.float32)
        return result
    if finish.pattern == "chequers":
        return ((np.floor(across) + np.floor(along)) % 2).astype(np.float32)
    if finish.pattern == "stripes":
        return (across % 1 > 0.5).astype(np.float32)
    if finish.pattern == "patches":
        return hash_numbers(np.floor(8 * across) * 1009 + np.floor(8 * along), 0.5)
    result = np.clip(np.float32(0.5) + np.float32(0.3) * look_up_noise(finish.pattern, across, along), 0, 1)
    return result
