"""The sight of one photograph by General with features of VGG-16: texels beneath highlights count less."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.map_judge import TrueMaps
from metapp.apps.svbrdf_nonstationary.photo_sight import PhotoSight, SeenPhoto, compare_photos
from metapp.apps.svbrdf_nonstationary.photographed_maps import PhotographedMaps
from metapp.apps.svbrdf_nonstationary.pretrained.augmentation import draw_variants
from metapp.apps.svbrdf_nonstationary.pretrained.patch import PATCH_KEYS, describe_patch
from metapp.apps.svbrdf_nonstationary.pretrained.scars import hidden_share, remove_scars, trust_texels
from metapp.learning.task import Params, Tasks


class FitPhoto(SeenPhoto):
    """A photograph of a whole patch as fits see it."""

    @property
    def slopes_are_final(self) -> bool:
        """Whether maps have the slopes of fits: True."""
        return True

    def describe_patch(self) -> Params:
        """Describe the patch; see :func:`metapp.apps.svbrdf_nonstationary.pretrained.patch.describe_patch`."""
        return describe_patch(self.photo)


class TrainingPhoto(NamedTuple):
    """A photograph as training sees it: often a window of a patch, with what is known of the whole patch.

    Attributes:
        photo: the linear photograph, [T, 3, h, w].
        inputs: what fields read of each of its pixels, [T, PIXEL_INPUTS, h, w].
        overview, highlight, guess, code, flash: descriptions of the whole patch, see :func:`describe_patch`.
    """

    photo: Tensor
    inputs: Tensor
    overview: Tensor
    highlight: Tensor
    guess: Tensor
    code: Tensor
    flash: Tensor

    @property
    def slopes_are_final(self) -> bool:
        """Whether maps have the slopes of fits: False, as training sees slopes as the network makes them."""
        return False

    def describe_patch(self) -> Params:
        """Return the descriptions of the whole patch, by name."""
        return {key: getattr(self, key) for key in PATCH_KEYS}

    @property
    def positions(self) -> Tensor:
        """The positions of the pixels in the patch, [T, 2, h, w]."""
        return self.inputs[:, -2:]

    @property
    def camera_height(self) -> Tensor:
        """The heights of cameras, [T, 1]: 0, as they are not known."""
        return self.photo.new_zeros(len(self.photo), 1)


@dataclass(frozen=True)
class FeatureSight(PhotoSight):
    """The sight of one photograph; training sees windows of photographs, too."""

    fills: bool = True

    seen_type = FitPhoto

    @override
    def seen_type_of(self, tensors: Mapping[str, Tensor]) -> type[Any]:
        return TrainingPhoto if tensors.keys() >= set(TrainingPhoto._fields) else FitPhoto

    @override
    def augment(self, tasks: Tasks, side: int, rng: Generator) -> tuple[TrainingPhoto, TrueMaps]:
        """Draw photographs of half the side of fits' maps, often windows, of augmented materials."""
        fine, map_weights = (tasks.data[key][tasks.rows].float() for key in ("fine", "map_weights"))
        drawn = draw_variants(fine, map_weights, side // 2, rng)
        truth = TrueMaps(drawn.pop("maps"), drawn.pop("map_weights"))
        return TrainingPhoto(**drawn), truth

    @override
    def loss(self, answer: PhotographedMaps, seen: FitPhoto | TrainingPhoto, loss_parameters: Params) -> Tensor:
        """Return the difference from the photograph, [T]; texels beneath a highlight count less.

        See :func:`trust_texels`.
        """
        radiance = answer.render(seen.positions)
        weights = trust_texels(answer.maps, radiance, answer.flash, seen.positions)
        return compare_photos(radiance, seen.photo, loss_parameters, weights)

    @override
    def find_hidden_share(self, answer: PhotographedMaps) -> Tensor:
        return hidden_share(answer.maps, answer.flash)

    @override
    def fill(self, answer: PhotographedMaps, photo: Tensor) -> Maps:
        """Remove scars of highlights; see :func:`remove_scars`. Then fill maps where photographs clip."""
        return super().fill(answer._replace(maps=remove_scars(answer.maps, photo, answer.flash)), photo)
