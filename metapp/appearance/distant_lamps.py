"""Maps under distant lamps, one at a time, as a distant camera straight above sees them."""

from __future__ import annotations

import math

from torch import Tensor

from metapp.appearance.flash import evaluate_brdf
from metapp.appearance.svbrdf_maps import Maps


def render_lit(maps: Maps, lamps: Tensor) -> Tensor:
    """Return linear radiance [T, N, 3, P] of texels [T, C, P, 1] under distant lamps, seen from straight above.

    A white matt texel that faces the lamp has 1.

    Args:
        maps: maps of texels, [T, C, P, 1].
        lamps: unit vectors towards the lamps, [T, N, 3]: x right, y up, z towards the camera.
    """
    normal = maps.normal[:, None]
    light = lamps[..., None, None].expand(-1, -1, -1, *normal.shape[-2:])
    view = light.new_tensor([0.0, 0.0, 1.0])[:, None, None].expand_as(light)
    cosine = (light * normal).sum(2, keepdim=True).clamp_min(0)
    return (math.pi * evaluate_brdf(Maps(*(part[:, None] for part in maps)), light, view) * cosine)[..., 0]
