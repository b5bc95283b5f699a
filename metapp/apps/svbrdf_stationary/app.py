"""Stationary svBRDFs: a network from noise to maps that look as a flash photo under its light (paper section 4.1.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad

from metapp.appearance.flash import DISPLAY_GAMMA, STATISTICS_SIDES_PX, Maps, map_statistics, normal_from_height
from metapp.appearance.highlight import remove_shading
from metapp.apps.exemplar.app import ExemplarApp, draw_noise, fixed_noise, generate_raw
from metapp.apps.svbrdf_stationary.flash_statistics import FlashStatistics, chroma_deviations, encode_gloss
from metapp.apps.svbrdf_stationary.windows import WINDOWS_PER_SIDE
from metapp.learning.app import ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.layout import layout_deviation

DRAWN_WINDOWS = 3
POOLED_WEIGHT = 2.0  # further weight in the outer loss of pooled pictures, which hold the shape of the highlight
TRUTH_WEIGHT = 3.0  # weight in the outer loss of how far the maps' statistics are from the truth's
GLOSS_WEIGHT = (
    0.05  # further weight in the outer loss of how far specular and roughness are from the truth's, in logits
)
UNUSUAL_WEIGHT = 0.05  # the same where the truth is unknown, of how unusual specular and roughness are
ROUGHNESS_WEIGHT = 0.4  # varies more between materials than specular does
COLOUR_WEIGHT = 3.0  # weight in the loss of how much more or less colours vary than in the photo
RELIEF_WIDTHS = 1 / 32  # widths of the photo a unit of the network's output, as height


@dataclass(frozen=True)
class SvbrdfStationary(ExemplarApp):
    """One flash photograph of a flat stationary material a task.

    The generator does not know the place, which keeps highlights out of the maps.

    Attributes:
        prior: weight in the loss of the distance of maps from General's: one picture does not tell maps apart.
    """

    prior: float = 0.0

    name = "svbrdf_stationary"
    error_measure = ErrorMeasure(
        "relative L1 distance of Gram matrices in 9 windows, mean over windows, taps and generated materials"
    )
    tensors: ClassVar = {
        "image": TensorSpec((3, "S", "S"), "uint8"),
        "relit": TensorSpec((3, 3, "R", "R"), "uint8", optional=True),
        "truth": TensorSpec((3, 2, 6), low=0, high=1, optional=True),
    }

    @property
    def statistics(self) -> FlashStatistics:
        return FlashStatistics(self.octaves)

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """As for all exemplars, and, if the task has them, `relit` uint8 [3, 3, S, S] and `truth` [3, 2, 6]."""
        return super().prepare(task) | {key: task.data[key] for key in ("relit", "truth") if key in task.data}

    def carried(self, tasks: Tasks, channels: Tensor) -> dict[str, Tensor]:
        if "truth" not in tasks.data:
            return {}
        order = torch.cat([channels, torch.arange(3, 6, device=channels.device).expand(len(channels), -1)], 1)
        truth = tasks.data["truth"][tasks.rows]
        return {"truth": truth.gather(-1, order[:, None, None].expand(truth.shape))}

    def init(self, rng: Generator, count: int) -> Params:
        theta = super().init(rng, count)
        return theta | {"gloss": torch.zeros(count, 2, device=rng.device)} if self.prior else theta

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return super().condition(tasks, rng) | {"shine": tasks.data["shine"][tasks.rows]}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """As for all exemplars, and if fits have a prior, `gloss` [T, 2], its expected value."""
        theta = super().encode(encoder, condition)
        return self._as_glossy(theta, condition["shine"]) if self.prior else theta

    def _as_glossy(self, theta: Params, shine: Tensor) -> Params:
        """Theta whose maps have the mean gloss that a clear highlight says, else General's, and that as `gloss`."""
        expected, sure = self._expected(theta), shine[:, :1]
        change = sure * (shine[:, 1:] - expected)
        offset = self.network.offset
        return theta | {"gloss": expected + change, offset: theta[offset] + pad(change, (3, 1))}

    @torch.no_grad()
    def _expected(self, theta: Params) -> Tensor:
        """Means of specular and roughness [T, 2] as the network makes them, of a small picture from the same noise."""
        coarsest = self.octaves.count - 1
        noise = fixed_noise(self, theta["z"], 1, octave=coarsest)
        maps = self.generate(theta, noise, coarsest)
        return torch.stack([part.mean((1, 2, 3, 4)) for part in encode_gloss(maps.specular, maps.roughness)], -1)

    def maps(self, theta: Params, noise: Tensor, octave: int = 0) -> tuple[Maps, Tensor]:
        """Maps of materials [T, B, ...] from noise [T, B, C, H, W], and their height [T, B, 1, H, W] in texels."""
        raw = generate_raw(self, theta, noise, octave)
        diffuse = torch.sigmoid(raw[:, :, :3]) ** 2.2  # about evenly spread for the eye
        specular = torch.sigmoid(raw[:, :, 3:4] - 3)  # about 0.05 at first, as most dielectrics
        roughness = 0.1 + 0.9 * torch.sigmoid(raw[:, :, 4:5])
        height = RELIEF_WIDTHS * self.octaves.size(octave)[1] * raw[:, :, 5:]
        return Maps(diffuse, specular, roughness, normal_from_height(height)), height

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`noise` for `count` materials of each task, some of the windows and the photo's statistics there."""
        drawn = torch.randperm(WINDOWS_PER_SIDE * WINDOWS_PER_SIDE, generator=rng, device=rng.device)[
            :DRAWN_WINDOWS
        ].expand(len(tasks), -1)
        noise = draw_noise(self, rng, len(tasks), count, octave=self.octaves.find_octave(tasks.data))
        return {"noise": noise, "windows": drawn} | self.statistics.targets(tasks, drawn)

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Distance of Gram matrices in windows, of the features' spectra, and of the pooled pictures, [T].

        And how unusual the maps are, by `prior`.
        """
        maps = self.generate(theta, batch["noise"], self.octaves.find_octave(batch))
        loss = torch.stack(list(self._distances(theta, maps, batch).values())).sum(0)
        return loss + self.prior * _unusual(maps, theta["gloss"]) if self.prior else loss

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The same, but how far the maps are from the truth, or how unusual if that is unknown, [T].

        Without it General comes to explain all photographs by one bright, rough, specular surface without colour: one
        flash photo does not tell diffuse, specular and relief apart.
        """
        octave = self.octaves.find_octave(batch)
        maps = self.generate(theta, batch["noise"], octave)
        distances = self._distances(theta, maps, batch)
        loss = torch.stack(list(distances.values())).sum(0) + POOLED_WEIGHT * distances["pooled"]
        if "truth" not in batch:
            return loss + UNUSUAL_WEIGHT * _unusual(maps, maps.diffuse.new_zeros(len(maps.diffuse), 2))
        level = sum(self.octaves.size(octave)[1] < size for size in STATISTICS_SIDES_PX[:-1])
        truth = batch["truth"][:, level]
        specular, roughness = (truth[:, 0, 3] ** DISPLAY_GAMMA).clamp_min(1e-3), truth[:, 0, 4].clamp(0.12, 0.98)
        pairs = zip(encode_gloss(maps.specular, maps.roughness), encode_gloss(specular, roughness), strict=True)
        # where no gradient vanishes
        unlike = torch.stack([(part.mean((1, 2, 3, 4)) - wanted).abs() for part, wanted in pairs]).sum(0)
        return (
            loss + TRUTH_WEIGHT * (map_statistics(maps) - truth[:, None]).abs().mean((1, 2, 3)) + GLOSS_WEIGHT * unlike
        )

    def _distances(self, theta: Params, maps: Maps, batch: Batch) -> dict[str, Tensor]:
        """Return the parts of the loss but for priors, [T] each, of maps made of a batch's noise."""
        pictures = self.statistics.look(maps, batch)
        distances = self.statistics.distances(pictures, batch, cropped=True)
        if self.network.has_layout:
            chroma = chroma_deviations(pictures.flatten(0, 1)).unflatten(0, pictures.shape[:2])
            distances["colour"] = COLOUR_WEIGHT * (chroma - batch["chroma"][:, None]).abs().mean((1, 2))
            even = remove_shading(pictures, batch["light"][:, None])
            times = self.octaves.layout_ratio(self.octaves.find_octave(batch))
            distances["astray"] = layout_deviation(theta, batch["noise"], even, times)
            distances["softness"] = self.statistics.softness(pictures, batch)
        return distances

    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Maps:
        return self.maps(theta, noise, octave)[0]


def _unusual(maps: Maps, expected: Tensor) -> Tensor:
    """Mean squares of how far specular and, weighted, roughness are from their expected values [T, 2], [T]."""
    expected = expected.detach() + 0 * expected  # a parameter that no step moves
    specular, roughness = (
        (part - mean[:, None, None, None, None]).square().mean((1, 2, 3, 4))
        for part, mean in zip(encode_gloss(maps.specular, maps.roughness), expected.unbind(1), strict=True)
    )
    return specular + ROUGHNESS_WEIGHT * roughness
