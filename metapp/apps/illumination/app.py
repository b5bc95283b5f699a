"""The application of illumination: HDR environment maps (paper section 4.1.5).

A fit sees a map itself, or nothing but the LDR photograph of a sphere under it. Either way its prediction is a map,
which is judged by what it lights.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.photograph import photograph_spheres
from metapp.apps.illumination.ball_encoder import BallEncoder
from metapp.apps.illumination.light_sight import LightSight
from metapp.apps.illumination.lighting import LightField
from metapp.apps.illumination.map_augmentation import vary_maps
from metapp.apps.illumination.radiance_losses import describe_maps
from metapp.apps.illumination.relit_judge import RelitJudge
from metapp.apps.illumination.spheres import SPHERE_NAMES
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Task, Tasks, TensorSpec
from metapp.rendering.second_scene import relighting

DEFAULT_READ_ROWS = 64  # rows to which readers resample files of maps unless they are given another number


@dataclass(frozen=True)
class Illumination(App):
    """The application of illumination: a task is one environment map of mean luminance 1, or a photographed ball."""

    decoder: LightField
    sight: LightSight[Any]
    judge: RelitJudge = field(default_factory=RelitJudge)
    encoder: BallEncoder = field(default_factory=BallEncoder)

    name = "illumination"
    small_tensors = deterministic = True
    error_measure = ErrorMeasure(
        "mean absolute error of a second scene's picture under the map",
        scale=100,
        further={
            f"{name}_{kind}": f"{name} sphere, {title}"
            for kind, title in (("rmse", "si-RMSE"), ("angle", "degrees"))
            for name in SPHERE_NAMES
        },
    )
    tensors: ClassVar = {
        "photos": TensorSpec(("K", 3, 64, 64), "uint8"),
        "map": TensorSpec((3, "H", "W"), low=0.0, optional=True),
        "scale": TensorSpec((), low=0.0, optional=True),
        "seen": TensorSpec((3, "h", "w"), low=0.0, optional=True),
        "certain": TensorSpec((2, "h", "w"), low=0.0, high=1.0, optional=True),
    }

    @property
    @override
    def read_size(self) -> int:
        """The number of rows to which maps are read: the network's if it has more than DEFAULT_READ_ROWS.

        For other networks it is 0, so that readers take their default, DEFAULT_READ_ROWS rows.
        """
        return self.decoder.network.height if self.decoder.network.height > DEFAULT_READ_ROWS else 0

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        relighting.transfer_matrix()  # errors need it: if it cannot be made, that shows before the fit
        return super().prepare(task)

    def resize(self, height: int, width: int) -> Illumination:
        """Return the application with maps of another size."""
        return replace(self, decoder=self.decoder.resize(height, width))

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return augmented maps, and new photographs of spheres under them. Raises ValueError if a task has no map."""
        maps, photo_px = vary_maps(self.judge.require(tasks).map, rng), tasks.data["photo"].shape[-1]
        photos = (photograph_spheres(maps, rng, photo_px) * 255).round().to(torch.uint8)
        truth = describe_maps(maps)
        return tasks.make_variants(self.sight.observe(truth, photos)._asdict() | truth._asdict())
