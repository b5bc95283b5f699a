"""The base of the sights of a flat material: data augmentation, and what presenters ask of them."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.appearance.uniform import black_fit_warnings
from metapp.apps.svbrdf_nonstationary.map_judge import TrueMaps
from metapp.apps.svbrdf_nonstationary.maps import pool_maps
from metapp.apps.svbrdf_nonstationary.photographed_maps import Answer, Seen
from metapp.apps.svbrdf_nonstationary.variants import vary_materials
from metapp.learning.components import Sight, VisibleData
from metapp.learning.task import Task, Tasks

# Augmented materials are photographed PHOTOGRAPHED_TIMES times as fine as fits' maps, up to this side.
PHOTOGRAPHED_TIMES, FINEST_SHOT_PX = 2, 256


class MaterialSight(Sight[Answer, Seen]):
    """The base of the sights of a flat material, with what presenters ask of them.

    Whatever fits see has `photo`, the first photograph, which filling, warnings and errors read.
    """

    @abstractmethod
    def augment(self, tasks: Tasks, side: int, rng: Generator) -> tuple[Seen, TrueMaps]:
        """Vary the materials of training tasks, `fine` [M, 10, S, S], and photograph them anew.

        Args:
            tasks: T tasks with known maps.
            side: the side of fits' maps, in texels.
            rng: draws all random numbers.

        Returns:
            What fits see of the varied materials, and their maps.
        """

    @abstractmethod
    def read_cameras(self, task: Task) -> Tensor:
        """Return what a task states of its cameras, without a task axis, in the form that the decoder takes."""

    def fill(self, answer: Answer, photo: Tensor) -> Maps:
        """Return maps [T, C, h, w] that are filled where linear photographs [T, 3, h, w] tell little.

        The default fills none.
        """
        return answer.maps

    @override
    def complete(self, answer: Answer, seen: Any) -> Maps:
        """Return the maps that are judged and shown; see :meth:`fill`."""
        return self.fill(answer, seen.photo)

    def photos(self, task: Task) -> Tensor | None:
        """Return the photographs that a fit sees, uint8 [N, 3, S, S]; None if it sees none."""
        return task.data["photo"][None]

    def lit_photos(self, task: Task) -> Any:
        """Return the photographs under many lamps that a fit sees, `LitPhotos`. The default is None."""
        return None

    def fit_remarks(self, answer: Answer, task: Task) -> dict[str, object]:
        """Return remarks on the answer of one fit, by the names that records give them. The default is none."""
        return {}

    def quality_warnings(self, answer: Answer, seen: Any) -> list[list[str]]:
        """Return for each task clauses on maps that are black where the photo is not."""
        maps = answer.maps
        pairs = zip(maps.diffuse + maps.specular, seen.photo, strict=True)
        return [black_fit_warnings(colours, photo) for colours, photo in pairs]

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, the photograph, which General's encoder reads, too."""
        return VisibleData(1, task.data["photo"].nbytes, 1)


def photographed_size(side: int) -> int:
    """Return the side in texels of augmented materials when they are photographed, for maps of a side of fits."""
    return max(side, min(PHOTOGRAPHED_TIMES * side, FINEST_SHOT_PX))


def draw_materials(tasks: Tasks, side: int, rng: Generator) -> tuple[Tensor, TrueMaps]:
    """Crop the materials of training tasks, or turn them where there is no room; then restyle, recolour and mix them.

    Returns:
        Packed maps [T, 10, S, S] at the size at which materials are photographed, see :func:`photographed_size`, and
        at the size of fits.
    """
    materials = vary_materials(tasks.data["fine"][tasks.rows].float(), photographed_size(side), rng)
    return materials, TrueMaps(pool_maps(materials, (side, side)), materials.new_ones(len(materials), 4))
