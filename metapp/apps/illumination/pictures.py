"""Maps of light as pictures."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.appearance.colour import srgb_to_linear, tone_map
from metapp.rendering.second_scene import relighting


def overview(maps: Tensor, photo: Tensor) -> Tensor:
    """One linear picture: the map above the second scene, and the photograph in the corner beside that."""
    lit = tone_map(relighting.relight(maps))[0]
    height, width = lit.shape[1:]
    across = width // 3
    whole = interpolate(tone_map(maps), size=(2 * across, 4 * across), mode="nearest")[0]
    column = torch.ones(3, height, across)
    column[:, :across] = avg_pool2d(photo.float() / 255, photo.shape[-1] // across)[0, :, :across, :across]
    pictures = torch.cat([whole, torch.cat([lit, column], 2)], 1)
    return srgb_to_linear(pictures).permute(1, 2, 0)
