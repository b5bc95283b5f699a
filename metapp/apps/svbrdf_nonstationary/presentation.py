"""Non-stationary svBRDFs on screens and in files: maps, and what they look like under other lights."""

from __future__ import annotations

from typing import Any

import torch

from metapp.appearance.flash import Maps, unpack
from metapp.appearance.presentation import Kind, Picture, Visible
from metapp.appearance.surface import Surface
from metapp.apps.svbrdf_nonstationary import FINEST, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import displayed, fine_maps, photo_of, pooled, relit, sheet
from metapp.learning.task import Params, Task
from metapp.networks.presentation import CodedPresentation

LARGEST = 256  # px of the maps that are shown
KIND_OF: dict[str, Kind] = {"normal": "data", "roughness": "data"}  # all others are colours


class SvbrdfNonstationaryPresentation(CodedPresentation[SvbrdfNonstationary]):
    """The maps, as fine as the photograph, and pictures of them."""

    title = "svBRDF non-stat."
    measure = "mean absolute difference of log(radiance + 0.1) under 12 other lights, from elsewhere"
    image_measure = "renderings under 12 other lights: difference of logs, and SSIM at gamma 2.2"
    of_pictures = {"error": "log L1", "ssim": "SSIM"}  # noqa: RUF012  (never written to)

    @torch.no_grad()
    def outputs(self, theta: Params, task: Task) -> dict[str, Any]:
        """Four maps above what they look like under the flash and three other lights, beside those of the fit."""
        photo = photo_of(task, LARGEST)
        shown = {"fit": sheet(self.app.maps_of({key: value[None] for key, value in theta.items()}, photo), photo)}
        if "maps" in task.data:
            target = unpack(pooled(task.data["maps"].float(), photo.shape[-2:])[None])
            shown = {"reference": sheet(target, photo)} | shown
        return shown

    @torch.no_grad()
    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The maps, as fine as the photograph up to FINEST px, and pictures under three other lights."""
        maps = self._whole(theta, task)
        pictures = displayed(maps) | {f"lit_from_{name}": picture for name, picture in relit(maps).items()}
        return {
            name: Picture(picture.permute(1, 2, 0), KIND_OF.get(name, "srgb")) for name, picture in pictures.items()
        }

    @torch.no_grad()
    def surface(self, theta: Params, task: Task) -> Surface:
        """The maps as `files` writes them."""
        maps = self._whole(theta, task)
        return Surface(maps.diffuse[0], False, Maps(*(part[0] for part in maps)))

    def _whole(self, theta: Params, task: Task) -> Maps:
        """The maps [1, ...] of the size of files."""
        one = {key: value[None] for key, value in theta.items()}

        def make() -> Maps:
            photo = photo_of(task, FINEST)
            height, width = photo.shape[-2:]
            return fine_maps(self.app.field._replace(height=height, width=width), one, photo)

        return self.kept(theta, task, make)

    def visible(self, task: Task) -> Visible:
        """The maps or the photograph, all of it in each step; General's encoder reads the photograph alone."""
        if self.app.protocol == "photo":
            return Visible(1, task.data["photo"].nbytes, 1)
        return Visible(1, task.data["maps"].nbytes, 0)


PRESENTATION = SvbrdfNonstationaryPresentation
