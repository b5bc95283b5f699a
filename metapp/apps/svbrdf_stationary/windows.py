"""Statistics of features in parts of a picture: Gram matrices in windows, and rings about its centre."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from metapp.appearance.features import gram, hann_window
from metapp.appearance.flash import texel_positions

WINDOWS_PER_SIDE = 3  # windows along a side


def grams_of_tasks(maps: Tensor, windows: list[list[int]]) -> Tensor:
    """Compute Gram matrices [T, S, N, C, C] of feature maps [T, S, C, H, W] in N windows of each task."""
    if all(drawn == windows[0] for drawn in windows):  # as where one generator drew them: in one go
        together: Tensor = grams_in_windows(maps.flatten(0, 1), windows[0]).unflatten(0, maps.shape[:2])
        return together
    return torch.stack([grams_in_windows(own, drawn) for own, drawn in zip(maps, windows, strict=True)])


def grams_in_windows(maps: Tensor, windows: Iterable[int]) -> Tensor:
    """Compute Gram matrices [B, N, C, C] of feature maps [B, C, H, W] in N windows, which fade towards their edges."""
    parts = [crop_window(maps, window) for window in windows]
    weights = fade_weights(parts[0])  # the same for all
    return torch.stack([gram(part * weights) for part in parts], 1)


def crop_window(maps: Tensor, window: int) -> Tensor:
    """Return a window [..., H / 2, W / 2] of maps [..., H, W], by its number.

    Windows are numbered row by row, GRID in each, evenly spread from edge to edge: they overlap.
    """
    height, width = (size // 2 for size in maps.shape[-2:])
    top, left = (
        i * size // (WINDOWS_PER_SIDE - 1)
        for i, size in zip(divmod(window, WINDOWS_PER_SIDE), (height, width), strict=True)
    )
    return maps[..., top : top + height, left : left + width]


def fade_weights(part: Tensor) -> Tensor:
    """Return the weights [H, W] of the texels of a window [..., H, W]: roots of their weight in products."""
    height, width = part.shape[-2:]
    weights = hann_window(height, part)[:, None] * hann_window(width, part)
    return (weights / weights.mean()).sqrt()


def mask_ring(maps: Tensor, low: float, high: float) -> Tensor:
    """Return feature maps [B, C, H, W] where the squared distance from the centre is in [low, high), 0 elsewhere.

    They are scaled so that their mean over the picture is the mean in the ring.
    """
    squared = texel_positions(*maps.shape[-2:], dtype=maps.dtype, device=maps.device).square().sum(0)
    inside = ((squared >= low) & (squared < high)).to(maps)
    return maps * inside / inside.mean().clamp_min(1e-6)
