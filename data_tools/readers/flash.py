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

import math
import os
import re
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from data_tools.formats import AUTO
from data_tools.readers.conversion import Conversion, Label, split_groups
from data_tools.readers.photos import SIZE, find_photos, holds_photos, read_photo
from metapp.appearance.flash import FOV_RAD
from metapp.learning.task import Task

UNITS = {"image": "sRGB, uint8 0..255 [3, height, width], rows from the top; the flash is at the centre"}

_SPLITS = ("train", "test")
_NAME = re.compile(r"(train|test)_([^_]+)_(.+)", re.IGNORECASE)

find = find_photos  # the names that every reader has
recognises = holds_photos


def read_task(path: Path, size: int = SIZE, fov_rad: float = 0.0, least: int = 0) -> Task:
    """A flash photograph as a task, named by `shown`; arguments and errors as of `photo_of`."""
    return Task(shown(path).name, {"image": read_photo(path, size, fov_rad=fov_rad, within_rad=FOV_RAD, least=least)})


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
    """Label of a photograph by its name and place below the folder it was found in; None for one that was named."""
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
    """Labels of all photographs of files and folders, by resolved path; of several folders the outermost counts."""
    labels: dict[Path, Label] = {}
    for path in sorted(map(Path, paths), key=lambda path: (not path.is_dir(), len(path.resolve().parts))):
        for photo in find([path])[0]:
            labels.setdefault(photo.resolve(), shown(photo, path if path.is_dir() else None))
    return labels


def split_by_material(photos: Mapping[Path, Label]) -> dict[Path, Label]:
    """Labels with a split each: as stated, where all state it and both occur, else by `split_groups`.

    Raises:
        ValueError: a material with training and test photographs.
    """
    if {label.split for label in photos.values()} != set(_SPLITS):
        return split_groups(photos)
    first: dict[str, Path] = {}
    for photo, label in photos.items():
        other = first.setdefault(label.group, photo)
        if photos[other].split != label.split:
            raise ValueError(
                f"{other} and {photo}: training and test photograph of the material '{label.group}', expected all "
                "of a material on one side; rename one, or set --split."
            )
    return dict(photos)
