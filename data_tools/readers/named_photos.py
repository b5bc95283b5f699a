"""Photographs that a text names which was written elsewhere: in other capitals, with another ending, or renamed since.

Programs state the names of raws where people keep JPEGs, and file systems differ in capitals. What is taken otherwise
than the text states is said.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections import defaultdict
from pathlib import Path

from data_tools.readers.light_lines import LightLine, list_first
from data_tools.readers.opened_images import ALL_PICTURE_SUFFIXES, RAW_SUFFIXES
from metapp.storage.folders import FAILED_PICTURE_SUFFIX, list_folder

LEAST_PHOTOS = 3  # that are left where others are missing: a texel's albedo and slopes are three numbers
_COLUMNS_BEFORE_NAME = re.compile(r"^([0-9]+[;,\s]+)+")  # such as the number of a photograph


def find_named_photos(path: Path, lines: list[LightLine]) -> tuple[dict[LightLine, Path], list[str]]:
    """Find the photographs that lines name, beside their text.

    If no name fits a file and there are as many photographs as lines, photographs are taken in natural order.

    Args:
        path: the text.
        lines: its lines.

    Returns:
        The photographs of those lines that have one, and messages for the user.

    Raises:
        ValueError: there are too few.
    """
    beside = _photos_beside(path.parent)
    index = _index_names(beside)
    photos = {line: photo for line in lines if (photo := _find_photo(path.parent, index, line.name))}
    if not photos and len(beside) == len(lines):
        return _pair_in_order(path, lines, beside)
    notes = []
    if missing := [line for line in lines if line not in photos]:
        found = f"{len(missing)} of {len(lines)} photos are missing, no such file beside it: {list_first(missing)}"
        if len(photos) < LEAST_PHOTOS:
            expected = f"expected the photos that it names, {LEAST_PHOTOS} or more; copy them there"
            raise ValueError(f"{path}: {found}; photos beside it: {len(beside)}, {expected}.")
        notes.append(f"{path}: {found}; taken: the other {len(photos)}. Copy them there, or remove their lines.")
    if renamed := [line for line, photo in photos.items() if _compose(photo.name) != _compose(line.name)]:
        found = f"{len(renamed)} of {len(lines)} photos have other names than it states"
        example = f"such as {photos[renamed[0]].name!r} for {renamed[0]}"
        notes.append(f"{path}: {found}; taken: the nearest, {example}. Correct the text if they are others.")
    taken = set(photos.values())
    if unnamed := [repr(photo.name) for photo in beside if photo not in taken]:
        found = f"photos beside it that it does not name: {len(unnamed)}, {list_first(unnamed)}"
        notes.append(f"{path}: {found}; left out. Add their lines if they belong to it.")
    return photos, notes


def _photos_beside(folder: Path) -> list[Path]:
    """Return the photographs in a folder, in natural order; raws only where no other picture has their stem."""
    names = [
        entry.name
        for entry in list_folder(str(folder))
        if entry.name.lower().endswith(ALL_PICTURE_SUFFIXES) and not entry.name.startswith(".")
    ]
    photos = [folder / name for name in names if not name.endswith(FAILED_PICTURE_SUFFIX)]
    developed = {_compose(photo.stem).casefold() for photo in photos if photo.suffix.lower() not in RAW_SUFFIXES}
    return sorted(
        (
            photo
            for photo in photos
            if photo.suffix.lower() not in RAW_SUFFIXES or _compose(photo.stem).casefold() not in developed
        ),
        key=lambda photo: _natural_order(photo.name),
    )


def _index_names(photos: list[Path]) -> dict[str, list[Path]]:
    """Return photographs by what tells one from others, in small letters: their names, and their names' stems."""
    index: dict[str, list[Path]] = defaultdict(list)
    for photo in photos:
        for key in {_compose(photo.name).casefold(), _compose(photo.stem).casefold()}:
            index[key].append(photo)
    return index


def _find_photo(folder: Path, index: dict[str, list[Path]], name: str) -> Path | None:
    """Return the photograph of a name as a text states it; None if no file fits, or several.

    It is the file of this name, else the only one whose name differs in capitals or its ending alone.

    Args:
        folder: the folder of the text.
        index: the photographs in this folder; see :func:`_index_names`.
        name: the name, without folders.
    """
    file = folder / name
    is_file = bool(name) and os.path.isfile(file)  # False for names that no file may have
    if is_file and file.suffix.lower() not in RAW_SUFFIXES:
        return file
    for stated_name in (name, _COLUMNS_BEFORE_NAME.sub("", name)):
        key = _compose(stated_name).casefold()
        stem = key.rpartition(".")[0] if key.endswith(ALL_PICTURE_SUFFIXES) else key
        for fitting in (index.get(key, []), index.get(stem, [])):
            if len(fitting) == 1:
                return fitting[0]
    return file if is_file else None


def _pair_in_order(path: Path, lines: list[LightLine], photos: list[Path]) -> tuple[dict[LightLine, Path], list[str]]:
    """Pair lines whose names fit no file with as many photographs, which are in natural order.

    Returns:
        The photographs of the lines, and a message for the user.
    """
    names = [line.name for line in lines]
    # a list in the order of characters has IMG_10 before IMG_2
    ordered = sorted(lines, key=lambda line: _natural_order(line.name)) if names == sorted(names) else lines
    found = f"none of its {len(lines)} names is that of a photo beside it, expected their names"
    pairs = f"{photos[0].name!r} for {ordered[0]} to {photos[-1].name!r} for {ordered[-1]}"
    note = f"{path}: {found}; taken: all {len(photos)} photos in their order, {pairs}. Rename them if it is another."
    photo_of_line = dict(zip(ordered, photos, strict=True))
    return {line: photo_of_line[line] for line in lines}, [note]


def _compose(name: str) -> str:
    """Return a name whose accents are parts of letters, as most systems write them; some write them apart."""
    return unicodedata.normalize("NFC", name)


def _natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts names by the numbers in them.

    >>> sorted(["IMG_10", "IMG_2"], key=_natural_order)
    ['IMG_2', 'IMG_10']
    """
    words = re.split(r"([0-9]+)", name.casefold())  # every other one is a number
    digits = [word.lstrip("0") if index % 2 else word for index, word in enumerate(words)]
    return [(len(word) if index % 2 else 0, word) for index, word in enumerate(digits)]
