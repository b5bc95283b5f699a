"""Non-stationary svBRDFs on screens and in files: maps, and what they look like under other lights."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import Maps, camera, expose, positions, relightings, render, unpack
from metapp.appearance.presentation import Compared, Kind, Picture, Visible
from metapp.appearance.surface import Surface
from metapp.apps.svbrdf_nonstationary.app import FINEST, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.confidence import deviations
from metapp.apps.svbrdf_nonstationary.maps import (
    Flash,
    flash_of,
    flashes_of,
    inputs_of,
    linear,
    photographed,
    pooled,
)
from metapp.learning.task import Params, Task
from metapp.networks.field import field_by_rows, strips_of
from metapp.networks.presentation import CodedPresentation

LOOSE = 0.25  # the deviation of a map that is white in its picture
LARGEST = 256  # px of the maps that are shown
KIND_OF: dict[str, Kind] = {"normal": "data", "roughness": "data"}  # all others are colours


class SvbrdfNonstationaryPresentation(CodedPresentation[SvbrdfNonstationary]):
    """The maps, as fine as the photograph, and pictures of them."""

    title = "svBRDF non-stat."
    measure = "mean absolute difference of log(radiance + 0.1) under 12 other lights, from elsewhere"
    measures = {  # noqa: RUF012  (never written to)
        "normal": "normals, degrees",
        "diffuse": "diffuse at gamma 2.2",
        "roughness": "roughness",
        "specular": "specular at gamma 2.2",
    }
    image_measure = "renderings under 12 other lights: difference of logs, and SSIM at gamma 2.2"
    of_pictures = {"error": "log L1", "ssim": "SSIM"}  # noqa: RUF012  (never written to)

    @torch.no_grad()
    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Four maps above what they look like under the flash and three other lights, beside those of the fit."""
        photo = photo_of(task, LARGEST)
        sheets = {"fit": sheet(self.app.maps_of({key: value[None] for key, value in theta.items()}, photo), photo)}
        if "maps" in task.data:
            target = unpack(pooled(task.data["maps"].float(), photo.shape[-2:])[None])
            sheets = {"reference": sheet(target, photo)} | sheets
        return sheets

    @torch.no_grad()
    def compared(self, theta: Params, task: Task) -> Compared | None:
        """The renderings whose SSIM is among the errors."""
        if "maps" not in task.data:
            return None
        data = {key: value[None] for key, value in self.app.prepare(task).items()}
        fitted = self.app.maps_of({key: value[None] for key, value in theta.items()}, data["photo"])
        return Compared(*(self.app.judged(maps)[1] for maps in (fitted, unpack(data["maps"]))))

    @torch.no_grad()
    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The maps, as fine as the photograph up to FINEST px, and pictures under three other lights.

        And where General says how sure it is, how far off each map may be: 0 black, LOOSE or more white. Of several
        photographs also what the maps look like in each, `photo_1` and so on, from where the fit believes it was taken.
        """
        maps = self._whole(theta, task)
        pictures = self.files_of(maps, task)
        if "places" in task.data and self.app.protocol == "photo":
            for number, radiance in enumerate(rephotographed(self.app, theta, task, maps), 1):
                pictures[f"photo_{number}"] = Picture(linear_to_srgb(radiance.clamp(0, 1)).permute(1, 2, 0), "srgb")
        if self.app.setup.sure:
            for name, part in deviations({"deviation": theta["deviation"][None]}).items():
                pictures[f"deviation_{name}"] = Picture((part[0, ..., None] / LOOSE).clamp(0, 1), "data")
        return pictures

    @torch.no_grad()
    def files_of(self, answer: Maps, task: Task) -> dict[str, Picture]:
        """The same of maps [1, C, H, W], of their size."""
        pictures = displayed(answer) | {f"lit_from_{name}": picture for name, picture in relit(answer).items()}
        return {
            name: Picture(picture.permute(1, 2, 0), KIND_OF.get(name, "srgb")) for name, picture in pictures.items()
        }

    @torch.no_grad()
    def surface(self, theta: Params, task: Task) -> Surface:
        """The maps as `files` writes them."""
        maps = self._whole(theta, task)
        return Surface(maps.diffuse[0], False, Maps(*(part[0] for part in maps)))

    def _whole(self, theta: Params, task: Task) -> Maps:
        """The maps [1, ...] of the size of files."""
        one = {key: value[None] for key, value in theta.items()}

        def make() -> Maps:
            return fine_maps(self.app, one, photo_of(task, FINEST))

        return self.kept(theta, task, make)

    def visible(self, task: Task) -> Visible:
        """The maps or the photograph, all of it in each step; General's encoder reads the photograph alone."""
        if self.app.protocol == "photo":
            return Visible(1 + len(task.data.get("others", ())), task.data["photo"].nbytes, 1)
        return Visible(1, task.data["maps"].nbytes, 0)


