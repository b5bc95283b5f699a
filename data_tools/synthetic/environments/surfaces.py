"""The look of surfaces at intersections: albedo, mirroring, and light of their own.

Light that comes from elsewhere is not known here; `light` multiplies it with these albedos.
"""

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

_TEXEL_RAD = 0.03  # rad, about the angle between neighbouring texels
_PANE_ALBEDO, _PANE_GLOSS = np.float32(0.03), np.float32(0.12)  # of a facade's windows


def surface_properties(scene: EnvironmentScene, hits: Hits, rays: Field) -> tuple[Field, Field, Field]:
    """Return what hits of surfaces reflect and send.

    Returns:
        Albedo [3, N], the share [N] that is mirrored straight ahead, and radiance of lamps and lit windows [3, N]; all
            0 where no surface is hit.
    """
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
            albedo[:, members], panes, lit_panes = _finish_properties(finish, hits, rays, members)
            gloss[members] = np.where(panes, _PANE_GLOSS, np.float32(finish.gloss))
            glow[:, members] = finish.window_radiance[:, None] * lit_panes
        elif lamp < 0:
            turn = np.arctan2(rays[2, members], rays[0, members]) * np.float32(2 / math.pi)
            leaves = look_up_noise("rough", turn + scene.crowns[crown].radius, 2 * rays[1, members])
            albedo[:, members] = scene.crowns[crown].colour[:, None] * np.exp(np.float32(0.4) * leaves)
        else:
            glow[:, members] = scene.lamps[lamp].seen_radiance[:, None]
    return np.clip(albedo, 0, 0.9), gloss, glow


def _finish_properties(finish: Finish, hits: Hits, rays: Field, members: Ids) -> tuple[Field, Mask, Mask]:
    """Return the albedo [3, M] at hits of one surface, which of them are windows, and which are lit, both [M]."""
    positions, normal = hits.place[:, members], hits.normal[:, members]
    axis, columns = np.abs(normal).argmax(0), np.arange(len(members))
    across, along = (positions[np.array(PLANE_AXES)[axis, direction], columns] for direction in (0, 1))
    albedo = np.repeat(finish.colour[:, None], len(members), 1)
    if finish.second_colour is not None:
        facing = np.maximum(np.abs((rays[:, members] * normal).sum(0)), np.float32(0.1))
        footprint = hits.distance[members] / facing * np.float32(_TEXEL_RAD / 0.12 / finish.size)
        weight = 0.5 + (_pattern_weight(finish, across, along) - 0.5) / (1 + footprint**2)  # finer patterns fade
        albedo += (finish.second_colour - finish.colour)[:, None] * weight
    if finish.window_spacing_m is None:
        no_windows = np.zeros(len(members), np.bool_)
        return albedo, no_windows, no_windows
    row, column = along / np.float32(finish.window_spacing_m[0]), across / np.float32(finish.window_spacing_m[1])
    pane_offset = np.maximum(
        *(
            np.abs(position % 1 - 0.5) / (share / 2)
            for position, share in zip((row, column), finish.window_share, strict=True)
        )
    )
    panes = (pane_offset < 1) & (axis != 1)
    lit_panes = panes & (hash_numbers(np.floor(row) * 1009 + np.floor(column), 0.5) < 0.3)
    return np.where(panes, _PANE_ALBEDO, albedo), panes, lit_panes


def _pattern_weight(finish: Finish, across: Field, along: Field) -> Field:
    """Return the weight [N] in [0, 1] of a finish's other colour at places [N] across and along its surface."""
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
