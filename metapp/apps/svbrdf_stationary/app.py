"""The application of stationary svBRDFs: pictures of generated maps under a flash are fitted to a flash photo.

One photograph does not tell diffuse colour, specular colour and relief apart: priors keep them near what is usual.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import STATISTICS_SIDES_PX, Maps, map_statistics
from metapp.apps.exemplar.app import ExemplarApp, PictureChanges
from metapp.apps.svbrdf_stationary.flash_statistics import (
    LEAST_ROUGHNESS,
    SPECULAR_LOGIT,
    FlashStatistics,
    encode_gloss,
)
from metapp.apps.svbrdf_stationary.windows import WINDOW_COUNT
from metapp.learning.app import ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec

DRAWN_WINDOWS = 3  # windows of the photo that one step compares
POOLED_WEIGHT = 3.0  # of pooled pictures in the outer loss, 1 in that of fits: they hold the shape of the highlight
TRUTH_WEIGHT = 3.0  # weight in the outer loss of the difference of the maps' statistics from the true maps'
# Weights in the outer loss of mean specular and roughness, in logits: of their difference from the true ones, and where
# these are unknown, of their squared deviation from usual ones
GLOSS_WEIGHT, UNUSUAL_WEIGHT = 0.05, 0.05
ROUGHNESS_WEIGHT = 0.4  # weight of roughness beside specular, as it varies more between materials
RELIEF_WIDTHS = 1 / 32  # height, in widths of the photo, that 1 in the network's output stands for


@dataclass(frozen=True)
class SvbrdfStationary(ExemplarApp):
    """The application of stationary svBRDFs: a task is one flash photograph of a flat stationary material.

    The generator does not know the place, which keeps highlights out of the maps.
    """

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
    @override
    def statistics(self) -> FlashStatistics:
        return FlashStatistics(self.octaves)

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add `relit`, uint8 [3, 3, S, S], and `truth` [3, 2, 6], if the task has them.

        They are photographs under three other lights, and the statistics of the true maps at three resolutions.
        """
        return super().prepare(task) | {key: task.data[key] for key in ("relit", "truth") if key in task.data}

    @override
    def change_data(self, tasks: Tasks, changes: PictureChanges) -> dict[str, Tensor]:
        if "truth" not in tasks.data:
            return {}
        channels = changes.channels
        order = torch.cat([channels, torch.arange(3, 6, device=channels.device).expand(len(channels), -1)], 1)
        truth = tasks.data["truth"][tasks.rows]
        return {"truth": truth.gather(-1, order[:, None, None].expand(truth.shape))}

    def generate_maps(self, theta: Params, noise: Tensor, octave: int = 0) -> tuple[Maps, Tensor]:
        """Generate maps of materials, and the height that their normals are of.

        Args:
            theta: fits [T, ...].
            noise: the noise of B materials of each task, [T, B, C, H, W].
            octave: the octave whose size noise has, 0 for the whole size.

        Returns:
            Maps [T, B, ...], and their height [T, B, 1, H, W] in texels.
        """
        return self.decode_maps(self.network(theta, noise), self.octaves.octave_size(octave)[1])

    def decode_maps(self, raw: Tensor, width: int) -> tuple[Maps, Tensor]:
        """Make maps of the network's output.

        Args:
            raw: three channels of diffuse colour, then specular, roughness and height, before any range is imposed,
                [..., 6, H, W].
            width: the number of texels that stand for the width of the photo.

        Returns:
            Maps [..., C, H, W], and their height [..., 1, H, W] in texels.
        """
        diffuse_raw, specular_raw, roughness_raw, height_raw = raw.split((3, 1, 1, 1), -3)
        diffuse = torch.sigmoid(diffuse_raw) ** DISPLAY_GAMMA  # so that outputs are about evenly spread for the eye
        specular = torch.sigmoid(specular_raw + SPECULAR_LOGIT)
        roughness = LEAST_ROUGHNESS + (1 - LEAST_ROUGHNESS) * torch.sigmoid(roughness_raw)
        height = RELIEF_WIDTHS * width * height_raw
        return Maps(diffuse, specular, roughness, normal_from_height(height)), height

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `noise` [T, count, C, H, W] and numbers of `windows` [T, N], and add the photos' statistics in these."""
        order = torch.randperm(WINDOW_COUNT, generator=rng, device=rng.device)
        windows = order[:DRAWN_WINDOWS].expand(len(tasks), -1)
        noise = self.draw_noise(rng, len(tasks), count, self.octaves.find_octave(tasks.data))
        return {"noise": noise, "windows": windows} | self.statistics.targets(tasks, windows)

    @override
    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Add the statistics of the true maps, `truth` [T, 3, 2, 6], if the tasks have them."""
        batch = super().outer_sample(tasks, rng, count)
        return batch | ({"truth": tasks.data["truth"][tasks.rows]} if "truth" in tasks.data else {})

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the distance of pictures from the photo, [T].

        Gram matrices in windows, spectra of features and pooled pictures are compared.
        """
        return self.loss_of_maps(theta, self.generate(theta, batch["noise"], self.octaves.find_octave(batch)), batch)

    def loss_of_maps(self, theta: Params, maps: Maps, batch: Batch) -> Tensor:
        """Return the distance from the photo, [T], of maps [T, B, ...] that fits made of a batch's noise."""
        pictures = self.statistics.render_prediction(maps, batch)
        return torch.stack(list(self.compare_pictures(theta, pictures, batch).values())).sum(0)

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the distance of pictures from the photo plus the difference of maps from the true ones, [T]."""
        maps = self.generate(theta, batch["noise"], self.octaves.find_octave(batch))
        distances = self.compare_pictures(theta, self.statistics.render_prediction(maps, batch), batch)
        distances["pooled"] = POOLED_WEIGHT * distances["pooled"]
        return torch.stack(list(distances.values())).sum(0) + self.map_loss(maps, batch)

    def map_loss(self, maps: Maps, batch: Batch) -> Tensor:
        """Return the difference of maps [T, B, ...] from the statistics of the true ones, [T].

        Where the true maps are unknown, it is the deviation of gloss from a usual one. Without either, General comes to
        explain all photographs by one bright, rough, specular surface without colour.
        """
        if "truth" not in batch:
            return UNUSUAL_WEIGHT * gloss_deviation(maps, maps.diffuse.new_zeros(len(maps.diffuse), 2))
        width = self.octaves.octave_size(self.octaves.find_octave(batch))[1]
        resolution = sum(width < side for side in STATISTICS_SIDES_PX[:-1])  # the one nearest to these maps
        truth = batch["truth"][:, resolution]
        specular, roughness = (truth[:, 0, 3] ** DISPLAY_GAMMA).clamp_min(1e-3), truth[:, 0, 4].clamp(0.12, 0.98)
        pairs = zip(encode_gloss(maps.specular, maps.roughness), encode_gloss(specular, roughness), strict=True)
        # in logits, where no gradient vanishes
        gloss_difference = torch.stack([(values.mean((1, 2, 3, 4)) - target).abs() for values, target in pairs]).sum(0)
        statistics_difference = (map_statistics(maps) - truth[:, None]).abs().mean((1, 2, 3))
        return TRUTH_WEIGHT * statistics_difference + GLOSS_WEIGHT * gloss_difference

    def compare_pictures(self, theta: Params, pictures: Tensor, batch: Batch) -> dict[str, Tensor]:
        """Return distances of pictures [T, B, 3, H, W] from exemplars under whose light they are, by name, [T] each."""
        return self.statistics.distances(pictures, batch, cropped=True)

    @override
    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Maps:
        return self.generate_maps(theta, noise, octave)[0]

    @torch.no_grad()
    def draw_maps(self, theta: Params, task: Task, size: tuple[int, int] | None) -> tuple[Maps, Tensor]:
        """Draw the maps of a fit for files; they tile.

        Args:
            theta: a fit, with a task axis of length 1.
            task: the task that was fitted.
            size: height and width in texels; None for the usual size.

        Returns:
            Maps [C, H, W], and their height [1, H, W] in texels.
        """
        maps, heights = self.generate_maps(theta, self.shown_noise(theta["z"], self.file_size(size)))
        return Maps(*(part[0, 0] for part in maps)), heights[0, 0]

    def photo_share(self, task: Task, size: tuple[int, int] | None) -> float:
        """Return the width of the photo over the width of maps in files, in which structures are of equal size."""
        return self.octaves.width / self.file_size(size)[1]


def gloss_deviation(maps: Maps, expected: Tensor) -> Tensor:
    """Return the mean squared deviation of specular and, weighted, of roughness from expected logits [T, 2]: [T]."""
    specular, roughness = (
        (values - expected_values[:, None, None, None, None]).square().mean((1, 2, 3, 4))
        for values, expected_values in zip(encode_gloss(maps.specular, maps.roughness), expected.unbind(1), strict=True)
    )
    return specular + ROUGHNESS_WEIGHT * roughness
