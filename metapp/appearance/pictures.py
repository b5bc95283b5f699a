"""Pictures that applications make of fits, as plain data."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

from torch import Tensor

from metapp.learning.task import Params

PictureKind = Literal["srgb", "data", "height", "radiance"]
PICTURE_KINDS: tuple[PictureKind, ...] = get_args(PictureKind)
CLIPPED_8BIT_VALUE = 250  # of 255, from which a photograph says no more
REFERENCE_ERROR_NAME = "reference"  # among measures of pictures: what the references are off by themselves


class Picture(NamedTuple):
    """A file that a fit makes.

    Attributes:
        pixels: [H, W, 1 or 3].
        kind: "srgb": colours, display values in [0, 1], kept as PNG. "data": linear and no colours, such as normals, in
            [0, 1], kept as PNG. "height": heights in texels, of any range, kept as PNG, stretched to [0, 1], with both
            ends as texts of the file. "radiance": linear RGB of any range, kept as EXR, and tone-mapped beside it.
    """

    pixels: Tensor
    kind: PictureKind


class ScenePictures(NamedTuple):
    """Pictures of a task's scene.

    Attributes:
        files: by the file's name without its ending.
        lines: remarks on them, to be printed.
    """

    files: dict[str, Picture]
    lines: list[str]


class PictureComparison(NamedTuple):
    """Pictures of a fit and their references: display values [B, 3, H, W] in [0, 1].

    The bool `mask` [H, W] says which pixels count; None: all.
    """

    pictures: Tensor
    references: Tensor
    mask: Tensor | None = None


def photo_error_percent(compared: PictureComparison) -> float:
    """Mean difference of pictures and references in 8 bits, % of white, where the references do not clip.

    >>> import torch
    >>> one = torch.full((1, 3, 2, 2), 0.5)
    >>> photo_error(Compared(one, one + 0.1)), photo_error(Compared(one, one + 0.5))
    (9.803921568627452, 0.0)
    """
    pictures, references = ((each.clamp(0, 1) * 255).round() for each in compared[:2])
    counts = (references < CLIPPED_8BIT_VALUE).all(1)
    if compared.mask is not None:
        counts = counts & compared.mask
    apart = (pictures - references).abs().mean(1)[counts]
    return float(apart.double().mean()) * 100 / 255 if len(apart) else 0.0


class VisibleData(NamedTuple):
    """The part of a task that a fit may see.

    Attributes:
        samples: how many it draws from; 1 if each step sees all there is.
        size: bytes of one, as data sets keep it.
        encoder: samples that General's encoder reads of these.
    """

    samples: int
    size: int
    encoder: int


class TimedFit(NamedTuple):
    """A fit of one task: parameters without task axis, and the seconds of inference that it took."""

    theta: Params
    seconds: float
