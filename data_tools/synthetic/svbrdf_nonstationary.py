"""The default set of non-stationary svBRDFs: procedural patches of several materials, weathered.

Families take turns, so any count of 19 or more holds them all; every draw is another patch. Training and test draws
come from other random streams. The maps cover kinds that most libraries of materials hold little of: bare metals in
colour, roughness from 0.1 to 0.95 within one patch, strong relief beside none. Photos are as people take them: in most
the flash is not quite beside the lens.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Generator, Tensor

from data_tools.random_streams import Rng
from data_tools.readers import svbrdf_task
from data_tools.synthetic.nonstationary.assemblies import circuit, cover, inlay, mosaic, planks, plates, tiles
from data_tools.synthetic.nonstationary.decorations import carpet, label, ornament, stitched
from data_tools.synthetic.nonstationary.materials import procedural_piece
from data_tools.synthetic.nonstationary.patch_surface import PatchSurface, pack_surface
from data_tools.synthetic.nonstationary.wear import (
    corroded,
    crumpled,
    flaking,
    overgrown,
    puddles,
    scratches,
    stains,
    tracks,
)
from data_tools.synthetic.random_values import Split
from data_tools.synthetic.stationary.families import split_draws
from data_tools.synthetic.svbrdf_stationary import FLAT_FAMILIES
from metapp.appearance.flash import camera_distance, camera_position
from metapp.apps.svbrdf_nonstationary.places import (
    BESIDE_LENS_SHARE,
    FLASH_BRIGHTNESS_LOG_DEVIATION,
    FLASH_HEIGHT_LOG_DEVIATION,
    FLASH_OFFSET_HALF_SIDES,
    held_places,
)
from metapp.learning.task import Task

VERSION = 2  # of the set's tasks
MAX_PHOTOS = 9  # photos of a material
UNITS = {
    **svbrdf_task.UNITS,
    "photo": "sRGB, uint8 0..255 [3, height, width], rows from the top; camera above the centre, flash near it",
}
SEVERAL_PHOTO_UNITS = {
    "others": "sRGB, uint8 0..255 [photos - 1, 3, height, width], the further photos, in the frame of the first",
    "places": "float32 [photos, 2, 3], measured places of camera and flash: x right, y up, z out of the patch, from "
    "its centre, in half sides of the patch",
}
COUNTS: dict[Split, int] = {"train": 1200, "test": 16}
FAMILIES: dict[str, Callable[[Rng, int], PatchSurface]] = {
    "inlay": inlay,
    "corroded": corroded,
    "tiles": tiles,
    "puddles": puddles,
    "ornament": ornament,
    "label": label,
    "plates": plates,
    "stitched": stitched,
    "flaking": flaking,
    "mosaic": mosaic,
    "scratches": scratches,
    "carpet": carpet,
    "planks": planks,
    "overgrown": overgrown,
    "tracks": tracks,
    "stains": stains,
    "cover": cover,
    "circuit": circuit,
    "crumpled": crumpled,
}

SIZE = 128  # px a side of the maps and photos
PHOTOS = 1
EVEN_FAMILIES = {
    f"even_{name}": functools.partial(procedural_piece, names=(name,)) for name in FLAT_FAMILIES
}  # families that sets of larger maps have in addition
_STREAM = 2  # a key of the random streams: other materials than in the sets of textures and of stationary svBRDFs


def units_of(photos: int = 1, **_: object) -> dict[str, str]:
    """Return the units of a set's tensors, for one photo of each material or for several."""
    return UNITS | (SEVERAL_PHOTO_UNITS if photos > 1 else {})


def synthetic_tasks(split: Split, count: int, seed: int = 0, size: int = SIZE, photos: int = PHOTOS) -> Iterator[Task]:
    """Draw the patches of one split, and yield each as a task.

    Args:
        split: "train" or "test"; both have all families, with other draws.
        count: how many. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.
        size: px a side; another size draws other patches of the families, and a size above SIZE also draws materials
            that are equal all over, `EVEN_FAMILIES`.
        photos: number of photos of each material, 1 to MAX_PHOTOS; the first does not depend on it.

    Returns:
        Tasks with unique names such as "inlay-016" ("inlay-t000" in the test split), as
        `data_tools.readers.svbrdf_task` makes them: `maps` float16 [10, size, size] and `photo` uint8 [3, size, size].
        Several photos add `others` uint8 [photos - 1, 3, size, size] and `places` [photos, 2, 3], with errors like
        measured ones (`metapp.apps.svbrdf_nonstationary.places`).

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    families = FAMILIES if size <= SIZE else FAMILIES | EVEN_FAMILIES
    for family, name, rng in split_draws("svBRDFs", families, COUNTS, split, count, seed, _STREAM):
        maps = pack_surface(families[family](rng, size))
        flash_position, intensity = draw_flash(rng)
        task = svbrdf_task.make_svbrdf_task(
            name, maps, photo=svbrdf_task.render_flash_photo(maps, flash_position, intensity)
        )
        yield (
            task
            if photos == 1
            else task._replace(data=task.data | _draw_further_photos(maps, flash_position, photos, rng))
        )


def _draw_further_photos(maps: Tensor, first: Tensor, photos: int, rng: Rng) -> dict[str, Tensor]:
    """Draw the tensors `others` and `places` of several photos, given the flash's position in the first photo."""
    (cameras,), (measurement_errors,) = held_places(1, photos, Generator().manual_seed(int(rng.integers(2**62))))
    flashes = torch.cat([first[None], cameras[1:]])
    brightness = np.exp(rng.normal(size=photos) * FLASH_BRIGHTNESS_LOG_DEVIATION)
    others = [
        svbrdf_task.render_flash_photo(maps, camera, float(gain * (camera[2] / camera_distance()) ** 2), camera)
        for camera, gain in zip(cameras[1:], brightness[1:], strict=True)
    ]
    return {"others": torch.stack(others), "places": torch.stack([cameras, flashes], 1) + measurement_errors[:, None]}


def draw_flash(rng: Rng) -> tuple[Tensor, float]:
    """Draw the position [3] and the intensity of the flash; see `metapp.appearance.flash.render_maps`."""
    deviations = rng.normal(size=4) * (rng.random() >= BESIDE_LENS_SHARE)
    offset, height_factor, brightness = (
        deviations[:2] * FLASH_OFFSET_HALF_SIDES,
        np.exp(deviations[2] * FLASH_HEIGHT_LOG_DEVIATION),
        np.exp(deviations[3] * FLASH_BRIGHTNESS_LOG_DEVIATION),
    )
    position = torch.tensor([*offset, float(camera_position()[2]) * height_factor], dtype=torch.float32)
    return position, float(brightness * height_factor**2)  # the exposure is set by the surface right below the flash
