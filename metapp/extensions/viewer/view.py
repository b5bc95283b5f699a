"""The content of a page for one fit: numbers and pictures, and which of the page's viewers shows them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Never

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.latlong import texel_directions
from metapp.appearance.presenter import Presenter
from metapp.appearance.sphere import environment_radiance
from metapp.learning.task import Params, Task
from metapp.registry import registry

MAX_THUMBNAIL_PX = 80  # px of a side of the pictures in the list of fits
NO_ENTRIES: Mapping[str, Never] = MappingProxyType({})


class View(NamedTuple):
    """One fit, as a viewer of the page reads it.

    Attributes:
        kind: the viewer, one of `page.KINDS`; the text at the head of its script says its input.
        arrays: numbers of float16, float32 or uint8, by name.
        pictures: display values [H, W, 1, 3 or 4] in [0, 1], by name, kept as PNG of 8 bits; the fourth is coverage.
        facts: entries of JSON.
        shared: arrays that are the same for all fits of a page that name them.
        thumbnail: display values [h, w, 3] of the fit in the list, small; None for none.
        label: a word that tells it from others beside it, such as the paradigm.
        caption: error, seconds and the like.
    """

    kind: str
    arrays: Mapping[str, Tensor] = NO_ENTRIES
    pictures: Mapping[str, Tensor] = NO_ENTRIES
    facts: Mapping[str, object] = NO_ENTRIES
    shared: Mapping[str, Tensor] = NO_ENTRIES
    thumbnail: Tensor | None = None
    label: str = ""
    caption: str = ""


def make_view(presenter: Presenter[Any], theta: Params, task: Task) -> View:
    """The view of a fit as its application's page makes it: its pictures, if the application has no page.

    Args:
        presenter: of the application.
        theta: the fit, without a task axis.
        task: of the fit, without data if that is not at hand.

    Raises:
        KeyError: the fit alone is not enough.
    """
    if page := registry().pages.get(presenter.app.name):
        view: View = page.load()(presenter, theta, task)
        return view
    return make_pictures_view(presenter.preview(theta, task))


def make_pictures_view(outputs: Mapping[str, np.ndarray | Tensor]) -> View:
    """The view of linear pictures, as of `Presenter.preview`."""
    shown = {name: torch.from_numpy(composite_to_srgb(pixels)) for name, pixels in outputs.items()}
    return View("pictures", pictures=shown, thumbnail=thumbnail(shown["fit"]) if "fit" in shown else None)


def thumbnail(pixels: Tensor) -> Tensor:
    """The central square of display values [H, W, 1, 3 or 4], as [h, h, 3], THUMBNAIL px a side at most."""
    height, width = pixels.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = pixels[top : top + side, left : left + side, :3].permute(2, 0, 1).float().clamp(0, 1)
    small = adaptive_avg_pool2d(square, min(side, MAX_THUMBNAIL_PX))
    return small.expand(3, -1, -1).permute(1, 2, 0)


def reference_light_map() -> Tensor:
    """The environment of the reference sphere as a page's light map, [64, 128, 3], float16."""
    return environment_radiance(texel_directions(64, 128).permute(1, 2, 0)).half()
