"""The pages of flat materials: maps in their photographs and under other lights, textures beside their exemplars."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, normalize

from metapp.appearance.colour import stretch_to_unit_range
from metapp.appearance.flash import (
    DISPLAY_GAMMA,
    Maps,
    pack_maps,
    radiance_to_display,
    relighting_positions,
    render_maps,
    texel_positions,
    unpack_maps,
)
from metapp.appearance.quilting import choose_block_size, quilt
from metapp.appearance.surface import Surface
from metapp.apps.svbrdf_nonstationary.maps import decode_photo
from metapp.apps.svbrdf_nonstationary.presenter import SvbrdfNonstationaryPresenter
from metapp.apps.svbrdf_stationary.flash_statistics import FLASH_FALLOFF
from metapp.apps.svbrdf_stationary.presenter import SvbrdfStationaryPresenter
from metapp.apps.texture.presenter import TexturePresenter
from metapp.extensions.viewer.view import MAX_THUMBNAIL_PX, View, reference_light_map, thumbnail
from metapp.learning.task import Params, Task

QUILTED_SIDE_RATIO = (
    2  # times as high and wide as the exemplar: what is quilted of it; four times would take six times as long
)
MAX_SURFACE_SIDE_TEXELS = 1024  # texels a side on a page
MAX_PHOTO_SIDE_PX = 512  # px a side


class LitPicture(NamedTuple):
    """One of metapp's pictures of a surface.

    Attributes:
        light: position of the flash, [3].
        eye: position of the camera, [3].
        gain: of the flash, the intensity of `metapp.appearance.flash.render_maps`.
        photo: the photograph that it is compared with, linear [3, H, W] in [0, 1].
        part: side of the maps' part that it shows, the upper left one; 1 is all.
    """

    light: Tensor
    eye: Tensor
    gain: float = 1.0
    photo: Tensor | None = None
    part: float = 1.0


@torch.no_grad()
def make_svbrdf_nonstationary_view(presenter: SvbrdfNonstationaryPresenter, theta: Params, task: Task) -> View:
    """The maps as `pictures` has them, the photographs, and the true maps if the task has them."""
    app = presenter.app
    flashes = app.flashes(theta, task)
    photos = [task.data["photo"], *task.data.get("others", ())][: len(flashes)]
    taken = app.protocol == "photo"  # else the photo was rendered from the maps
    photographed = [
        LitPicture(flash.place, flash.eye, float(flash.gain), decode_photo(photo) if taken else None)
        for flash, photo in zip(flashes, photos, strict=True)
    ]
    reference = unpack_maps(task.data["maps"].float()) if "maps" in task.data else None
    return make_surface_view(presenter.surface(theta, task), photographed, reference=reference)


def make_svbrdf_stationary_view(presenter: SvbrdfStationaryPresenter, theta: Params, task: Task) -> View:
    """The maps as `pictures` has them, and the photograph if it is at hand."""
    app = presenter.app
    photographed = []
    if "image" in task.data:
        photo = app.octaves.take_exemplar(task.data["image"][None].float() / 255)
        light, part = app.statistics.find_light(photo)[0], app.octaves.width / presenter.picture_size[1]
        photographed = [LitPicture(light, light, photo=photo[0] ** DISPLAY_GAMMA, part=part)]
    return make_surface_view(presenter.surface(theta, task), photographed, falloff=FLASH_FALLOFF)


def make_texture_view(presenter: TexturePresenter, theta: Params, task: Task) -> View:
    """The texture as `pictures` has it, the exemplar if it is at hand, and one quilted of that, at one scale."""
    app = presenter.app
    fit = presenter.pictures(theta, task)["texture"].pixels
    pictures, tiles = {"fit": fit}, {"exemplar": "seams", "fit": "whole", "image quilting": "seams"}
    if "image" in task.data:
        photo = task.data["image"][None].float() / 255
        exemplar = pictures["exemplar"] = app.octaves.take_exemplar(photo)[0].permute(1, 2, 0)
        pixels, size = (
            exemplar.numpy(),
            (QUILTED_SIDE_RATIO * exemplar.shape[0], QUILTED_SIDE_RATIO * exemplar.shape[1]),
        )
        block, overlap = choose_block_size(pixels)
        made = quilt(pixels, size, np.random.default_rng(0), block=block, overlap=overlap)  # the same each time
        pictures["image quilting"] = torch.from_numpy(made)
    rows = [{"title": name, "name": name, "tiles": how} for name, how in tiles.items() if name in pictures]
    facts = {"pictures": rows, "compared": [rows[0]["title"], "fit"]}
    return View("pictures", pictures=pictures, facts=facts, thumbnail=thumbnail(fit))


def make_surface_view(
    surface: Surface | None,
    photographed: Sequence[LitPicture],
    *,
    falloff: float = 0.0,
    reference: Maps | None = None,
    largest: int = MAX_SURFACE_SIDE_TEXELS,
) -> View:
    """A surface with all maps, under its photographs' flashes and in the three pictures of other lights.

    Args:
        surface: the fit.
        photographed: its photographs, or none.
        falloff: of flashes in pictures, as of `metapp.appearance.flash.render_maps`.
        reference: the true maps, if they are known.
        largest: texels a side at most; larger maps are reduced.
    """
    if surface is None or surface.maps is None:
        raise ValueError("a surface of one colour, expected one with maps")
    small = _reduced(surface, largest)
    assert small.maps is not None
    heights = small.heights()
    height, low, high = stretch_to_unit_range(
        heights if surface.height is not None or surface.tiles else _level(heights)
    )
    pictures = {f"fit_{name}": pixels for name, pixels in _encoded(small.maps).items()} | {"height": _last(height)}
    if reference is not None:
        true_maps = _resized(reference, _within(max(small.size), reference.diffuse))
        pictures |= {f"reference_{name}": pixels for name, pixels in _encoded(true_maps).items()}
    lit = {f"photo_{number}": each for number, each in enumerate(photographed, 1)}
    for name, each in lit.items():
        if each.photo is not None:
            pictures[name] = _last(
                radiance_to_display(adaptive_avg_pool2d(each.photo, _within(MAX_PHOTO_SIDE_PX, each.photo)))
            )
    lit |= {name: LitPicture(light, eye) for name, (light, eye) in relighting_positions().items()}
    facts = {
        "tiles": surface.tiles,
        "size": list(surface.size),
        "shown": list(small.size),
        "heights": [low, high],
        "fitted_height": surface.height is not None,
        "falloff": falloff,
        "lit": {
            name: {"light": each.light.tolist(), "eye": each.eye.tolist(), "gain": each.gain, "part": each.part}
            for name, each in lit.items()
        },
    }
    few = _resized(small.maps, (MAX_THUMBNAIL_PX, MAX_THUMBNAIL_PX))
    shown = radiance_to_display(
        render_maps(few, texel_positions(MAX_THUMBNAIL_PX, MAX_THUMBNAIL_PX), *relighting_positions()["above"])
    ).squeeze(0)
    return View(
        "surface", pictures=pictures, facts=facts, shared={"light": reference_light_map()}, thumbnail=_last(shown)
    )


def _level(height: Tensor) -> Tensor:
    """Heights [1, H, W] without the paraboloid that fits them best: the sum of errors of normals over a whole map."""
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, count) for count in height.shape[1:]), indexing="ij")
    terms = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], dim=-1).reshape(-1, 6).double()
    values = height.reshape(-1, 1).double()
    drift: Tensor = terms @ torch.linalg.lstsq(terms, values).solution
    return (values - drift).reshape(height.shape).float()


def _encoded(maps: Maps) -> dict[str, Tensor]:
    """Maps as pictures [H, W, 1 or 3]: colours at gamma 2.2; x and y of normals, 0 at 128 of 255, with roughness."""
    x_and_y = (maps.normal[:2] * 127 + 128) / 255
    return {
        "diffuse": _last(maps.diffuse.clamp(0, 1) ** (1 / DISPLAY_GAMMA)),
        "specular": _last(maps.specular.clamp(0, 1) ** (1 / DISPLAY_GAMMA)),
        "detail": _last(torch.cat([x_and_y, maps.roughness])),
    }


def _last(pixels: Tensor) -> Tensor:
    return pixels.permute(1, 2, 0)


def _within(largest: int, values: Tensor) -> tuple[int, int]:
    """The size of values [..., H, W], reduced to `largest` a side."""
    height, width = values.shape[-2:]
    share = min(1.0, largest / max(height, width))
    return max(1, round(share * height)), max(1, round(share * width))


def _reduced(surface: Surface, largest: int) -> Surface:
    """Return a surface of at most `largest` texels a side, means of the given one's."""
    size = _within(largest, surface.base)
    if size == surface.size or surface.maps is None:
        return surface
    maps, height = _resized(surface.maps, size), surface.height
    if height is not None:
        height = adaptive_avg_pool2d(height, size) * (size[1] / surface.size[1])  # in larger texels
    return surface._replace(base=maps.diffuse, maps=maps, height=height)


def _resized(maps: Maps, size: tuple[int, int]) -> Maps:
    """Means of texels, normals of unit length."""
    means = unpack_maps(adaptive_avg_pool2d(pack_maps(maps), size))
    specular = means.specular[: len(maps.specular)]
    return means._replace(specular=specular, normal=normalize(means.normal, dim=0))
