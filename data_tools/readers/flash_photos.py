"""Photographs of flat materials under a flash beside the lens, as tasks, and which material each one shows.

The flash lights the centre of the picture most: the central square counts, and of a camera whose field of view is wider
than that of fits, as EXIF or the user says, only the part within theirs. What a photograph shows follows from where it
lies, in this order, with "train" or "test" as <split>:

    <split>_<material>_<image>.jpg      such as train_0231_IMG_0785.jpg
    <split>/<material>/<image>.jpg      as Henzler et al. 2021 store theirs
    <split>/<material>.jpg
    <material>/<image>.jpg              below the folder that was named
    <material>.jpg
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from data_tools.readers import material_maps, square_photos
from data_tools.readers.arrays import pixels_of
from data_tools.readers.colours import SRGB_SPACE
from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.square_photos import SIZE, flash_view, task_of_square, to_square_photo
from metapp.learning.task import Task
from metapp.storage.shards import AUTO_SPLIT, SPLITS, ManifestEntry

UNITS = {"image": "sRGB, uint8 0..255 [3, height, width], rows from the top; the flash is at the centre"}

_RENDERED_PX = 2048  # a side of the photograph of maps, at most
_NAME = re.compile(r"(train|test)_([^_]+)_(.+)", re.IGNORECASE)

find, recognises = square_photos.find, square_photos.recognises


def read_task(path: Path, size: int = SIZE, fov_rad: float = 0.0, least: int = 0, layer: str = "") -> Task:
    """A flash photograph as a task of its stem's name; as of `read_pixels`, `flash_view` and `to_square_photo`."""
    whole = read_pixels(path, layer)
    return task_of_square("image", flash_view(whole, fov_rad, str(path)), whole, path, size, least)


def task_of_object(
    source: object, name: str, size: int = SIZE, fov_rad: float = 0.0, least: int = 0, **_: object
) -> Task:
    """The task of a flash photograph in memory, or of one that is rendered of maps, as of `task_of_arrays`."""
    if isinstance(source, Mapping):
        photo = material_maps.task_of_arrays(source, name, _RENDERED_PX, least=1).data["photo"]
        pixels = Pixels(photo.permute(1, 2, 0).numpy(), SRGB_SPACE, False)
    else:
        pixels = pixels_of(name, source, material_maps.OR_MAPS_TEXT)
    return Task(name, {"image": to_square_photo(flash_view(pixels, fov_rad, name), name, size, least)})


def entries(sources: Sequence[Path], folders: Iterable[Path], split: str) -> dict[Path, ManifestEntry]:
    """Photographs by what they show: in the splits that they state, if all state one and both occur.

    Raises:
        ValueError: a material with training and test photographs.
    """
    outer = sorted(folders, key=lambda folder: len(folder.resolve().parts))
    of = {}
    for photo in sources:
        below = (folder for folder in outer if Path(os.path.abspath(photo)).is_relative_to(os.path.abspath(folder)))
        of[photo] = entry_of_photo(photo, next(below, None))
    if split != AUTO_SPLIT or {entry.split for entry in of.values()} != set(SPLITS):
        return {photo: entry._replace(split="") for photo, entry in of.items()}
    first: dict[str, Path] = {}
    for photo, entry in of.items():
        other = first.setdefault(entry.group, photo)
        if of[other].split != entry.split:
            raise ValueError(
                f"{other} and {photo}: training and test photograph of the material '{entry.group}', expected all "
                "of a material on one side; rename one, or set --split."
            )
    return of


def entry_of_photo(photo: Path, folder: Path | None = None) -> ManifestEntry:
    """Name, material and split of a photograph by its name and its place in a folder; None: it was named itself."""
    match = _NAME.fullmatch(photo.stem)
    if match:
        split, material, image = match.groups()
        return ManifestEntry(f"{material}_{image}", split=split.lower(), group=material)
    absolute = Path(os.path.abspath(photo))  # links are not followed: their own place counts
    start = Path(os.path.abspath(folder)).parent if folder else Path(absolute.anchor)
    outer, inner = ("", "", *absolute.relative_to(start).parts[:-1])[-2:]
    if outer.lower() in SPLITS:
        return ManifestEntry(f"{inner}_{photo.stem}", split=outer.lower(), group=inner)
    if inner.lower() in SPLITS:
        return ManifestEntry(photo.stem, split=inner.lower(), group=photo.stem)
    if outer and folder:
        return ManifestEntry(f"{inner}_{photo.stem}", group=inner)
    return ManifestEntry(photo.stem, group=photo.stem)
