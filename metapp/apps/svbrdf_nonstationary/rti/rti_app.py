"""The application of non-stationary svBRDFs from photographs under many lamps, whose fits can be relit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import decode_photo, normalise, scale_size
from metapp.apps.svbrdf_nonstationary.rti.curve_network import TexelAnswer, answer_of
from metapp.apps.svbrdf_nonstationary.rti.light_process import mix_photos
from metapp.learning.task import Params, Task, TensorSpec, add_task_axis


@dataclass(frozen=True)
class RtiApp(SvbrdfNonstationary):
    """The application of photographs under many lamps."""

    small_tensors = False  # all values of a texel under all lamps; and each number of lamps would be compiled anew
    tensors: ClassVar = {
        **SvbrdfNonstationary.tensors,
        "photo": TensorSpec((3, "H", "W"), "uint8"),
        "lit": TensorSpec(("L", 3, "H", "W"), "uint8"),
        "lamps": TensorSpec(("L", 3), low=-1.001, high=1.001),
        "maps": TensorSpec((10, "H", "W"), low=-1.001, high=1.001, optional=True),
    }

    @override
    @torch.no_grad()
    def decode(self, theta: Params, task: Task, photo: Tensor) -> TexelAnswer:
        """Return maps at the size of `photo`, by photographs that are averaged to it, or else interpolated."""
        size = photo.shape[-2:]
        if size[0] < task.data["lit"].shape[-2]:
            task = task._replace(
                data=task.data | {name: _pool_photos(task.data[name], size) for name in ("lit", "photo")}
            )
        seen = self.sight.seen_type(*(value[None] for value in self.sight.prepare(task, self.decoder)))
        maps = self.sight.fill(self.decoder(add_task_axis(theta), seen), seen.photo)
        if size != maps.normal.shape[-2:]:
            maps = Maps(*(interpolate(part, size, mode="bilinear") for part in maps))
        return answer_of(maps._replace(normal=normalise(maps.normal)))

    @override
    @torch.no_grad()
    def rerender_photos(self, theta: Params, task: Task, shorter: int) -> tuple[Tensor, Tensor]:
        """Return each photograph as all others predict it, and the photographs, linear [N, 3, H, W]."""
        lit_photos = self.sight.lit_photos(task)
        photos = _pool_photos(lit_photos.photos, scale_size(lit_photos.photos, shorter))
        weights = lit_photos.process.leaving_one_out(lit_photos.lamps)
        return srgb_to_linear(mix_photos(weights, photos).clamp(0, 1)), decode_photo(photos)


def _pool_photos(photos: Tensor, size: Sequence[int]) -> Tensor:
    """Average the linear values of photographs, sRGB uint8 [..., 3, H, W], over areas to another size."""
    pooled = [
        adaptive_avg_pool2d(decode_photo(photo), (size[0], size[1])) for photo in photos.reshape(-1, *photos.shape[-3:])
    ]
    display = (linear_to_srgb(torch.stack(pooled)) * 255).round().to(torch.uint8)
    return display.reshape(*photos.shape[:-2], *size)
