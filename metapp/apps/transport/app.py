"""The application of light transport: densities of light paths over primary sample space (paper section 4.1.6).

A fit sees samples of paths alone; `path_fits` has the density that it fits and how that is judged.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Generator
from typing_extensions import override

from metapp.apps.transport.path_fits import FlowDensity, PathJudge, PathSight
from metapp.apps.transport.scene_encoder import ScenePictureEncoder
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Tasks, TensorSpec

PICTURE_SPP = 1024  # paths a pixel of pictures that fits are judged by, as in Fischer & Ritschel 2022, table 2
REFERENCE_SPP = 8192  # paths a pixel of their reference, with next-event estimation
LOG_JITTER = 0.1  # standard deviation of what augmentation adds to the log of a picture


@dataclass(frozen=True)
class Transport(App):
    """The application of light transport: a task is one scene, as samples of its light paths.

    The fields beside the components are about pictures alone: no training depends on them, so that checkpoints are the
    same for all their values.

    Attributes:
        picture: side in px of the pictures that fits are judged by.
        spp: paths a pixel of these pictures.
        reference_spp: paths a pixel of their reference, with next-event estimation.
        shown_spp: paths a pixel of the pictures that a run leaves.
        overview_spp: paths a pixel of the pictures in a run's overview.
    """

    decoder: FlowDensity
    sight: PathSight = field(default_factory=PathSight)
    judge: PathJudge = field(default_factory=PathJudge)
    encoder: ScenePictureEncoder = field(default_factory=ScenePictureEncoder)
    picture: int = field(default=64, compare=False)
    spp: int = field(default=PICTURE_SPP, compare=False)
    reference_spp: int = field(default=REFERENCE_SPP, compare=False)
    shown_spp: int = field(default=512, compare=False)
    overview_spp: int = field(default=256, compare=False)

    name = "transport"
    error_measure = ErrorMeasure(
        "negative log-likelihood of held-out light paths, on the film and in their first direction", logarithmic=True
    )
    tensors: ClassVar = {
        "samples": TensorSpec(("N", 4), low=0.0, high=1.0),
        "held_out": TensorSpec(("M", 4), low=0.0, high=1.0, optional=True),
        "image": TensorSpec((3, 32, 32), low=0.0),
        "scene": TensorSpec(("L",), "uint8", optional=True),
        "next_event": TensorSpec((1,), "uint8", optional=True),
    }

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return the scenes, some of them mirrored left to right, with noise in their pictures.

        Directions are counted from axes that the data's tracer mirrors with the scene.
        """
        count, device = len(tasks), rng.device
        is_mirrored = draw_uniform(rng, count, 1, 1) < 0.5
        image = tasks.data["image"][tasks.rows]
        image = torch.where(is_mirrored[..., None], image.flip(3), image)
        image = image * torch.exp(LOG_JITTER * draw_normal(rng, *image.shape))
        samples = tasks.data["samples"][tasks.rows]
        is_horizontal = torch.zeros(samples.shape[2], dtype=torch.bool, device=device)
        is_horizontal[0], is_horizontal[2::2] = True, True
        mirrored_samples = (1 - samples).clamp_max(1 - 2**-24)
        samples = torch.where(is_mirrored & is_horizontal, mirrored_samples, samples)
        return tasks.make_variants({"samples": samples, "image": image})
