"""The content of a page for one fit: numbers and pictures, and which of the page's viewers shows them.

An application's view is made by its `page`. This module does not know how a page is written; the text at the head
of each viewer's script states which arrays, pictures and facts the viewer reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, Never

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.latlong import texel_directions
from metapp.appearance.sphere import environment_radiance
from metapp.registry import registry
from metapp.runs.fit import Fit

MAX_THUMBNAIL_PX = 80  # side of the pictures in the list of fits
MAX_HALF_FLOAT = 65504.0  # the greatest finite number of float16
NO_ENTRIES: Mapping[str, Never] = MappingProxyType({})


class View(NamedTuple):
    """The content of a page for one fit, as a viewer of the page reads it.

    Attributes:
        kind: the name of the viewer, one of `viewer_page.VIEWER_KINDS`.
        arrays: numbers of float16, float32 or uint8, by name.
        pictures: display values [H, W, 1, 3 or 4] in [0, 1], by name, kept as PNG of 8 bits; the fourth channel is
            coverage.
        lossy: names of pictures of three channels that are kept as JPEG, as PNG would take too much room.
        facts: values that JSON can hold, by name.
        shared: arrays by name that are equal for all fits of a page, which keeps each of them once.
        thumbnail: small display values [h, w, 3] for the list of fits; None for no picture.
        label: a word that tells the fit from others beside it, such as the paradigm.
        caption: a line on the fit, such as its error and seconds.
    """

    kind: str
    arrays: Mapping[str, Tensor] = NO_ENTRIES
    pictures: Mapping[str, Tensor] = NO_ENTRIES
    facts: Mapping[str, object] = NO_ENTRIES
    shared: Mapping[str, Tensor] = NO_ENTRIES
    thumbnail: Tensor | None = None
    lossy: tuple[str, ...] = ()
    label: str = ""
    caption: str = ""


def make_view(fit: Fit) -> View:
    """Make the view of a fit by the page of its type of asset, else a view of its pictures.

    Args:
        fit: the fit, whose task has no data if they are not at hand.

    Raises:
        KeyError: the view needs data that the task lacks.
    """
    kind = next(iter(fit.spec.application.assets), "")
    if page := registry().pages.get(kind):
        view: View = page.load()(fit)
        return view
    return make_pictures_view(fit.preview())


def make_pictures_view(outputs: Mapping[str, np.ndarray | Tensor]) -> View:
    """Make a view of linear pictures, by name.

    Args:
        outputs: linear pictures [H, W, 3 or 4], see :meth:`metapp.appearance.presenter.Presenter.preview`; the picture
            named "fit" is the thumbnail.
    """
    pictures = {name: torch.from_numpy(composite_to_srgb(pixels)) for name, pixels in outputs.items()}
    return View("pictures", pictures=pictures, thumbnail=crop_thumbnail(pictures["fit"]) if "fit" in pictures else None)


def crop_thumbnail(pixels: Tensor) -> Tensor:
    """Crop display values [H, W, 1, 3 or 4] to their central square, reduced to at most MAX_THUMBNAIL_PX a side.

    Returns:
        Display values [h, h, 3]; coverage is left out.
    """
    height, width = pixels.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = pixels[top : top + side, left : left + side, :3].permute(2, 0, 1).float().clamp(0, 1)
    small = adaptive_avg_pool2d(square, min(side, MAX_THUMBNAIL_PX))
    return small.expand(3, -1, -1).permute(1, 2, 0)


def channels_last(pixels: Tensor) -> Tensor:
    """Return a picture [C, H, W] as [H, W, C]."""
    return pixels.permute(1, 2, 0)


def size_within(largest: int, values: Tensor) -> tuple[int, int]:
    """Return height and width of values [..., H, W], reduced in proportion to at most `largest` a side."""
    height, width = values.shape[-2:]
    share = min(1.0, largest / max(height, width))
    return max(1, round(share * height)), max(1, round(share * width))


def reference_light_map() -> Tensor:
    """Return the environment of the reference sphere as a light map for pages, [64, 128, 3], float16."""
    return environment_radiance(texel_directions(64, 128).permute(1, 2, 0)).half()
