"""The sight of fits that see one flash photograph alone, and estimate its flash, too (--observe photo)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, relu
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.doubts import HIDDEN_COLOURS, format_percent
from metapp.appearance.flash import camera_distance
from metapp.appearance.highlight import FILL_PX, clipped_highlight_warnings, fill_clipped, find_clipped
from metapp.appearance.svbrdf_maps import Maps, mean_tilt_degrees
from metapp.apps.svbrdf_nonstationary.map_judge import RADIANCE_FLOOR, TrueMaps
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED_LINEAR_VALUE, decode_photo, pixel_inputs
from metapp.apps.svbrdf_nonstationary.material_sight import MaterialSight, draw_materials
from metapp.apps.svbrdf_nonstationary.photographed_maps import PhotographedMaps
from metapp.apps.svbrdf_nonstationary.variants import draw_photos
from metapp.learning.rounding import initial_smoothing, smooth_absolute
from metapp.learning.task import Params, Task, Tasks

USUAL_LOG_HEIGHT = 0.05  # deviation of the log of a camera's height below which it is at `camera_distance`
SMOOTHING = 0.03  # initial learned rounding of |d| in losses


class SeenPhoto(NamedTuple):
    """One photograph as fits see it.

    Attributes:
        photo: the linear photograph [T, 3, H, W].
        camera_height: the height of the camera in half sides of the patch, [T, 1]; 0 if it is unknown or where fits
            expect it.
    """

    photo: Tensor
    camera_height: Tensor

    @property
    def positions(self) -> None:
        """The positions of the pixels in the patch: None, as the photograph shows all of it."""

    @property
    def inputs(self) -> Tensor:
        """What fields read of each pixel, [T, PIXEL_INPUTS, H, W]."""
        return pixel_inputs(self.photo)


@dataclass(frozen=True)
class PhotoSight(MaterialSight[PhotographedMaps, Any]):
    """The sight of one photograph.

    Attributes:
        fills: whether maps are made up where photographs clip, as people want it.
    """

    fills: bool = False

    observes = "photo"
    seen_type = SeenPhoto

    @override
    def prepare(self, task: Task, decoder: Any) -> SeenPhoto:
        return SeenPhoto(adaptive_avg_pool2d(decode_photo(task.data["photo"]), decoder.size), self.read_cameras(task))

    @override
    def read_cameras(self, task: Task) -> Tensor:
        """Return the height of the camera, [1], in half sides; 0 if it is unknown or where fits expect it."""
        height = task.data.get("places", torch.zeros(1, 2, 3)).float()[0, 0, 2:]
        is_usual = (height / camera_distance()).log().abs() < USUAL_LOG_HEIGHT
        return torch.where(is_usual, 0, height)

    @override
    def augment(self, tasks: Tasks, side: int, rng: Generator) -> tuple[Any, TrueMaps]:
        materials, truth = draw_materials(tasks, side, rng)
        photos = adaptive_avg_pool2d(draw_photos(materials, rng), side)
        return SeenPhoto(photos, photos.new_zeros(len(photos), 1)), truth

    @override
    def loss(self, answer: PhotographedMaps, seen: Any, loss_parameters: Params) -> Tensor:
        """Return the mean difference of the logs of the photograph and of the maps under the fitted flash, [T]."""
        return compare_photos(answer.render(), seen.photo, loss_parameters)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return initial_smoothing(steps, SMOOTHING)

    @override
    def fill(self, answer: PhotographedMaps, photo: Tensor) -> Maps:
        """Return maps [T, C, h, w], filled where linear photographs [T, 3, h, w] clip; see :func:`fill_clipped`.

        Losses see maps before they are filled: a photograph that clips is at least so bright.
        """
        if not self.fills:
            return answer.maps
        small = adaptive_avg_pool2d(photo, min(FILL_PX, *photo.shape[-2:]))
        return fill_clipped(answer.maps, linear_to_srgb(small))

    def find_hidden_share(self, answer: PhotographedMaps) -> Tensor:
        """Return the share of texels of which a highlight hides the colours, [T]. The default, not measured, is 0."""
        return answer.maps.roughness.new_zeros(len(answer.maps.roughness))

    @override
    def fit_remarks(self, answer: PhotographedMaps, task: Task) -> dict[str, object]:
        """Return the mean tilt of fitted normals."""
        return {"mean_tilt_degrees": mean_tilt_degrees(answer.maps.normal)}

    @override
    def quality_warnings(self, answer: PhotographedMaps, seen: Any) -> list[list[str]]:
        """Add, where maps are filled, clauses on parts that clip and on parts beneath a highlight."""
        warnings = super().quality_warnings(answer, seen)
        if not self.fills:
            return warnings
        photos = linear_to_srgb(seen.photo)
        shares = find_clipped(photos).float().mean((1, 2, 3)).tolist()
        effects = [f"{format_percent(share)} of the maps is filled from its surroundings" for share in shares]
        clipped = [clipped_highlight_warnings(*pair) for pair in zip(photos, effects, strict=True)]
        hidden = [HIDDEN_COLOURS.about(share) for share in self.find_hidden_share(answer).tolist()]
        return [black + white + under for black, white, under in zip(warnings, clipped, hidden, strict=True)]


def compare_photos(radiance: Tensor, photos: Tensor, loss_parameters: Params, weights: Tensor | float = 1.0) -> Tensor:
    """Return the mean difference of the logs of radiance and photographs, [T]; where these clip, only if it is darker.

    Args:
        radiance: the radiance of maps, [T, ...].
        photos: linear photographs of that shape.
        loss_parameters: the learned parameters of the loss, {} for |d|.
        weights: factors of the differences, [T, 1, ...].
    """
    log_differences = (photos + RADIANCE_FLOOR).log() - (radiance + RADIANCE_FLOOR).log()
    log_differences = torch.where(photos > CLIPPED_LINEAR_VALUE, relu(log_differences), log_differences)
    return (weights * smooth_absolute(log_differences, loss_parameters)).mean(tuple(range(1, log_differences.ndim)))


def compare_maps(differences: Sequence[Tensor], loss_parameters: Params) -> Tensor:
    """Return the sum of the means of the differences of maps that :func:`map_differences` returns, [T]."""
    means = [smooth_absolute(difference, loss_parameters).mean((1, 2, 3)) for difference in differences]
    return torch.stack(means).sum(0)
