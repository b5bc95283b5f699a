"""The application of light transport: densities of light paths over primary sample space (paper section 4.1.6).

A fit sees samples of paths alone. Scenes are traced, and pictures rendered, by other modules: losses and errors here
are likelihoods of samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.transport.flow import Flow
from metapp.apps.transport.scene_encoder import init_reader, read_scene_pictures
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.coded import add_decoder, join_encoder, select_reader

PICTURE_SPP = 1024  # paths a pixel of pictures that fits are judged by, as in Fischer & Ritschel 2022, table 2
REFERENCE_SPP = 8192  # paths a pixel of their reference, with next-event estimation
OUTER_SAMPLES = 2048  # samples of a training scene that preparation judges a fit by
LOG_JITTER = 0.1  # standard deviation of what augmentation adds to the log of a picture


@dataclass(frozen=True)
class Transport(App):
    """The application of light transport: a task is one scene, as samples of its light paths.

    Samples are in proportion to the luminance that their paths carry. The fields beside the network are about pictures
    alone: no training depends on them, so that checkpoints are the same for all their values.

    Attributes:
        picture: side in px of the pictures that fits are judged by.
        spp: paths a pixel of these pictures.
        reference_spp: paths a pixel of their reference, with next-event estimation.
        shown_spp: paths a pixel of the pictures that a run leaves.
        overview_spp: paths a pixel of the pictures in a run's overview.
    """

    network: Flow = field()
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
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare the samples and the picture of a scene.

        Returns:
            `samples` [N, 4] and, if there are any, held-out samples `held_out` [M, 4], all in primary sample space;
            `image` [3, 32, 32], linear.
        """
        return {key: task.data[key].float() for key in ("samples", "held_out", "image") if key in task.data}

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return self.network.init(rng, count)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `points` [T, 4, count] from the samples of each task."""
        samples = tasks.data["samples"]
        rows = torch.randint(samples.shape[1], (len(tasks), count), generator=rng, device=rng.device)
        return {"points": samples[tasks.rows[:, None], rows].mT.contiguous()}

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the mean negative log-likelihood of the points, [T]."""
        film, directions = self.network.log_density(theta, batch["points"])
        return -(film + directions).mean(1)

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the loss of the first OUTER_SAMPLES points: scenes differ more than samples of one scene do."""
        return self.loss(theta, {"points": batch["points"][..., :OUTER_SAMPLES]}, loss_parameters)

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw the reader of pictures, and the parameters of the flow that all tasks share."""
        return join_encoder(init_reader(rng, self.network.code), self.network.init(rng, 1), ("z", "film.x", "film.y"))

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"image": tasks.data["image"][tasks.rows]}

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        return add_decoder(read_scene_pictures(select_reader(encoder), encoder_input["image"], self.network), encoder)

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

    @override
    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        if "held_out" not in tasks.data:
            return {}
        return self.errors_of(self.network.log_density(theta, tasks.data["held_out"][tasks.rows].mT), tasks)

    def errors_of(self, prediction: tuple[Tensor, Tensor], tasks: Tasks) -> dict[str, Tensor]:
        """Measure the likelihood of held-out samples; {} if the tasks have none.

        Args:
            prediction: log q(film) and log q(directions | film) of the held-out samples, [T, M] each.
            tasks: T tasks.

        Returns:
            `error` [T], the mean negative log-likelihood, and its parts `film` and `directions`.
        """
        if "held_out" not in tasks.data:
            return {}
        film, directions = prediction
        return {"error": -(film + directions).mean(1), "film": -film.mean(1), "directions": -directions.mean(1)}
