"""The views of flat materials: maps in their photographs and under other lights, textures beside their exemplars.

Maps become pictures that the page's shader lights again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, normalize

from metapp.appearance.assets import Photograph, Surface
from metapp.appearance.colour import DISPLAY_GAMMA, radiance_to_display, stretch_to_unit_range
from metapp.appearance.flash import camera_distance, relighting_positions, render_maps, texel_positions
from metapp.appearance.quilting import choose_block_size, quilt_pixel_numbers
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from metapp.extensions.viewer.pages.relit import add_relit_photos
from metapp.extensions.viewer.view import (
    MAX_THUMBNAIL_PX,
    View,
    channels_last,
    crop_thumbnail,
    reference_light_map,
    size_within,
)
from metapp.networks.quilted import fetch_pieces
from metapp.runs.fit import Fit

QUILTED_SIDE_RATIO = 2  # side of the quilted texture over the exemplar's beside a larger fit; 4 takes six times as long
MAX_QUILTED_SIDE_PX = 256  # of exemplars in which pieces are chosen
MAX_TEXTURE_SIDE_PX = 1024  # of textures on a page
MAX_SURFACE_SIDE_TEXELS = 1024  # of maps on a page
MAX_PHOTO_SIDE_PX = 512  # of photographs on a page
DISTANT = 1000.0  # distance of lamp and camera that are as good as infinitely far, in halves of the side of maps


@torch.no_grad()
def make_surface_page(fit: Fit) -> View:
    """Make the view of the maps of a fit: under its photographs' flashes beside these, and beside true maps if known.

    Photographs under many lamps are relit by a lamp that is dragged.

    Args:
        fit: the fit, whose task has no data if they are not at hand.
    """
    surface: Surface = fit.asset
    reference = unpack_maps(fit.task.data["maps"].float()) if "maps" in fit.task.data else None
    if surface.lit_photos is None:
        return make_surface_view(surface, surface.photos, reference=reference)
    above = torch.tensor([0.0, 0.0, DISTANT])
    lamp = Photograph(above, above, (DISTANT / camera_distance()) ** 2)
    view = make_surface_view(surface, {"relit": lamp}, reference=reference)
    return add_relit_photos(view, surface.lit_photos)


def make_texture_page(fit: Fit) -> View:
    """Make the view of a texture: the fit, the exemplar if it is at hand, and a texture quilted of the exemplar.

    All of them are shown at one scale.

    Args:
        fit: the fit, whose task has no data if they are not at hand.
    """
    app: Any = fit.app
    pixels = fit.asset.pictures()["texture"].pixels
    pictures, tiles = {"fit": pixels}, {"exemplar": "seams", "fit": "whole", "image quilting": "seams"}
    if "image" in fit.task.data:
        exemplar = app.take_file_exemplar(fit.task)
        if (times := exemplar.shape[-1] / MAX_TEXTURE_SIDE_PX) > 1:
            pixels, exemplar = (_reduce_picture(picture, times) for picture in (pixels.permute(2, 0, 1), exemplar))
            pixels = pixels.permute(1, 2, 0)
        ratio = QUILTED_SIDE_RATIO if pixels.shape[0] > exemplar.shape[1] else 1
        pictures = {
            "fit": pixels,
            "exemplar": exemplar.permute(1, 2, 0),
            "image quilting": _quilt_exemplar(exemplar, ratio),
        }
    rows = [{"title": name, "name": name, "tiles": tiling} for name, tiling in tiles.items() if name in pictures]
    facts = {"pictures": rows, "compared": [rows[0]["title"], "fit"]}
    return View("pictures", pictures=pictures, facts=facts, thumbnail=crop_thumbnail(pixels))


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
    surface: Surface,
    photos: Mapping[str, Photograph],
    *,
    reference: Maps | None = None,
    largest: int = MAX_SURFACE_SIDE_TEXELS,
) -> View:
    """Make the view of a surface with its maps, under the flashes of its photographs and under three other lights.

    Args:
        surface: the fit.
        photos: the photographs by name, `photo_1` and so on, or `relit` for what a lamp relights; or none.
        reference: the true maps, if they are known.
        largest: texels a side at most; larger maps are reduced.
    """
    small = _reduce_surface(surface, largest)
    heights = small.heights_in_widths()
    height, low, high = stretch_to_unit_range(
        heights if surface.height is not None or surface.tiles else _remove_drift(heights)
    )
    pictures = {f"fit_{name}": pixels for name, pixels in _encode_maps(small.maps).items()}
    pictures |= {"height": channels_last(height)}
    if reference is not None:
        true_maps = _resize_maps(reference, size_within(max(small.size), reference.diffuse))
        pictures |= {f"reference_{name}": pixels for name, pixels in _encode_maps(true_maps).items()}
    for name, photo in photos.items():
        if (pixels := photo.linear_pixels()) is not None:
            small_photo = adaptive_avg_pool2d(pixels, size_within(MAX_PHOTO_SIDE_PX, pixels))
            pictures[name] = channels_last(radiance_to_display(small_photo))
    other_lights = {name: Photograph(light, camera) for name, (light, camera) in relighting_positions().items()}
    facts = {
        "tiles": surface.tiles,
        "size": list(surface.size),
        "shown": list(small.size),
        "heights": [low, high],
        "fitted_height": surface.height is not None,
        "falloff": surface.falloff,
        "lit": {
            name: {
                "light": photo.light_position.tolist(),
                "eye": photo.camera_position.tolist(),
                "gain": float(photo.gain),
                "part": photo.shown_share,
            }
            for name, photo in {**photos, **other_lights}.items()
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
    size = size_within(largest, surface.maps.diffuse)
    if size == surface.size:
        return surface
    maps, height = _resize_maps(surface.maps, size), surface.height
    if height is not None:
        height = adaptive_avg_pool2d(height, size) * (size[1] / surface.size[1])  # heights are in sides of texels
    return replace(surface, maps=maps, height=height)


def _resize_maps(maps: Maps, size: tuple[int, int]) -> Maps:
    """Return maps at another size by means over texels, with normals of unit length."""
    means = unpack_maps(adaptive_avg_pool2d(pack_maps(maps), size))
    specular = means.specular[: len(maps.specular)]
    return means._replace(specular=specular, normal=normalize(means.normal, dim=0))
