"""Photographs of flat materials under a flash beside the lens, as tasks, and which material each one shows.

The flash lights the centre of the picture most: the central square is what counts, and of a camera whose field of view
is wider than that of fits only what is within theirs, where EXIF or the user says how wide it is. What a photograph
shows follows from where it lies, in this order:

    <split>_<material>_<image>.jpg      such as train_0231_IMG_0785.jpg
    <split>/<material>/<image>.jpg      as Henzler et al. 2021, "Generative Modelling of BRDF Textures from Flash
                                        Images", store theirs; their metadata.json says the same
    <split>/<material>.jpg
    <material>/<image>.jpg              below the folder that was named
    <material>.jpg

with "train" or "test" as <split>.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from data_tools.formats import AUTO
from data_tools.readers.conversion import Conversion, Label
from data_tools.readers.image_files import Pixels
from data_tools.readers.photos import SIZE, find_photos, holds_photos, photo_of, read_photo
from metapp.appearance.flash import FOV_RAD
from metapp.learning.task import Task
from metapp.storage.shards import split_auto

UNITS = {"image": "sRGB, uint8 0..255 [3, height, width], rows from the top; the flash is at the centre"}

_SPLITS = ("train", "test")
_NAME = re.compile(r"(train|test)_([^_]+)_(.+)", re.IGNORECASE)

find = find_photos  # the names that every reader has
recognises = holds_photos


def read_task(path: Path, size: int = SIZE, fov_rad: float = 0.0, least: int = 0) -> Task:
    """Turn a flash photograph into a task, named by `shown`.

    Args:
        path: the file.
        size: side in px.
        fov_rad: the camera's field of view along the shorter side; 0: as EXIF says, else that of fits.
        least: as of `data_tools.readers.photos.read_photo`.

    Raises:
        ValueError: as the same.
    """
    return Task(shown(path).name, {"image": read_photo(path, size, fov_rad=fov_rad, within_rad=FOV_RAD, least=least)})


def task_of_pixels(pixels: Pixels, name: str, size: int = SIZE, fov_rad: float = 0.0, least: int = 0) -> Task:
    """The same of a photograph in memory."""
    return Task(name, {"image": photo_of(pixels, name, size, fov_rad=fov_rad, within_rad=FOV_RAD, least=least)})


def conversion(paths: Iterable[Path], split: str, *, size: int, fov: float) -> Conversion:
    """Conversion of photographs to tasks, all of a material in one split."""
    photos = find_shown(paths)
    if split == AUTO:
        photos = split_by_material(photos)
    read = partial(read_task, size=size, fov_rad=math.radians(fov))
    notes = {"made_by": "metapp data flash", "size": size, **({"fov": fov} if fov else {})}
    return Conversion(
        "svbrdf_stationary", "photograph", UNITS, find, read, notes, lambda source: photos[source.resolve()]
    )


def shown(photo: Path, folder: Path | None = None) -> Label:
    """Label of a photograph by its name and place: its group is the material, its split what is stated, "" for none.

    Args:
        photo: the file.
        folder: in which it was found; None if it was named itself.
    """
    match = _NAME.fullmatch(photo.stem)
    if match:
        split, material, image = match.groups()
        return Label(f"{material}_{image}", material, split.lower())
    absolute = Path(os.path.abspath(photo))  # links are not followed: their own place counts
    start = Path(os.path.abspath(folder)).parent if folder else Path(absolute.anchor)
    outer, inner = ("", "", *absolute.relative_to(start).parts[:-1])[-2:]
    if outer.lower() in _SPLITS:
        return Label(f"{inner}_{photo.stem}", inner, outer.lower())
    if inner.lower() in _SPLITS:
        return Label(photo.stem, photo.stem, inner.lower())
    if outer and folder:
        return Label(f"{inner}_{photo.stem}", inner, "")
    return Label(photo.stem, photo.stem, "")


def find_shown(paths: Iterable[str | Path]) -> dict[Path, Label]:
    """All photographs of files and folders, by their resolved paths, and what each shows.

    A photograph that is found in several ways shows what it does in the outermost folder.

    Raises:
        ValueError: as `find`.
    """
    labels: dict[Path, Label] = {}
    for path in sorted(map(Path, paths), key=lambda path: (not path.is_dir(), len(path.resolve().parts))):
        for photo in find([path])[0]:
            labels.setdefault(photo.resolve(), shown(photo, path if path.is_dir() else None))
    return labels


def split_by_material(photos: Mapping[Path, Label]) -> dict[Path, Label]:
    """Split photographs into training and test ones so that those of a material stay together.

    Where all say their split and both occur, that holds; otherwise `metapp.storage.shards.split_auto` decides among
    materials: of the sorted names, every fifth is a test material.

    Returns:
        The same with a split each, "train" or "test".

    Raises:
        ValueError: a material with training and test photographs.
    """
    if {label.split for label in photos.values()} != set(_SPLITS):
        split = split_auto(label.group for label in photos.values())
        return {photo: label._replace(split=split[label.group]) for photo, label in photos.items()}
    first: dict[str, Path] = {}
    for photo, label in photos.items():
        other = first.setdefault(label.group, photo)
        if photos[other].split != label.split:
            raise ValueError(
                f"{other} and {photo}: training and test photograph of the material '{label.group}', expected all "
                "of a material on one side; rename one, or set --split."
            )
    return dict(photos)
