"""Inputs of fits of non-stationary svBRDFs: strips, materials as maps, and plain flash photographs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

from data_tools.readers import material_maps, square_photos, strips
from data_tools.readers.arrays import pixels_of
from data_tools.readers.image_files import ALL_PICTURE_SUFFIXES, check_exists, read_pixels
from data_tools.readers.input_source import DAMAGED_FACT, PHOTO_COUNT_FACT, Source, Sources
from data_tools.readers.listing import files_below
from data_tools.readers.map_names import is_unused_map
from data_tools.readers.square_photos import SIZE, flash_view, folders_with_places, task_of_square, to_square_photo
from data_tools.readers.svbrdf_task import correct_exposure
from metapp.learning.task import Task


class FileRole(NamedTuple):
    """What a file is: a map of a material, a strip, or else a photograph."""

    material: material_maps.MaterialFiles | None = None
    strip: bool = False


def recognises(path: Path) -> bool:
    """True if a path is an image file, or a folder with one below it that is not among those with places."""
    if not path.is_dir():
        return square_photos.recognises(path)
    placed = folders_with_places(path)
    return any(_is_elsewhere(file, placed) for file in files_below(path, ALL_PICTURE_SUFFIXES))


def find(path: Path) -> Sources:
    """Find all strips and photographs, and one file of each material that is kept as maps, as `find_files`.

    Folders with the places of several photographs, as of `folders_with_places`, are left out.
    """
    files, skipped = square_photos.find_images(path)
    placed = folders_with_places(path) if path.is_dir() else []
    files = [file for file in files if _is_elsewhere(file, placed)]
    stands_for: dict[Path, Path | None] = {}
    unknown: dict[Path, str] = {}
    materials: dict[Path, material_maps.MaterialFiles] = {}
    by_folder: dict[Path, list[Path]] = {}
    for file in files:
        by_folder.setdefault(file.parent, []).append(file)
    for folder, beside in by_folder.items():
        here = [*filter(_is_material, material_maps.list_materials(folder)[0])]
        stands_for.update(dict.fromkeys(filter(is_unused_map, beside if here else ())))
        for material in here:
            materials[material.source] = material
            stands_for.update(dict.fromkeys(material.maps, material.source))
            unknown |= dict.fromkeys(material.unknown, material.title)
    skipped += [
        f"{file}: of unknown role beside the maps of {title}, left out; rename it, or name it if it is a photo."
        for file, title in unknown.items()
    ]
    stands_for |= dict.fromkeys(unknown)
    found = dict.fromkeys(source for file in files if (source := stands_for.get(file, file)))
    return [_source_of(file, materials.get(file)) for file in found], skipped


def _source_of(file: Path, material: material_maps.MaterialFiles | None) -> Source:
    """Return a file as a source; of maps and strips a photograph is rendered or cut out, too."""
    try:
        role = FileRole(material) if material else role_of(file)
    except (ValueError, OSError):  # reading it says what is wrong
        return Source(file.stem, file, protocol="photo", facts={DAMAGED_FACT: True})
    name = role.material.title if role.material else file.stem
    return Source(
        name, file, protocol="photo" if role == FileRole() else "reference", facts={PHOTO_COUNT_FACT: 1}, content=role
    )


def role_of(path: Path) -> FileRole:
    """Find out what a file is, by the names of the files beside it and by its shape.

    Raises:
        ValueError: no image.
    """
    material = material_maps.material_of(path)
    return FileRole(material) if material and _is_material(material) else FileRole(strip=strips.is_strip(path))


def read_task(
    path: Path,
    size: int = SIZE,
    fov_rad: float = 0.0,
    stops: float = 0.0,
    layer: str = "",
    content: FileRole | None = None,
) -> Task:
    """Turn a strip, the material that a map belongs to, or else a photograph into a task named by the file.

    Args:
        path: the file.
        size: side in px; above 256 only of files as fine as that.
        fov_rad: of a photograph's camera, as of `flash_view`.
        stops: by which a photograph is too bright.
        layer: as of `read_pixels`.
        content: what the file is, as `find` found it.

    Returns:
        As `svbrdf_task`; of a photograph `photo` alone, uint8 [3, S, S].
    """
    check_exists(path)
    role, least = content or role_of(path), min(size, SIZE)
    if role.material:
        return material_maps.read_task(path, size, least=least, layer=layer, content=role.material)
    if role.strip:
        return strips.read_task(path, size, least=least, layer=layer)
    whole = read_pixels(path, layer)
    return _exposed(task_of_square("photo", flash_view(whole, fov_rad, str(path)), whole, path, size, least), stops)


def task_of_object(
    source: object, name: str, size: int = SIZE, fov_rad: float = 0.0, stops: float = 0.0, **_: object
) -> Task:
    """The task of a material in memory, of its maps or of its flash photograph; else as `read_task`."""
    if isinstance(source, Mapping):
        return material_maps.task_of_arrays(source, name, size, min(size, SIZE))
    view = flash_view(pixels_of(name, source, material_maps.OR_MAPS_TEXT), fov_rad, name)
    return _exposed(Task(name, {"photo": to_square_photo(view, name, size, min(size, SIZE))}), stops)


def _exposed(task: Task, stops: float) -> Task:
    """A photograph as if it had been exposed rightly."""
    return task._replace(data={"photo": correct_exposure(task.data["photo"], stops)})


def _is_elsewhere(file: Path, folders: Collection[Path]) -> bool:
    """True for a file that is not below these folders, which may hold its pictures."""
    return not any(parent in folders for parent in file.parents)


def _is_material(material: material_maps.MaterialFiles) -> bool:
    """A photograph that is only called like a map has no other one beside it."""
    return len(material.files) > 1
