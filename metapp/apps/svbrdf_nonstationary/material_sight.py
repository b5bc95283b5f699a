"""What every sight of a flat material can say to a presenter: photographs, cameras, remarks and warnings."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, TypeVar

from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.pictures import VisibleData
from metapp.appearance.svbrdf_maps import Maps
from metapp.appearance.uniform import black_fit_warnings
from metapp.apps.svbrdf_nonstationary.variants import vary_materials
from metapp.learning.composed import Sight
from metapp.learning.task import Task, Tasks

Answer = TypeVar("Answer")
Seen = TypeVar("Seen")

# Augmented materials are photographed FINER times as fine as fits' maps, up to this side.
FINER, FINEST_SHOT_PX = 2, 256


class MaterialSight(Sight[Answer, Seen]):
    """The base of the sights of a flat material. All have the photograph that is taken from straight above, `photo`."""

    @abstractmethod
    def augment(self, tasks: Tasks, side: int, rng: Generator) -> dict[str, Tensor]:
        """Vary the materials of training tasks, `fine` [M, 10, S, S], and photograph them anew.

        Args:
            tasks: T tasks.
            side: the side of fits' maps, in texels.
            rng: draws all random numbers.

        Returns:
            What fits see of the varied materials, and their packed maps, `maps` [T, 10, h, w], by name.
        """

    @abstractmethod
    def read_camera(self, task: Task) -> Tensor:
        """Return what a task says of where its cameras were, without a task axis, as the decoder takes it."""

    def fill(self, answer: Answer, photo: Tensor) -> Maps:
        """Return maps [T, C, h, w] that are filled where linear photographs [T, 3, h, w] tell little; here none are."""
        maps: Maps = answer.maps  # type: ignore[attr-defined]
        return maps

    @override
    def complete(self, answer: Answer, seen: Any) -> Maps:
        """Return the maps that are judged and shown; see :meth:`fill`."""
        return self.fill(answer, seen.photo)

    def photos(self, task: Task) -> Tensor | None:
        """Return the photographs that a fit sees, uint8 [N, 3, S, S]; None if it sees none."""
        return task.data["photo"][None]

    def picture_names(self, task: Task) -> list[str]:
        """Return names for pictures of a fit as each photograph shows it; here none, as `fit` shows the only one."""
        return []

    def fit_remarks(self, answer: Answer, task: Task) -> dict[str, object]:
        """Return remarks on the answer of one fit, by the names that records give them; here none."""
        return {}

    def quality_warnings(self, answer: Answer, seen: Any) -> list[list[str]]:
        """Return for each task clauses on maps that are black where the photo is not."""
        maps: Maps = answer.maps  # type: ignore[attr-defined]
        pairs = zip(maps.diffuse + maps.specular, seen.photo, strict=True)
        return [black_fit_warnings(colours, photo) for colours, photo in pairs]

    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, the photograph, which General's encoder reads, too."""
        return VisibleData(1, task.data["photo"].nbytes, 1)


def photographed_size(side: int) -> int:
    """Return the side in texels of augmented materials when they are photographed, for maps of a side of fits."""
    return max(side, min(FINER * side, FINEST_SHOT_PX))


def draw_materials(tasks: Tasks, side: int, rng: Generator) -> Tensor:
    """Return the materials of training tasks turned, mirrored, mixed and recoloured, as they are photographed.

    Returns:
        Packed maps [T, 10, S, S]; see :func:`photographed_size` for S.
    """
    return vary_materials(tasks.data["fine"][tasks.rows].float(), photographed_size(side), rng)
