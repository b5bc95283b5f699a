"""Photographs of an object under many lamps, as an asset: they predict how it looks under other lamps."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.assets import Asset
from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.pictures import Picture
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.rti.light_process import LightProcess, choose_process, mix_photos
from metapp.learning.task import Params, Task


@dataclass(frozen=True, eq=False)
class LitPhotos(Asset):
    """Photographs by a camera that stands still, each under another distant lamp.

    Attributes:
        photos: the photographs, sRGB uint8 [N, 3, H, W].
        lamps: unit vectors towards their lamps, [N, 3]: x right, y up, z towards the camera.
    """

    kind = "lit photos"
    photos: Tensor
    lamps: Tensor

    @functools.cached_property
    def process(self) -> LightProcess:
        """The process that best predicts each photograph by all others."""
        return choose_process(self.photos, self.lamps)

    @torch.no_grad()
    def relight(self, directions: Tensor) -> Tensor:
        """Return the object as its photographs predict it: with shadows and reflections, which maps do not say.

        Args:
            directions: unit vectors towards K lamps, one at a time, [K, 3].

        Returns:
            Linear RGB pictures [K, 3, H, W] in [0, 1].
        """
        weights = self.process.interpolation(directions, self.lamps)
        return srgb_to_linear(mix_photos(weights, self.photos).clamp(0, 1))

    @override
    def pictures(self) -> dict[str, Picture]:
        return {}

    @override
    def preview(self) -> Tensor:
        """Return the object under a lamp straight above, linear RGB [H, W, 3]."""
        return self.relight(self.lamps.new_tensor([[0.0, 0.0, 1.0]]))[0].permute(1, 2, 0)


def make_lit_photos(app: SvbrdfNonstationary, theta: Params, task: Task, size: tuple[int, int] | None) -> LitPhotos:
    """Return the photographs of a fit of an object under many lamps; see :class:`metapp.application.MakeAsset`.

    Raises:
        KeyError: the task's data are not at hand.
        ValueError: the fit saw other photographs or maps.
    """
    lit_photos: LitPhotos | None = app.sight.lit_photos(task)
    if lit_photos is None:
        raise ValueError(
            f"{task.name}: a fit of flash photos or maps, expected one of photos under many lamps, by the recipe rti; "
            "fit a folder with a text .lp of light directions; export gltf, mitsuba or another material of this one."
        )
    return lit_photos
