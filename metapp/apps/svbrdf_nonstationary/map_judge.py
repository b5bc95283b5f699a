"""The judge of maps of flat materials: pictures under lights that no fit has seen, and the maps themselves."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.flash import render_maps, texel_positions
from metapp.appearance.svbrdf_maps import Maps, map_statistics, unpack_maps
from metapp.apps.svbrdf_nonstationary.maps import (
    CLIPPED_LINEAR_VALUE,
    draw_mirroring_pairs,
    draw_oblique_pairs,
    map_differences,
    pool_maps,
)
from metapp.learning.components import Judge
from metapp.learning.task import Task, Tasks

RADIANCE_FLOOR = 0.1  # of white: the log of radiance is flat below
LEVEL_SINE = 0.01  # sine of an angle that hardly shows
JUDGED_LIGHTS = (6, 6)  # lights that fits are judged under: anywhere above the patch, mirrored in it
DRAWN_LIGHTS = (1, 2)  # lights that are drawn anew for each outer step: anywhere above the patch, mirrored in it


class TrueMaps(NamedTuple):
    """The maps that fits are judged by.

    Attributes:
        maps: packed maps [T, 10, H, W], at the size of fits.
        map_weights: weights of losses of diffuse colour, specular colour, roughness and normals, [T, 4]: 0 where a
            training set lacks a map, which is made up.
    """

    maps: Tensor
    map_weights: Tensor


class LitMaps(NamedTuple):
    """True maps, and random lights under which an outer loss compares pictures of them.

    Attributes:
        maps, map_weights: see :class:`TrueMaps`.
        pairs: positions of lights and viewers in half sides of the patch, [T, V, 2, 3].
    """

    maps: Tensor
    map_weights: Tensor
    pairs: Tensor


@dataclass(frozen=True)
class MapJudge(Judge[Any, Any, TrueMaps]):
    """The judge of maps. Subclasses add the outer loss by which fits are trained."""

    truth_type, sampled_type = TrueMaps, LitMaps

    @override
    def prepare(self, task: Task, decoder: Any) -> TrueMaps | None:
        if "maps" not in task.data:
            return None
        maps = pool_maps(task.data["maps"].float(), decoder.size)
        return TrueMaps(maps, task.data.get("map_weights", torch.ones(4)).float())

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> LitMaps:
        """Add random lights and viewers."""
        truth = self.require(tasks)
        return LitMaps(truth.maps, truth.map_weights, draw_pairs(DRAWN_LIGHTS, rng, len(tasks)))

    @override
    def errors(self, prediction: Maps, seen: Any, truth: TrueMaps) -> dict[str, Tensor]:
        """Measure how far maps [T, C, H, W] of the size of fits are off.

        Returns:
            `error`, of log radiance under lights that no fit has seen; `normal` in degrees; `diffuse`, `roughness`,
            `specular`, mean differences, colours at gamma 2.2; `relief`, how steep normals are on average over how
            steep they should be; `blots`, the difference of diffuse colours where the photo clips, 0 if it does not.
        """
        target = unpack_maps(truth.maps)
        logs, references = judged_log_radiance(prediction), judged_log_radiance(target)
        cosine = (prediction.normal * target.normal).sum(1).clamp(-1, 1)
        differences = map_differences(prediction, target)
        steepness = [map_statistics(material)[:, 0, -1] + LEVEL_SINE for material in (prediction, target)]
        return {
            "error": (logs - references).abs().mean((1, 2, 3, 4)),
            "normal": torch.rad2deg(cosine.acos()).mean((1, 2)),
            "relief": steepness[0] / steepness[1],
            "blots": blots(differences.diffuse, seen.photo),
            "diffuse": differences.diffuse.abs().mean((1, 2, 3)),
            "specular": differences.specular.abs().mean((1, 2, 3)),
            "roughness": differences.roughness.abs().mean((1, 2, 3)),
        }

    @abstractmethod
    @override
    def outer_loss(self, answer: Any, seen: Any, truth: LitMaps) -> Tensor: ...


def log_radiance(maps: Maps, pairs: Tensor, positions: Tensor | None = None) -> Tensor:
    """Return log(radiance + RADIANCE_FLOOR), [T, V, 3, H, W], of maps [T, C, H, W].

    Args:
        maps: maps of all of the patch, or of the part of it that `positions` says.
        pairs: positions of light and viewer in half sides of the patch, [T or 1, V, 2, 3].
        positions: the positions of the texels, [T, 2, H, W]; None if the maps are of all of the patch.
    """
    if positions is None:
        positions = texel_positions(*maps.diffuse.shape[-2:], dtype=pairs.dtype, device=pairs.device)[None]
    maps_by_pair = Maps(*(part[:, None] for part in maps))
    return (render_maps(maps_by_pair, positions[:, None], pairs[:, :, 0], pairs[:, :, 1]) + RADIANCE_FLOOR).log()


def log_radiance_difference(maps: Maps, target: Maps, pairs: Tensor, positions: Tensor | None = None) -> Tensor:
    """Return the mean absolute difference of :func:`log_radiance` of two sets of maps, [T]."""
    logs, references = (log_radiance(material, pairs, positions) for material in (maps, target))
    return (logs - references).abs().mean((1, 2, 3, 4))


def judged_log_radiance(maps: Maps) -> Tensor:
    """Return log radiance [T, V, 3, H, W] of maps [T, C, H, W] under the lights that fits are judged under."""
    return log_radiance(maps, fixed_pairs(JUDGED_LIGHTS).to(maps.diffuse)[None])


def blots(diffuse: Tensor, photo: Tensor) -> Tensor:
    """Return the mean |difference| of diffuse colours where a photograph clips, [T]; 0 where none of it clips.

    Args:
        diffuse: differences of diffuse colours at gamma 2.2, [T, 3, H, W].
        photo: linear photographs [T, 3, H, W].
    """
    clips = (photo > CLIPPED_LINEAR_VALUE).any(1, keepdim=True).float()
    return (diffuse.abs() * clips).mean((1, 2, 3)) / clips.mean((1, 2, 3)).clamp_min(1e-6)


def draw_pairs(counts: tuple[int, int], rng: Generator, tasks: int) -> Tensor:
    """Draw places of light and viewer, [tasks, V, 2, 3]: some anywhere, then some mirrored in the patch."""
    return torch.cat([draw_oblique_pairs(rng, (tasks, counts[0])), draw_mirroring_pairs(rng, (tasks, counts[1]))], 1)


def fixed_pairs(counts: tuple[int, int]) -> Tensor:
    """Return the places of light and viewer, [V, 2, 3], that are the same for all tasks and in every run."""
    return draw_pairs(counts, Generator().manual_seed(sum(counts)), 1)[0]
