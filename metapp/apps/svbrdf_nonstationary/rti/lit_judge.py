"""The judge of maps from photographs under many lamps, with the outer loss that trains the network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.map_judge import LitMaps, MapJudge, TrueMaps, log_radiance_difference
from metapp.apps.svbrdf_nonstationary.maps import map_differences
from metapp.apps.svbrdf_nonstationary.rti.curve_network import LitTexels, TexelAnswer
from metapp.learning.task import Task

# Weights in the outer loss of mean |differences|, beside 1 for roughness
RADIANCE_WEIGHT = 0.5  # of log radiance under random lights
NORMAL_WEIGHT = 4.0  # of normals, as lengths of difference vectors
DIFFUSE_WEIGHT, SPECULAR_WEIGHT = 1.0, 1.0  # of colours at gamma 2.2


@dataclass(frozen=True)
class LitJudge(MapJudge):
    """The judge of maps of single texels."""

    @override
    def prepare(self, task: Task, decoder: Any) -> TrueMaps | None:
        """Return the maps at the size of the photographs, at which fits answer."""
        if "maps" not in task.data:
            return None
        return TrueMaps(task.data["maps"].float(), task.data.get("map_weights", torch.ones(4)).float())

    @override
    def outer_loss(self, answer: TexelAnswer, seen: LitTexels, truth: LitMaps) -> Tensor:
        """Return weighted differences between fitted and true maps, and of renderings of both, [T]."""
        channels = truth.maps.shape[1]
        true_texels = truth.maps.flatten(2).gather(2, seen.numbers[:, None].expand(-1, channels, -1))
        maps, target = answer.maps, unpack_maps(true_texels[..., None])
        differences = map_differences(maps, target)
        diffuse, specular, roughness = (
            part.abs().mean((1, 2, 3)) for part in (differences.diffuse, differences.specular, differences.roughness)
        )
        normal = (differences.normal.square().sum(1) + 1e-8).sqrt().mean((1, 2))
        # all texels count as the middle of the patch, under lights and before viewers in any direction
        middle = torch.zeros(1, 2, *maps.normal.shape[-2:])
        loss = RADIANCE_WEIGHT * log_radiance_difference(maps, target, truth.pairs, middle)
        return loss + NORMAL_WEIGHT * normal + DIFFUSE_WEIGHT * diffuse + SPECULAR_WEIGHT * specular + roughness
