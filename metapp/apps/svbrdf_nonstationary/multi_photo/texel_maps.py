"""The decoder of fits whose parameters are the maps themselves, and the flashes of several photographs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, Flash, decode_flash
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps
from metapp.apps.svbrdf_nonstationary.multi_photo.flash_gains import log_floored_radiance
from metapp.apps.svbrdf_nonstationary.photographed_maps import MaterialDecoder
from metapp.learning.task import Params


class TexelFit(NamedTuple):
    """Maps of texels, the flashes of N photographs, and the raw parameters of both.

    Attributes:
        maps: the maps, [T, C, h, w].
        flash: the flashes, with axes of tasks and photographs.
        numbers: the numbers of texels, [T, 9, H, W], which :func:`decode_maps` turns into maps.
        flash_numbers: the numbers of flashes, [T, FLASH_NUMBERS, N].
        falloff: the fall-off that the flashes of a task share, [T, 1].
        prior: at each texel the nine numbers that are expected, then the logs of the nine scales by which they may be
            off, [T, 18, H, W]; None for fits without General.
    """

    maps: Maps
    flash: Flash
    numbers: Tensor
    flash_numbers: Tensor
    falloff: Tensor
    prior: Tensor | None

    def flash_of_each_photo(self) -> list[Flash]:
        """Return the flash of each photograph of one task, without axes."""
        return [Flash(*(part[0, number] for part in self.flash)) for number in range(self.flash.place.shape[1])]


@dataclass(frozen=True)
class TexelMaps(MaterialDecoder[TexelFit, Any]):
    """The decoder of maps that are stored as nine unbounded numbers for each texel.

    Parameters are `maps` [T, 9, H, W], the numbers of texels; `flash` [T, FLASH_NUMBERS, N], the numbers of the flashes
    of N photographs, and `falloff` [T, 1], which the sight finds; and, where General made the initial maps, `prior`
    [T, 18, H, W], near which a fit is kept and which no step changes. See :class:`TexelFit`.

    Attributes:
        height, width: the size of the maps in texels.
    """

    height: int = 256
    width: int = 256

    @property
    @override
    def size(self) -> tuple[int, int]:
        """The height and width of the maps in texels."""
        return self.height, self.width

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Return the numbers of flat grey maps, and the numbers of a single flash.

        The rates that a learned rule has for these hold for all flashes.
        """
        maps = torch.zeros(count, sum(CHANNELS), self.height, self.width, device=rng.device)
        return {"maps": maps, "flash": torch.zeros(count, FLASH_NUMBERS, device=rng.device)}

    @override
    def __call__(self, theta: Params, seen: Any) -> TexelFit:
        return self._decode(theta, decode_maps(theta["maps"]), seen.places)

    @override
    def decode(self, theta: Params, photo: Tensor, cameras: Tensor) -> TexelFit:
        """Return maps and flashes; `cameras` are measured positions of camera and flash, [T, N, 2, 3]."""
        if theta["flash"].shape[2] != cameras.shape[1]:
            counts = f"{theta['flash'].shape[2]} flashes, expected {cameras.shape[1]}, one for each photo"
            raise ValueError(f"a fit with {counts}; fit anew.")
        return self._decode(theta, self.make_maps(theta, photo), cameras)

    def _decode(self, theta: Params, maps: Maps, places: Tensor) -> TexelFit:
        """Return the answer of fits [T, ...] with maps of any size."""
        numbers, flash_numbers = theta["maps"], theta["flash"]
        # fits that were saved before flashes had a fall-off have none
        falloff = theta.get("falloff", numbers.new_zeros(len(numbers), 1))
        flash = decode_flash(flash_numbers.mT, places, falloff, camera="held")
        return TexelFit(maps, flash, numbers, flash_numbers, falloff, theta.get("prior"))

    def make_maps(self, theta: Params, photo: Tensor) -> Maps:
        """Return the fitted maps, enlarged to the size of photographs if these have another size than the maps.

        Enlarged maps are smooth. So the diffuse colour is multiplied by the detail of the photograph that is finer than
        the fitted maps: its ratio to its own geometric mean over each texel of the maps, smoothly enlarged.

        Args:
            theta: fits [T, ...].
            photo: one linear photograph of each task, [T, 3, h, w], in [0, 1].

        Returns:
            The maps, [T, C, h, w].
        """
        size = photo.shape[-2:]
        if size == theta["maps"].shape[-2:]:
            return decode_maps(theta["maps"])
        maps, logs = decode_maps(interpolate(theta["maps"], size, mode="bicubic")), log_floored_radiance(photo)
        coarse_logs = adaptive_avg_pool2d(logs, self.size)
        log_detail = logs - interpolate(coarse_logs, size, mode="bicubic")
        return maps._replace(diffuse=(maps.diffuse * log_detail.exp()).clamp(0, 1))

    @override
    def postprocess(self, theta: Params) -> Params:
        """Return maps, flashes and their fall-off; the prior is not kept."""
        return {key: value for key, value in theta.items() if key != "prior"}