def placed(app: SvbrdfNonstationary, theta: Params, task: Task) -> list[Flash]:
    """The flash of each photograph that the fit saw, without task axis, as the fit places it."""
    description = app.field.gain * theta["flash"][None]
    if "places" not in task.data or app.protocol != "photo":
        flash = flash_of(description)
        return [Flash(flash.place[0], flash.gain[0], flash.eye)]
    flash = flashes_of(description, task.data["places"][None].float())
    return [Flash(*(part[0, number] for part in flash)) for number in range(flash.place.shape[1])]


def rephotographed(app: SvbrdfNonstationary, theta: Params, task: Task, maps: Maps) -> Iterator[Tensor]:
    """Linear radiance [3, H, W] of maps [1, ...] in each of a task's several photographs, as the fit places it."""
    for flash in placed(app, theta, task):
        yield photographed(maps, Flash(*(part[None] for part in flash)))[0]


def fine_maps(app: SvbrdfNonstationary, theta: Params, photo: Tensor) -> Maps:
    """The maps [T, C, H, W] that fields make of linear photographs [T, 3, H, W], at these photographs' size.

    Made by rows: a layer of a field of 2048 x 2048 texels takes 0.5 GB.
    """
    field = app.field._replace(height=photo.shape[-2], width=photo.shape[-1])
    parts = [app.maps_from(rows) for rows in field_by_rows(field, theta, inputs_of(photo))]
    return Maps(*(torch.cat(part, -2) for part in zip(*parts, strict=True)))


def photo_of(task: Task, largest: int) -> Tensor:
    """The photograph, linear [1, 3, S, S], as fine as it is, but no finer than that."""
    side = min(largest, task.data["photo"].shape[-1])
    return adaptive_avg_pool2d(linear(task.data["photo"])[None], side)


def displayed(maps: Maps) -> dict[str, Tensor]:
    """Maps [1, ...] as images [1 or 3, H, W] in [0, 1]: colours as sRGB, the others as they are."""
    parts = Maps(*(part[0] for part in maps))
    return {
        "normal": parts.normal * 0.5 + 0.5,
        "diffuse": linear_to_srgb(parts.diffuse),
        "roughness": parts.roughness,
        "specular": linear_to_srgb(parts.specular),
    }


def relit(maps: Maps) -> dict[str, Tensor]:
    """Display values [3, H, W] of maps [1, ...] under three other lights, by name."""
    place = positions(*maps.diffuse.shape[-2:], dtype=maps.diffuse.dtype, device=maps.diffuse.device)
    pairs = relightings(device=place.device)
    return {name: _lit(maps, place, light, view) for name, (light, view) in pairs.items()}


def _lit(maps: Maps, place: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """Display values [3, H, W] of maps [1, ...], by rows."""
    rows = [
        expose(render(Maps(*(part[..., first:end, :] for part in maps)), place[:, first:end], light, view))[0]
        for first, end in strips_of(*place.shape[-2:])
    ]
    return torch.cat(rows, 1)


def sheet(maps: Maps, photo: Tensor) -> Tensor:
    """One linear picture [H, W, 3]: four maps; below, the photograph's light and three others."""
    eye = camera(dtype=photo.dtype, device=photo.device)
    place = positions(*photo.shape[-2:], dtype=photo.dtype, device=photo.device)
    flash = expose(render(maps, place, eye, eye))[0]
    above = [part.expand(3, -1, -1) for part in displayed(maps).values()]
    rows = [torch.cat(row, 2) for row in (above, [flash, *relit(maps).values()])]
    return srgb_to_linear(torch.cat(rows, 1)).permute(1, 2, 0)
