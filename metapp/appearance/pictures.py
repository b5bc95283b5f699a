"""Pictures that applications make of fits, as plain data.

Presenters make them and commands write them; both import this module, so that it knows neither.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

from torch import Tensor

from metapp.learning.task import Params

PictureKind = Literal["srgb", "data", "height", "radiance"]
PICTURE_KINDS: tuple[PictureKind, ...] = get_args(PictureKind)
CLIPPED_8BIT_VALUE = 250  # of 255: from this value on a photograph says no more than "so bright"
REFERENCE_ERROR_NAME = "reference"  # name, among measures of pictures, of the error that references have themselves


class Picture(NamedTuple):
    """A picture file that a fit makes.

    Attributes:
        pixels: [H, W, 1 or 3].
        kind: "srgb": colours, display values in [0, 1], kept as PNG. "data": linear and no colours, such as normals, in
            [0, 1], kept as PNG. "height": heights in texels, of any range, kept as PNG, stretched to [0, 1], with both
            ends as texts of the file. "radiance": linear RGB of any range, kept as EXR, and tone-mapped beside it.
    """

    pixels: Tensor
    kind: PictureKind


class ScenePictures(NamedTuple):
    """The pictures of a task's scene.

    Attributes:
        files: by the file's name without its ending.
        lines: remarks on them, to be printed.
    """

    files: dict[str, Picture]
    lines: list[str]


class PictureComparison(NamedTuple):
    """The pictures of a fit beside their references.

    Attributes:
        pictures: display values [B, 3, H, W] in [0, 1].
        references: display values [B, 3, H, W] in [0, 1].
        mask: which pixels count, bool [H, W]; None if all do.
    """

    pictures: Tensor
    references: Tensor
    mask: Tensor | None = None


def photo_error_percent(compared: PictureComparison) -> float:
    """Return the mean difference of pictures and references in 8 bits, in % of white, where the references do not clip.

    >>> import torch
    >>> gray = torch.full((1, 3, 2, 2), 0.5)
    >>> photo_error_percent(PictureComparison(gray, gray + 0.1))
    9.803921568627452
    >>> photo_error_percent(PictureComparison(gray, gray + 0.5))
    0.0
    """
    pictures, references = ((images.clamp(0, 1) * 255).round() for images in compared[:2])
    is_counted = (references < CLIPPED_8BIT_VALUE).all(1)
    if compared.mask is not None:
        is_counted = is_counted & compared.mask
    differences = (pictures - references).abs().mean(1)[is_counted]
    return float(differences.double().mean()) * 100 / 255 if len(differences) else 0.0


class TimedFit(NamedTuple):
    """A fit of one task, and how long it took.

    Attributes:
        theta: the fitted parameters, without a task axis.
        seconds: seconds of inference.
    """

    theta: Params
    seconds: float
