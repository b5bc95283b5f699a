"""Non-stationary svBRDFs, maps of a flat material from photographs under a flash (paper section 4.1.4: one photograph).

What parameters mean, what a fit sees, and how it is judged are components: the maps themselves (`maps_sight`) or one
photograph (`photo_sight`) with maps by a field (`field_maps`), one photograph by features of VGG-16 (`pretrained`), and
several photographs with maps of texels (`multi_photo`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d
from typing_extensions import override

from metapp.apps.svbrdf_nonstationary.flashes import photograph_by
from metapp.apps.svbrdf_nonstationary.map_judge import MapJudge
from metapp.apps.svbrdf_nonstationary.maps import decode_photo, pool_maps, scale_size
from metapp.apps.svbrdf_nonstationary.material_sight import MaterialSight, photographed_size
from metapp.apps.svbrdf_nonstationary.photographed_maps import MaterialAnswer, MaterialDecoder
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Params, Task, Tasks, TensorSpec, add_task_axis

FINEST_PX = 2048  # longest side at which a user's photograph is read


@dataclass(frozen=True)
class SvbrdfNonstationary(App):
    """The application of non-stationary svBRDFs: a task is one flat material, photographed with a flash.

    A task has `photo`, taken from straight above with the flash beside the lens, maybe `others`, further photographs,
    and `places`, the positions of camera and flash of all of them. Where they are known, it has the material's `maps`,
    maybe with `map_weights`, by which the recipe `pretrained` alone leaves made-up maps out of its outer loss, and
    `predicted`, another method's maps.

    Attributes:
        read_px: the side, in px, at which a user's photographs are read; 0 leaves it to the readers.
    """

    decoder: MaterialDecoder[Any, Any]
    sight: MaterialSight[Any, Any]
    judge: MapJudge
    read_px: int = 0

    name = "svbrdf_nonstationary"
    small_tensors = deterministic = True
    error_measure = ErrorMeasure(
        "mean absolute difference of log(radiance + 0.1) under 12 other lights, from elsewhere",
        further={
            "normal": "normals, degrees",
            "diffuse": "diffuse at gamma 2.2",
            "roughness": "roughness",
            "specular": "specular at gamma 2.2",
        },
    )
    tensors: ClassVar = {
        "photo": TensorSpec((3, "S", "S"), "uint8"),
        "maps": TensorSpec((10, "M", "M"), low=-1.001, high=1.001, optional=True),
        "others": TensorSpec(("K", 3, "S", "S"), "uint8", optional=True),
        "predicted": TensorSpec((10, "M", "M"), low=-1.001, high=1.001, optional=True),
        "places": TensorSpec(("N", 2, 3), low=-1e3, high=1e3, optional=True),
        "map_weights": TensorSpec((4,), low=0.0, optional=True),
        "lit": TensorSpec(("L", 3, "S", "S"), "uint8", optional=True),
        "lamps": TensorSpec(("L", 3), low=-1.001, high=1.001, optional=True),
    }

    @property
    @override
    def read_size(self) -> int:
        return self.read_px

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add, where maps are known, what no fit sees.

        Returns:
            Beside what the sight and the judge prepare, `fine` [10, F, F], half precision, which augmented materials
            are made of; `predicted` [10, H, W], the maps of another method.
        """
        prepared = super().prepare(task)
        if "maps" not in task.data:
            return prepared
        maps = task.data["maps"].float()
        # twice as large as they are photographed, to have room for crops
        fine_side = min(maps.shape[-1], 2 * photographed_size(self.decoder.size[0]))
        prepared["fine"] = pool_maps(maps, (fine_side, fine_side)).half()
        if "predicted" in task.data:
            prepared["predicted"] = pool_maps(task.data["predicted"].float(), self.decoder.size)
        return prepared

    def decode(self, theta: Params, task: Task, photo: Tensor) -> MaterialAnswer:
        """Return the answer of one fit at the size of a linear photograph [1, 3, h, w], with a task axis.

        Args:
            theta: the parameters of the fit, without a task axis.
            task: the task of the fit, which states where cameras were.
            photo: the photograph of the task, at any size.

        Raises:
            ValueError: the fit, which anybody may have written, is not of the task.
        """
        try:
            answer: MaterialAnswer = self.decoder.decode(
                add_task_axis(theta), photo, self.sight.read_cameras(task)[None]
            )
        except ValueError as error:
            raise ValueError(f"{task.name}: {error}") from None
        return answer

    @torch.no_grad()
    def rerender_photos(self, theta: Params, task: Task, shorter: int) -> tuple[Tensor, Tensor] | None:
        """Return what a fit says of each photograph of its task, and the photographs, linear [N, 3, H, W].

        Here these are renderings of the maps under each flash, as the fit places it; None if fits see no photograph.

        Args:
            theta: the parameters of the fit, without a task axis.
            task: the task of the fit.
            shorter: the shorter side of both in px.
        """
        photos = self.sight.photos(task)
        if photos is None:
            return None
        photos = adaptive_avg_pool2d(decode_photo(photos), scale_size(photos, shorter))
        answer = self.decode(theta, task, photos[:1])
        maps = self.sight.fill(answer, photos[:1])
        return torch.stack([photograph_by(flash, maps) for flash in answer.flash_of_each_photo()]), photos

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Vary the materials, and photograph them anew. Raises ValueError if a task has no maps."""
        self.judge.require(tasks)
        seen, truth = self.sight.augment(tasks, self.decoder.size[0], rng)
        return tasks.make_variants(seen._asdict() | truth._asdict())
