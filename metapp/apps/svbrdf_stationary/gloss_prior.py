"""Stationary svBRDFs whose gloss stays near General's, or near the gloss that a clear highlight shows.

Without it the gloss of fits at 256 texels takes the place of colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.nn.functional import pad
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary, gloss_deviation
from metapp.apps.svbrdf_stationary.flash_statistics import encode_gloss
from metapp.learning.task import Batch, Params, Tasks


@dataclass(frozen=True)
class SvbrdfNearPrior(SvbrdfStationary):
    """Stationary svBRDFs with a parameter that no step moves: `gloss` [T, 2], expected logits of mean gloss.

    Attributes:
        prior: the weight in the loss of the distance of specular and roughness from the expected ones.
    """

    prior: float = 0.5

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return super().init(rng, count) | {"gloss": torch.zeros(count, 2, device=rng.device)}

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        return super().encoder_input(tasks, rng) | tasks.gather(("shine",))

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Shift the mean gloss of General's maps to the gloss that a clear highlight shows, and add it as `gloss`.

        The encoder's input has `shine` [T, 3], the confidence in the highlight, 0 to 1, and the logits of specular and
        roughness that it shows.
        """
        theta, shine = super().encode(encoder, encoder_input), encoder_input["shine"]
        gloss, confidence = self._mean_gloss(theta), shine[:, :1]
        change = confidence * (shine[:, 1:] - gloss)
        output_shift = self.network.output_shift
        return theta | {"gloss": gloss + change, output_shift: theta[output_shift] + pad(change, (3, 1))}

    @torch.no_grad()
    def _mean_gloss(self, theta: Params) -> Tensor:
        """Return mean logits of specular and roughness [T, 2] of small maps, from noise that is equal for all tasks."""
        coarsest = self.octaves.count - 1
        maps = self.generate(theta, self.fixed_noise(theta["z"], 1, coarsest), coarsest)
        return torch.stack([values.mean((1, 2, 3, 4)) for values in encode_gloss(maps.specular, maps.roughness)], -1)

    @override
    def loss_of_maps(self, theta: Params, maps: Maps, batch: Batch) -> Tensor:
        """Add the distance of gloss from the expected one."""
        return super().loss_of_maps(theta, maps, batch) + self.prior * gloss_deviation(maps, theta["gloss"].detach())
