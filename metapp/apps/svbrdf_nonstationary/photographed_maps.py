"""Maps of a flat material beside the flash of a photograph of it: what fits of one photograph or of maps answer."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import Flash, render_photo


class PhotographedMaps(NamedTuple):
    """Maps of a material, and the flash under which it was photographed.

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
        """Return the flash of each photograph of one task, without axes; here of the only one."""
        flash = self.flash
        return [Flash(flash.place[0], flash.gain[0], flash.eye.expand(len(flash.place), 3)[0], flash.falloff[0])]
