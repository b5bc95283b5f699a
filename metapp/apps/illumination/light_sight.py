"""The base of the sights of illumination, with what presenters ask of them."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, TypeVar

from torch import Tensor

from metapp.appearance.pictures import PictureComparison
from metapp.apps.illumination.lighting import LightField, Lighting
from metapp.apps.illumination.radiance_losses import TrueMap
from metapp.learning.components import Sight
from metapp.learning.task import Task

Seen = TypeVar("Seen")


class LightSight(Sight[Lighting, Seen]):
    """The base of the sights of light. Whatever fits see has `photo`, which General's encoder reads."""

    @abstractmethod
    def observe(self, truth: TrueMap, photos: Tensor) -> Seen:
        """Return what fits see of maps, and of spheres under them.

        Args:
            truth: T maps.
            photos: photographs of the spheres, none of them a mirror, uint8 [T, 3, S, S].
        """

    def look(self, task: Task, decoder: LightField) -> Any:
        """Return what completes the answer of one fit, [1, ...]. The default is nothing.

        Args:
            task: the task of the fit, which may lack all data.
            decoder: the decoder, whose maps may have another size than those of fits.
        """
        return None

    def show_photo(self, task: Task) -> Tensor | None:
        """Return the photograph of a task that a fit sees, display values [3, S, S]. The default is None."""
        return None

    def compare_photo(self, answer: Lighting, seen: Any) -> PictureComparison | None:
        """Return the answer of one fit beside the photograph that it saw. The default is None."""
        return None
