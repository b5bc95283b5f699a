"""Error measures of pictures."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from metapp.appearance.colour import tone_map

DARK = 0.01  # of the reference's mean: what is darker counts as if it were as bright


def mape(pictures: Tensor, references: Tensor) -> Tensor:
    """Mean absolute percentage error, as a share: mean |p - r| / max(r, 1 % of r's mean).

    Args:
        pictures: linear, [T, C, H, W].
        references: what they should be, of the same shape.

    Returns:
        [T].
    """
    return ((pictures - references).abs() / references.clamp_min(_floor(references))).mean((1, 2, 3))


def smape(pictures: Tensor, references: Tensor) -> Tensor:
    """Symmetric mean absolute percentage error, as a share in [0, 2]: mean 2 |p - r| / (p + r), of `mape`'s shapes.

    Pixels where both are darker than 1 % of the reference's mean count as if they were as bright.
    """
    total = (pictures.abs() + references.abs()).maximum(2 * _floor(references))
    return (2 * (pictures - references).abs() / total).mean((1, 2, 3))


def dssim(pictures: Tensor, references: Tensor) -> Tensor:
    """Structural dissimilarity, 1 - SSIM (Wang et al. 2004) of tone-mapped pictures at equal exposure: [T] in [0, 2].

    Both are divided by the reference's mean before; shapes as of `mape`.
    """
    # takes half a second to import
    from torchmetrics.functional.image import structural_similarity_index_measure

    exposure = references.mean((1, 2, 3), keepdim=True).clamp_min(torch.finfo(references.dtype).tiny)
    shown, wanted = tone_map(pictures / exposure), tone_map(references / exposure)
    found: Any = structural_similarity_index_measure(shown, wanted, data_range=1.0, reduction=None)
    result: Tensor = 1 - found.reshape(-1)
    return result


def _floor(references: Tensor) -> Tensor:
    tiny = torch.finfo(references.dtype).tiny
    return (DARK * references.mean((1, 2, 3), keepdim=True)).clamp_min(tiny)
