"""The application of stationary svBRDFs: pictures of generated maps under a flash are fitted to a flash photo.

Where decoders read quilts, maps are made of pieces of the photograph, which are fetched at the photograph's own
resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.exemplar.exemplar_codec import LARGEST_PHOTO_PX, SummaryEncoder
from metapp.apps.exemplar.exemplar_sight import ExemplarSight
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.svbrdf_stationary.flash_statistics import FlashStatistics
from metapp.apps.svbrdf_stationary.material_codec import (
    GlossEncoder,
    MaterialDecoder,
    display,
    unpack_layers,
)
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Params, Task, Tasks, TensorSpec


@dataclass(frozen=True)
class SvbrdfStationary(App):
    """The application of stationary svBRDFs: a task is one flash photograph of a flat stationary material."""

    decoder: MaterialDecoder
    sight: ExemplarSight
    judge: FlashStatistics

    name = "svbrdf_stationary"
    error_measure = ErrorMeasure(
        "relative L1 distance of Gram matrices in 9 windows, mean over windows, taps and generated materials"
    )
    tensors: ClassVar = {
        "image": TensorSpec((3, "S", "S"), "uint8"),
        "relit": TensorSpec((3, 3, "R", "R"), "uint8", optional=True),
        "truth": TensorSpec((3, 2, 6), low=0, high=1, optional=True),
        "maps": TensorSpec((10, "M", "M"), low=-1, high=1, optional=True),
    }

    @property
    @override
    def read_size(self) -> int:
        return LARGEST_PHOTO_PX if self.decoder.reads_quilts else 0

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        return self.sight.vary(tasks, rng)

    @torch.no_grad()
    def draw_maps(self, theta: Params, task: Task, size: tuple[int, int] | None) -> tuple[Maps, Tensor]:
        """Draw the maps of a fit for files; they tile.

        Args:
            theta: a fit, with a task axis of length 1.
            task: the task that was fitted.
            size: height and width in texels; None for the usual size. With quilts this is the photograph's, or, if the
                task holds no photograph, the quilt's, and a warning says so. For other sizes the tile is quilted once
                more.

        Returns:
            Maps [C, H, W], and their height [1, H, W] in texels.
        """
        decoder = self.decoder
        if not decoder.reads_quilts:
            material = decoder.generate(theta, decoder.shown_noise(theta["z"], decoder.file_size(size)))
            return Maps(*(part[0, 0] for part in material.prediction)), material.height[0, 0]
        fine_quilt = self.sight.fetch_quilt(theta, task, "the maps have").clamp(0, 1)
        fine_maps, heights = decoder.generate_fine(theta, fine_quilt)
        maps, height = Maps(*(part[0] for part in fine_maps)), heights[0]
        if size is None or size == (height.shape[1], height.shape[2]):
            return maps, height
        layers = torch.cat([display(maps.diffuse), maps.specular, maps.roughness, height])
        colours = adaptive_avg_pool2d(layers[:3], decoder.octaves.octave_size())
        return unpack_layers(self.sight.resize_tile(task, layers, colours, size))

    def photo_share(self, task: Task, size: tuple[int, int] | None) -> float:
        """Return the width of the photo over the width of maps in files, in which structures are of equal size."""
        if not self.decoder.reads_quilts:
            return self.decoder.octaves.width / self.decoder.file_size(size)[1]
        return task.data["image"].shape[-1] / size[1] if size else 1.0


def compose_svbrdf(
    network: Any, octaves: Octaves, candidates: int = 0, *, expects_gloss: bool = False
) -> SvbrdfStationary:
    """Compose the application of stationary svBRDFs.

    Args:
        network: the network.
        octaves: the sizes at which pictures are compared with the exemplar.
        candidates: the number of quilts of which a fit begins with the best one; 0 for maps from noise.
        expects_gloss: whether gloss stays near General's, or near the gloss that a clear highlight shows.
    """
    decoder, statistics = MaterialDecoder(network, octaves, candidates > 0, expects_gloss), FlashStatistics(octaves)
    sight = ExemplarSight(statistics, decoder.noise_channels, candidates)
    return SvbrdfStationary(decoder, sight, statistics, (GlossEncoder if expects_gloss else SummaryEncoder)(statistics))
