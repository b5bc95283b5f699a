"""Inputs of fits of non-stationary svBRDFs: strips, materials as maps, and plain flash photographs.

A folder may hold all three; what a file is follows from the files beside it and from its shape.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

import torch

from data_tools.readers import material_files, material_maps, square_photos, strips
from data_tools.readers.arrays import pixels_of
from data_tools.readers.image_files import read_pixels
from data_tools.readers.input_source import (
    DAMAGED_FACT,
    DEFAULT_PHOTO_PX,
    PHOTO_COUNT_FACT,
    REFERENCE_FACT,
    Source,
    Sources,
)
from data_tools.readers.listing import files_below
from data_tools.readers.map_names import is_unused_map
from data_tools.readers.opened_images import ALL_PICTURE_SUFFIXES, check_exists
from data_tools.readers.picture_borders import crop_borders
from data_tools.readers.square_photos import (
    flash_view,
    folders_with_places,
    narrow_view_height,
    task_of_square,
    to_square_photo,
)
from data_tools.readers.svbrdf_task import correct_exposure
from metapp.learning.task import Task


class FileRole(NamedTuple):
    """The role of a file: a map of a material, a strip, or else a photograph.

    Attributes:
        material: the material of which the file is a map; None if it is no map.
        strip: whether the file is a strip.
    """

    material: material_files.MaterialFiles | None = None
    strip: bool = False


def recognises(path: Path) -> bool:
    """Tell whether a path is an image file, or a folder with one.

    Images in folders that state positions of cameras do not count.
    """
    if not path.is_dir():
        return square_photos.recognises(path)
    placed = folders_with_places(path)
    return any(_is_elsewhere(file, placed) for file in files_below(path, ALL_PICTURE_SUFFIXES))


def find(path: Path) -> Sources:
    """Find all strips and photographs, and one file of each material that is kept as maps.

    Folders of several photographs with positions of camera and flash are left out; see :func:`folders_with_places`.
    """
    files, skipped = square_photos.find_images(path)
    placed = folders_with_places(path) if path.is_dir() else []
    files = [file for file in files if _is_elsewhere(file, placed)]
    source_of_file: dict[Path, Path | None] = {}
    title_by_unknown_file: dict[Path, str] = {}
    materials: dict[Path, material_files.MaterialFiles] = {}
    by_folder: dict[Path, list[Path]] = {}
    for file in files:
        by_folder.setdefault(file.parent, []).append(file)
    for folder, folder_files in by_folder.items():
        materials_here = [*filter(_is_material, material_files.list_materials(folder)[0])]
        source_of_file.update(dict.fromkeys(filter(is_unused_map, folder_files if materials_here else ())))
        for material in materials_here:
            materials[material.source] = material
            source_of_file.update(dict.fromkeys(material.maps, material.source))
            title_by_unknown_file |= dict.fromkeys(material.unknown, material.title)
    skipped += [
        f"{file}: of unknown role beside the maps of {title}, left out; rename it, or name it if it is a photo."
        for file, title in title_by_unknown_file.items()
    ]
    source_of_file |= dict.fromkeys(title_by_unknown_file)
    files_found = dict.fromkeys(source for file in files if (source := source_of_file.get(file, file)))
    return [_make_source(file, materials.get(file)) for file in files_found], skipped


def _make_source(file: Path, material: material_files.MaterialFiles | None) -> Source:
    """Return a file as a source; of maps a photograph is rendered, of a strip it is cut out."""
    try:
        role = FileRole(material) if material else role_of(file)
    except (ValueError, OSError):  # read_task says what is wrong
        return Source(file.stem, file, facts={DAMAGED_FACT: True, REFERENCE_FACT: False})
    name = role.material.title if role.material else file.stem
    facts = {PHOTO_COUNT_FACT: 1, REFERENCE_FACT: role != FileRole()}
    return Source(name, file, facts=facts, content=role)


def role_of(path: Path) -> FileRole:
    """Find out what a file is, by the names of the files beside it and by its shape.

    Raises:
        ValueError: the file is no image.
    """
    material = material_files.material_of(path)
    return FileRole(material) if material and _is_material(material) else FileRole(strip=strips.is_strip(path))


def read_task(
    path: Path,
    size: int = DEFAULT_PHOTO_PX,
    fov_rad: float = 0.0,
    stops: float = 0.0,
    layer: str = "",
    content: FileRole | None = None,
) -> Task:
    """Read a strip, the material that a map belongs to, or else a photograph as a task named by the file.

    Args:
        path: the file.
        size: the side of the result, in px; above 256 only for files that have as many.
        fov_rad: the field of view, in rad, of a photograph's camera; 0: as EXIF says (see :func:`flash_view`).
        stops: the number of stops by which a photograph is too bright.
        layer: the layer of an EXR file; see :func:`data_tools.readers.image_files.read_pixels`.
        content: what the file is, as :func:`find` found it; None to find out.

    Returns:
        The task that :func:`data_tools.readers.svbrdf_task.make_svbrdf_task` makes; for a photograph it has `photo`,
        sRGB uint8 [3, S, S], and of a view narrower than 45 degrees also `places` [1, 2, 3] of camera and flash.
    """
    check_exists(path)
    role, least = content or role_of(path), min(size, DEFAULT_PHOTO_PX)
    if role.material:
        return material_maps.read_task(path, size, least=least, layer=layer, content=role.material)
    if role.strip:
        return strips.read_task(path, size, least=least, layer=layer)
    whole = crop_borders(read_pixels(path, layer), str(path))
    task = task_of_square("photo", flash_view(whole, fov_rad, str(path)), whole, path, size, least)
    return _add_height(_correct_task_exposure(task, stops), narrow_view_height(whole, fov_rad))


def task_of_object(
    source: object, name: str, size: int = DEFAULT_PHOTO_PX, fov_rad: float = 0.0, stops: float = 0.0, **_: object
) -> Task:
    """Make the task of a material in memory, of its maps or of its flash photograph.

    Args:
        source: maps by name (see :func:`material_maps.task_of_arrays`), or a picture that :func:`pixels_of` reads.
        name: the name of the task.
        size: the side of the result, in px; above 256 only for pictures that have as many.
        fov_rad: the field of view, in rad, of a photograph's camera; 0: as EXIF says.
        stops: the number of stops by which a photograph is too bright.
    """
    if isinstance(source, Mapping):
        return material_maps.task_of_arrays(source, name, size, min(size, DEFAULT_PHOTO_PX))
    whole = crop_borders(pixels_of(name, source, material_maps.OR_MAPS_TEXT), name)
    photo = to_square_photo(flash_view(whole, fov_rad, name), name, size, min(size, DEFAULT_PHOTO_PX))
    return _add_height(_correct_task_exposure(Task(name, {"photo": photo}), stops), narrow_view_height(whole, fov_rad))


def _add_height(task: Task, height: float) -> Task:
    """Add the `places` of camera and flash, straight above the photograph at a height in half sides, if it is not 0."""
    if not height:
        return task
    return task._replace(data=task.data | {"places": torch.tensor([0.0, 0.0, height]).expand(1, 2, 3).contiguous()})


def _correct_task_exposure(task: Task, stops: float) -> Task:
    """Return the task of a photograph as if it had been exposed right, `stops` darker."""
    return task._replace(data={"photo": correct_exposure(task.data["photo"], stops)})


def _is_elsewhere(file: Path, folders: Collection[Path]) -> bool:
    """Tell whether a file is not below any of these folders."""
    return not any(parent in folders for parent in file.parents)


def _is_material(material: material_files.MaterialFiles) -> bool:
    """Tell whether a material has several maps: a lone one is a photograph that is only called like a map."""
    return len(material.files) > 1
