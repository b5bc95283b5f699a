"""The default set of non-stationary svBRDFs: procedural patches of several materials, weathered.

Families take turns, so any count of 19 or more holds them all; every draw is another patch. Training and test draws
come from other random streams. Maps cover kinds that most libraries of materials hold little of: bare metals in colour,
roughness from 0.1 to 0.95 within one patch, strong relief beside none. Photographs are as people take them: in most the
flash is not quite beside the lens.
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
from data_tools.synthetic.stationary.families import Split, split_draws
from data_tools.synthetic.svbrdf_stationary import FLAT_FAMILIES
from metapp.appearance.flash import (
    BESIDE_LENS_SHARE,
    FLASH_BRIGHTNESS_LOG_DEVIATION,
    FLASH_HEIGHT_LOG_DEVIATION,
    FLASH_OFFSET_HALF_SIDES,
    camera_distance,
    camera_position,
)
from metapp.apps.svbrdf_nonstationary.places import held_places
from metapp.learning.task import Task

VERSION = 2
MAX_PHOTOS = 9
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

SIZE = 128
PHOTOS = 1
EVEN_FAMILIES = {
    f"even_{name}": functools.partial(procedural_piece, names=(name,)) for name in FLAT_FAMILIES
}  # in sets of larger maps, too
_STREAM = 2  # other materials than those of the textures and of the stationary svBRDFs


def units_of(photos: int = 1, **_: object) -> dict[str, str]:
    """Units of the tensors of a set, of one photo of each material or of several."""
    return UNITS | (SEVERAL_PHOTO_UNITS if photos > 1 else {})


def synthetic_tasks(split: Split, count: int, seed: int = 0, size: int = SIZE, photos: int = PHOTOS) -> Iterator[Task]:
    """The patches of one split, one by one.

    Args:
        split: "train" or "test"; the same families, other draws.
        count: how many. A larger set begins with the smaller one.
        seed: of all draws, >= 0.
        size: px a side; another size draws other patches of the same families, and a larger one than SIZE of materials
            that are the same all over, too: `EVEN_FAMILIES`.
        photos: of each material, 1 to MOST_PHOTOS; the first is the same whatever their number.

    Returns:
        Tasks with unique names such as "inlay-016" ("inlay-t000" in the test split), as `svbrdf_task` makes them:
        `maps` float16 [10, size, size] and `photo` uint8 [3, size, size]; of several photos `others` uint8
        [photos - 1, 3, size, size] and `places` [photos, 2, 3], too, off as measured ones are
        (`metapp.apps.svbrdf_nonstationary.places`).

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    families = FAMILIES if size <= SIZE else FAMILIES | EVEN_FAMILIES
    for family, name, rng in split_draws("svBRDFs", families, COUNTS, split, count, seed, _STREAM):
        maps = pack_surface(families[family](rng, size))
        place, intensity = draw_flash(rng)
        task = svbrdf_task.make_svbrdf_task(name, maps, photo=svbrdf_task.render_flash_photo(maps, place, intensity))
        yield task if photos == 1 else task._replace(data=task.data | _further(maps, place, photos, rng))


def _further(maps: Tensor, first: Tensor, photos: int, rng: Rng) -> dict[str, Tensor]:
    """`others` and `places` of so many photos, of the first of which the flash is known."""
    (cameras,), (off,) = held_places(1, photos, Generator().manual_seed(int(rng.integers(2**62))))
    lights = torch.cat([first[None], cameras[1:]])
    brighter = np.exp(rng.normal(size=photos) * FLASH_BRIGHTNESS_LOG_DEVIATION)
    others = [
        svbrdf_task.render_flash_photo(maps, eye, float(gain * (eye[2] / camera_distance()) ** 2), eye)
        for eye, gain in zip(cameras[1:], brighter[1:], strict=True)
    ]
    return {"others": torch.stack(others), "places": torch.stack([cameras, lights], 1) + off[:, None]}


def draw_flash(rng: Rng) -> tuple[Tensor, float]:
    """The position of the flash, [3] as `metapp.appearance.flash.render_maps` has it, and its intensity."""
    apart = rng.normal(size=4) * (rng.random() >= BESIDE_LENS_SHARE)
    aside, higher, brighter = (
        apart[:2] * FLASH_OFFSET_HALF_SIDES,
        np.exp(apart[2] * FLASH_HEIGHT_LOG_DEVIATION),
        np.exp(apart[3] * FLASH_BRIGHTNESS_LOG_DEVIATION),
    )
    place = torch.tensor([*aside, float(camera_position()[2]) * higher], dtype=torch.float32)
    return place, float(brighter * higher**2)  # exposed by what is right below it
