"""The answers that all decoders of flat materials give: maps, and the flashes of photographs of them."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple, Protocol, TypeVar

from torch import Tensor

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import Flash, render_photo
from metapp.learning.components import Decoder
from metapp.learning.task import Params


class MaterialAnswer(Protocol):
    """Maps of a flat material, and the flashes of the photographs of it."""

    @property
    def maps(self) -> Maps:
        """The maps, [T, C, H, W]."""
        ...

    @property
    def flash(self) -> Flash:
        """The flashes, with an axis of tasks and, for answers of several photographs, one of photographs."""
        ...

    def flash_of_each_photo(self) -> list[Flash]:
        """Return the flash of each photograph of one task, without axes."""
        ...


Answer = TypeVar("Answer", bound=MaterialAnswer)
Seen = TypeVar("Seen")


class MaterialDecoder(Decoder[Answer, Seen]):
    """The base of decoders of flat materials, whose maps can be made at the size of any photograph."""

    @property
    @abstractmethod
    def size(self) -> tuple[int, int]:
        """The height and width of the maps of fits, in texels."""

    @abstractmethod
    def decode(self, theta: Params, photo: Tensor, cameras: Tensor) -> Answer:
        """Return maps at the size of photographs, and flashes.

        Args:
            theta: fits [T, ...].
            photo: one linear photograph of each task, [T, 3, h, w].
            cameras: what is known of the cameras, [T, ...], in the form of `MaterialSight.read_cameras`.

        Raises:
            ValueError: a fit is not of so many photographs.
        """


class PhotographedMaps(NamedTuple):
    """Maps of a material, and the flash of one photograph.

    Attributes:
        maps: the maps, [T, C, H, W].
        flash: the flash, with a task axis.
    """

    maps: Maps
    flash: Flash

    def render(self, positions: Tensor | None = None) -> Tensor:
        """Return the radiance [T, 3, H, W] of the maps under the flash; see :func:`render_photo`."""
        return render_photo(self.maps, self.flash, positions)

    def flash_of_each_photo(self) -> list[Flash]:
        """Return the flash of the only photograph of one task, without axes."""
        flash = self.flash
        return [Flash(flash.place[0], flash.gain[0], flash.eye.expand(len(flash.place), 3)[0], flash.falloff[0])]
