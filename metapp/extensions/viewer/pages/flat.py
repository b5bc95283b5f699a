"""The views of flat materials: maps in their photographs and under other lights, textures beside their exemplars.

Maps become pictures that the page's shader lights again. Three applications share this module, since their fits become
a `Surface` or pictures.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, normalize

from metapp.appearance.colour import DISPLAY_GAMMA, radiance_to_display, stretch_to_unit_range
from metapp.appearance.flash import camera_distance, relighting_positions, render_maps, texel_positions
from metapp.appearance.quilting import choose_block_size, quilt_pixel_numbers
from metapp.appearance.surface import Surface
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.maps import decode_photo
from metapp.apps.svbrdf_nonstationary.presenter import SvbrdfNonstationaryPresenter
from metapp.apps.svbrdf_nonstationary.rti.rti_app import RtiApp
from metapp.apps.svbrdf_stationary.flash_statistics import FLASH_FALLOFF
from metapp.apps.svbrdf_stationary.presenter import SvbrdfStationaryPresenter
from metapp.apps.texture.presenter import TexturePresenter
from metapp.extensions.viewer.pages.relit import add_relit_photos
from metapp.extensions.viewer.view import (
    MAX_THUMBNAIL_PX,
    View,
    channels_last,
    crop_thumbnail,
    reference_light_map,
    size_within,
)
from metapp.learning.task import Params, Task
from metapp.networks.quilted import fetch_pieces

QUILTED_SIDE_RATIO = 2  # side of the quilted texture over the exemplar's beside a larger fit; 4 takes six times as long
MAX_QUILTED_SIDE_PX = 256  # of exemplars in which pieces are chosen
MAX_TEXTURE_SIDE_PX = 1024  # of textures on a page
MAX_SURFACE_SIDE_TEXELS = 1024  # of maps on a page
MAX_PHOTO_SIDE_PX = 512  # of photographs on a page
DISTANT = 1000.0  # distance of lamp and camera that are as good as infinitely far, in halves of the side of maps


class LitPicture(NamedTuple):
    """A picture of a surface that the page renders under a flash.

    Attributes:
        light_position: position of the flash, [3].
        camera_position: position of the camera, [3].
        gain: intensity of the flash, see :func:`metapp.appearance.flash.render_maps`.
        photo: the photograph that the picture is compared with, linear [3, H, W] in [0, 1].
        shown_share: share of the maps' side that the picture shows, from the upper left corner; 1 shows all.
    """

    light_position: Tensor
    camera_position: Tensor
    gain: float = 1.0
    photo: Tensor | None = None
    shown_share: float = 1.0


@torch.no_grad()
def make_svbrdf_nonstationary_view(presenter: SvbrdfNonstationaryPresenter, theta: Params, task: Task) -> View:
    """Make the view of non-stationary maps: the fit, its photographs, and the true maps if the task has them.

    Photographs under many lamps are relit by a lamp that is dragged; others stand beside the fit under their flashes.

    Args:
        presenter: the presenter of the application.
        theta: the parameters of the fit, without a task axis.
        task: the task that was fitted, with its photographs.
    """
    reference = unpack_maps(task.data["maps"].float()) if "maps" in task.data else None
    if isinstance(presenter.app, RtiApp):
        above = torch.tensor([0.0, 0.0, DISTANT])
        lamp = LitPicture(above, above, (DISTANT / camera_distance()) ** 2)
        view = make_surface_view(presenter.surface(theta, task), {"relit": lamp}, reference=reference)
        return add_relit_photos(view, task.data["lit"], task.data["lamps"].float())
    flashes, photos = presenter.flashes(theta, task), presenter.app.sight.photos(task)
    # fits of maps see no photograph: theirs was rendered from the maps
    linear_photos = [None] * len(flashes) if photos is None else [decode_photo(photo) for photo in photos]
    lit_pictures = {
        f"photo_{number}": LitPicture(flash.place, flash.eye, float(flash.gain), photo)
        for number, (flash, photo) in enumerate(zip(flashes, linear_photos, strict=True), 1)
    }
    return make_surface_view(presenter.surface(theta, task), lit_pictures, reference=reference)


def make_svbrdf_stationary_view(presenter: SvbrdfStationaryPresenter, theta: Params, task: Task) -> View:
    """Make the view of stationary maps: the fit, and its photograph if it is at hand.

    Args:
        presenter: the presenter of the application.
        theta: the parameters of the fit, without a task axis.
        task: the task that was fitted, without data if they are not at hand.
    """
    app = presenter.app
    lit_pictures = {}
    if "image" in task.data:
        photo = app.octaves.take_exemplar(task.data["image"][None].float() / 255)
        light_position, share = app.statistics.find_light(photo)[0], app.photo_share(task, presenter.size)
        linear_photo = photo[0] ** DISPLAY_GAMMA
        lit_pictures["photo_1"] = LitPicture(light_position, light_position, photo=linear_photo, shown_share=share)
    return make_surface_view(presenter.surface(theta, task), lit_pictures, falloff=FLASH_FALLOFF)


def make_texture_view(presenter: TexturePresenter, theta: Params, task: Task) -> View:
    """Make the view of a texture: the fit, the exemplar if it is at hand, and a texture quilted of the exemplar.

    All of them are shown at one scale.

    Args:
        presenter: the presenter of the application.
        theta: the parameters of the fit, without a task axis.
        task: the task that was fitted, without data if they are not at hand.
    """
    fit = presenter.pictures(theta, task)["texture"].pixels
    pictures, tiles = {"fit": fit}, {"exemplar": "seams", "fit": "whole", "image quilting": "seams"}
    if "image" in task.data:
        exemplar = presenter.app.take_file_exemplar(task)
        if (times := exemplar.shape[-1] / MAX_TEXTURE_SIDE_PX) > 1:
            fit, exemplar = (_reduce_picture(picture, times) for picture in (fit.permute(2, 0, 1), exemplar))
            fit = fit.permute(1, 2, 0)
        ratio = QUILTED_SIDE_RATIO if fit.shape[0] > exemplar.shape[1] else 1
        pictures = {
            "fit": fit,
            "exemplar": exemplar.permute(1, 2, 0),
            "image quilting": _quilt_exemplar(exemplar, ratio),
        }
    rows = [{"title": name, "name": name, "tiles": tiling} for name, tiling in tiles.items() if name in pictures]
    facts = {"pictures": rows, "compared": [rows[0]["title"], "fit"]}
    return View("pictures", pictures=pictures, facts=facts, thumbnail=crop_thumbnail(fit))


def _reduce_picture(picture: Tensor, times: float) -> Tensor:
    """Reduce the sides of a picture [C, H, W] by a factor, not only a whole one."""
    return adaptive_avg_pool2d(picture, (round(picture.shape[1] / times), round(picture.shape[2] / times)))


def _quilt_exemplar(exemplar: Tensor, ratio: int) -> Tensor:
    """Quilt a picture of `ratio` times the sides of an exemplar; a page that is made again shows the same one.

    Pieces are chosen in a copy of the exemplar of MAX_QUILTED_SIDE_PX, and fetched from the exemplar itself.

    Args:
        exemplar: display values [3, H, W].
        ratio: a whole number.

    Returns:
        Display values [ratio H, ratio W, 3].
    """
    side = exemplar.shape[-1]
    small = _reduce_picture(exemplar, max(1.0, side / MAX_QUILTED_SIDE_PX))
    height, width = small.shape[1:]
    pixels = small.permute(1, 2, 0).numpy()
    block, overlap = choose_block_size(pixels)
    cells = ratio * height, ratio * width
    numbers = quilt_pixel_numbers(pixels, cells, np.random.default_rng(0), block=block, overlap=overlap)
    rows, columns = torch.from_numpy(numbers // width), torch.from_numpy(numbers % width)
    places = torch.stack([(rows + 0.5) / height, (columns + 0.5) / width])
    size = ratio * exemplar.shape[1], ratio * exemplar.shape[2]
    return fetch_pieces(exemplar, places, size, (height, width)).clamp(0, 1).permute(1, 2, 0)


def make_surface_view(
    surface: Surface | None,
    lit_pictures: Mapping[str, LitPicture],
    *,
    falloff: float = 0.0,
    reference: Maps | None = None,
    largest: int = MAX_SURFACE_SIDE_TEXELS,
) -> View:
    """Make the view of a surface with its maps, under the flashes of its photographs and under three other lights.

    Args:
        surface: the fit.
        lit_pictures: the pictures that are compared with photographs, by name, `photo_1` and so on, or `relit`; or
            none.
        falloff: falloff of flashes in pictures, see :func:`metapp.appearance.flash.render_maps`.
        reference: the true maps, if they are known.
        largest: texels a side at most; larger maps are reduced.

    Raises:
        ValueError: the fit is a surface of one colour, without maps.
    """
    if surface is None or surface.maps is None:
        raise ValueError("a surface of one colour, expected one with maps")
    small = _reduce_surface(surface, largest)
    assert small.maps is not None
    heights = small.heights_in_widths()
    height, low, high = stretch_to_unit_range(
        heights if surface.height is not None or surface.tiles else _remove_drift(heights)
    )
    pictures = {f"fit_{name}": pixels for name, pixels in _encode_maps(small.maps).items()}
    pictures |= {"height": channels_last(height)}
    if reference is not None:
        true_maps = _resize_maps(reference, size_within(max(small.size), reference.diffuse))
        pictures |= {f"reference_{name}": pixels for name, pixels in _encode_maps(true_maps).items()}
    for name, lit_picture in lit_pictures.items():
        if (photo := lit_picture.photo) is not None:
            small_photo = adaptive_avg_pool2d(photo, size_within(MAX_PHOTO_SIDE_PX, photo))
            pictures[name] = channels_last(radiance_to_display(small_photo))
    other_lights = {name: LitPicture(light, camera) for name, (light, camera) in relighting_positions().items()}
    facts = {
        "tiles": surface.tiles,
        "size": list(surface.size),
        "shown": list(small.size),
        "heights": [low, high],
        "fitted_height": surface.height is not None,
        "falloff": falloff,
        "lit": {
            name: {
                "light": lit_picture.light_position.tolist(),
                "eye": lit_picture.camera_position.tolist(),
                "gain": lit_picture.gain,
                "part": lit_picture.shown_share,
            }
            for name, lit_picture in {**lit_pictures, **other_lights}.items()
        },
    }
    thumbnail_maps = _resize_maps(small.maps, (MAX_THUMBNAIL_PX, MAX_THUMBNAIL_PX))
    positions = texel_positions(MAX_THUMBNAIL_PX, MAX_THUMBNAIL_PX)
    radiance = render_maps(thumbnail_maps, positions, *relighting_positions()["above"])
    thumbnail = channels_last(radiance_to_display(radiance).squeeze(0))
    return View("surface", pictures=pictures, facts=facts, shared={"light": reference_light_map()}, thumbnail=thumbnail)


def _remove_drift(height: Tensor) -> Tensor:
    """Return heights [1, H, W] without the paraboloid that fits them best.

    Heights that are integrated from normals drift, since errors of normals add up over a whole map.
    """
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, count) for count in height.shape[1:]), indexing="ij")
    terms = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], dim=-1).reshape(-1, 6).double()
    values = height.reshape(-1, 1).double()
    drift: Tensor = terms @ torch.linalg.lstsq(terms, values).solution
    return (values - drift).reshape(height.shape).float()


def _encode_maps(maps: Maps) -> dict[str, Tensor]:
    """Return maps as pictures [H, W, 1 or 3], by name.

    Colours are at gamma 2.2; `detail` holds x and y of normals, where 128 of 255 stands for 0, and roughness.
    """
    x_and_y = (maps.normal[:2] * 127 + 128) / 255
    return {
        "diffuse": channels_last(maps.diffuse.clamp(0, 1) ** (1 / DISPLAY_GAMMA)),
        "specular": channels_last(maps.specular.clamp(0, 1) ** (1 / DISPLAY_GAMMA)),
        "detail": channels_last(torch.cat([x_and_y, maps.roughness])),
    }


def _reduce_surface(surface: Surface, largest: int) -> Surface:
    """Return a surface reduced to at most `largest` texels a side, by means over texels."""
    size = size_within(largest, surface.colour)
    if size == surface.size or surface.maps is None:
        return surface
    maps, height = _resize_maps(surface.maps, size), surface.height
    if height is not None:
        height = adaptive_avg_pool2d(height, size) * (size[1] / surface.size[1])  # heights are in sides of texels
    return surface._replace(colour=maps.diffuse, maps=maps, height=height)


def _resize_maps(maps: Maps, size: tuple[int, int]) -> Maps:
    """Return maps at another size by means over texels, with normals of unit length."""
    means = unpack_maps(adaptive_avg_pool2d(pack_maps(maps), size))
    specular = means.specular[: len(maps.specular)]
    return means._replace(specular=specular, normal=normalize(means.normal, dim=0))
