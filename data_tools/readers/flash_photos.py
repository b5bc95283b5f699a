"""Photographs of flat materials under a flash beside the lens as tasks, and which material each photograph shows.

The flash lights the centre of the picture most, so the central square is read; if the camera's field of view, by EXIF
or by the user, is wider than the one that fits assume, only the part within the latter. The material that a photograph
shows follows from where it lies, in this order, with "train" or "test" as <split>:

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

from msgspec.structs import replace

from data_tools.readers import material_maps, square_photos
from data_tools.readers.arrays import pixels_of
from data_tools.readers.colours import SRGB_SPACE
from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.input_source import DEFAULT_PHOTO_PX
from data_tools.readers.picture_borders import crop_borders
from data_tools.readers.square_photos import flash_view, task_of_square, to_square_photo
from metapp.learning.task import Task
from metapp.storage.shards import AUTO_SPLIT, SPLITS, ManifestEntry

UNITS = {"image": "sRGB, uint8 0..255 [3, height, width], rows from the top; the flash is at the centre"}

_MAX_RENDERED_PX = 2048  # side of the photograph that is rendered of maps in memory, at most
_PHOTO_NAME = re.compile(r"(train|test)_([^_]+)_(.+)", re.IGNORECASE)

find, recognises = square_photos.find, square_photos.recognises


def read_task(path: Path, size: int = DEFAULT_PHOTO_PX, fov_rad: float = 0.0, least: int = 0, layer: str = "") -> Task:
    """Read a flash photograph as a task named by the file's stem.

    Args:
        path: the file.
        size: the side of the result, in px.
        fov_rad: the camera's field of view along the shorter side, in rad; 0: as EXIF says (see :func:`flash_view`).
        least: the least side of the result, in px, to which smaller pictures are enlarged; 0: pictures are enlarged to
            `size`.
        layer: the layer of an EXR file; see :func:`read_pixels`.

    Raises:
        ValueError: the file cannot be read; see :func:`read_pixels` and :func:`to_square_photo`.
    """
    whole = crop_borders(read_pixels(path, layer), str(path))
    return task_of_square("image", flash_view(whole, fov_rad, str(path)), whole, path, size, least)


def task_of_object(
    source: object, name: str, size: int = DEFAULT_PHOTO_PX, fov_rad: float = 0.0, least: int = 0, **_: object
) -> Task:
    """Make the task of a flash photograph in memory, or of one that is rendered from maps.

    Args:
        source: a picture that :func:`pixels_of` reads, or maps by name (see :func:`material_maps.task_of_arrays`).
        name: the name of the task.
        size: the side of the result, in px.
        fov_rad: the camera's field of view along the shorter side, in rad; 0: as EXIF says.
        least: the least side of the result, in px, to which smaller pictures are enlarged; 0: pictures are enlarged to
            `size`.
    """
    if isinstance(source, Mapping):
        rendered = material_maps.task_of_arrays(source, name, _MAX_RENDERED_PX, least=1).data["photo"]
        pixels = Pixels(rendered.permute(1, 2, 0).numpy(), SRGB_SPACE, False)
    else:
        pixels = crop_borders(pixels_of(name, source, material_maps.OR_MAPS_TEXT), name)
    return Task(name, {"image": to_square_photo(flash_view(pixels, fov_rad, name), name, size, least)})


def entries(sources: Sequence[Path], folders: Iterable[Path], split: str) -> dict[Path, ManifestEntry]:
    """Return the manifest's entry of each photograph, by the material it shows.

    Photographs are in the splits that their names state, if all state one and both occur.

    Raises:
        ValueError: a material has training and test photographs.
    """
    folders_outermost_first = sorted(folders, key=lambda folder: len(folder.resolve().parts))
    entry_by_photo = {}
    for photo in sources:
        containing_folders = (
            folder
            for folder in folders_outermost_first
            if Path(os.path.abspath(photo)).is_relative_to(os.path.abspath(folder))
        )
        entry_by_photo[photo] = entry_of_photo(photo, next(containing_folders, None))
    if split != AUTO_SPLIT or {entry.split for entry in entry_by_photo.values()} != set(SPLITS):
        return {photo: replace(entry, split="") for photo, entry in entry_by_photo.items()}
    first_photos: dict[str, Path] = {}
    for photo, entry in entry_by_photo.items():
        first_photo = first_photos.setdefault(entry.group, photo)
        if entry_by_photo[first_photo].split != entry.split:
            raise ValueError(
                f"{first_photo} and {photo}: training and test photograph of the material '{entry.group}', expected "
                "all of a material on one side; rename one, or set --split."
            )
    return entry_by_photo


def entry_of_photo(photo: Path, folder: Path | None = None) -> ManifestEntry:
    """Return name, material and split of a photograph by its name and its place in a folder.

    Args:
        photo: the file.
        folder: the folder that the user named; None if the user named the file.
    """
    match = _PHOTO_NAME.fullmatch(photo.stem)
    if match:
        split, material, image = match.groups()
        return ManifestEntry(f"{material}_{image}", split=split.lower(), group=material)
    absolute = Path(os.path.abspath(photo))  # links are not followed: a link's own folder tells the material
    start = Path(os.path.abspath(folder)).parent if folder else Path(absolute.anchor)
    outer, inner = ("", "", *absolute.relative_to(start).parts[:-1])[-2:]
    if outer.lower() in SPLITS:
        return ManifestEntry(f"{inner}_{photo.stem}", split=outer.lower(), group=inner)
    if inner.lower() in SPLITS:
        return ManifestEntry(photo.stem, split=inner.lower(), group=photo.stem)
    if outer and folder:
        return ManifestEntry(f"{inner}_{photo.stem}", group=inner)
    return ManifestEntry(photo.stem, group=photo.stem)
