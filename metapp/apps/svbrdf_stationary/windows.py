"""Parts of feature maps whose statistics are taken: windows, which overlap and fade, and rings about the centre.

The light of a flash is nearly even within a window, and at one distance from the centre.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from metapp.appearance.features import gram, hann_window
from metapp.appearance.flash import texel_positions

WINDOWS_PER_SIDE = 3  # windows along a side, each half as long as the side
WINDOW_COUNT = WINDOWS_PER_SIDE * WINDOWS_PER_SIDE


def grams_of_tasks(maps: Tensor, windows: list[list[int]]) -> Tensor:
    """Compute Gram matrices [T, S, N, C, C] of feature maps [T, S, C, H, W] in the N windows of each task."""
    if all(task_windows == windows[0] for task_windows in windows):  # one call for all tasks is quicker
        grams: Tensor = grams_in_windows(maps.flatten(0, 1), windows[0]).unflatten(0, maps.shape[:2])
        return grams
    return torch.stack(
        [grams_in_windows(task_maps, task_windows) for task_maps, task_windows in zip(maps, windows, strict=True)]
    )


def grams_in_windows(maps: Tensor, windows: Iterable[int]) -> Tensor:
    """Compute Gram matrices [B, N, C, C] of feature maps [B, C, H, W] in N windows, which fade towards their edges."""
    parts = [crop_window(maps, window) for window in windows]
    weights = fade_weights(parts[0])  # equal for all windows
    return torch.stack([gram(part * weights) for part in parts], 1)


def crop_window(maps: Tensor, window: int) -> Tensor:
    """Crop the window [..., H / 2, W / 2] of a number from maps [..., H, W].

    Windows are numbered row by row, WINDOWS_PER_SIDE in each, evenly spread from edge to edge, so that they overlap.
    """
    height, width = (size // 2 for size in maps.shape[-2:])
    top, left = (
        index * size // (WINDOWS_PER_SIDE - 1)
        for index, size in zip(divmod(window, WINDOWS_PER_SIDE), (height, width), strict=True)
    )
    return maps[..., top : top + height, left : left + width]


def fade_weights(window: Tensor) -> Tensor:
    """Return the weights [H, W] of texels of a window [..., H, W]: square roots, as Gram matrices are of products."""
    height, width = window.shape[-2:]
    weights = hann_window(height, window)[:, None] * hann_window(width, window)
    return (weights / weights.mean()).sqrt()


def mask_ring(maps: Tensor, low: float, high: float) -> Tensor:
    """Set feature maps [B, C, H, W] to 0 outside a ring about the centre, and divide them by the ring's share.

    Their mean over the picture is the mean in the ring then; their root mean square is the ring's, divided by the root
    of the ring's share.

    Args:
        maps: the feature maps.
        low, high: bounds of the squared distance from the centre, in half sides; the upper one is excluded.
    """
    squared = texel_positions(*maps.shape[-2:], dtype=maps.dtype, device=maps.device).square().sum(0)
    inside = ((squared >= low) & (squared < high)).to(maps)
    return maps * inside / inside.mean().clamp_min(1e-6)
