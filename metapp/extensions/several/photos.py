"""Several flash photographs of one flat material in a folder, rectified, with the places of camera and flash.

The layout is that of Guo et al. 2020, "MaterialGAN": images in the order of their names, beside them text files, as
`metapp.extensions.several.places` reads them. Such a folder is one task.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import torch

from data_tools.readers.flash_places import placed_in
from data_tools.readers.image_files import shape_of
from data_tools.readers.photos import SIZE as PX
from data_tools.readers.photos import is_photo, read_photo
from data_tools.readers.svbrdf_task import rightly_exposed, task_name
from metapp.extensions.several.places import read_places
from metapp.learning.task import Task


def recognises(path: Path) -> bool:
    """Test whether a path is a folder that says where a camera or a flash was, or has one below it."""
    return path.is_dir() and bool(placed_in(path))


def find(paths: Iterable[Path]) -> tuple[list[Path], list[str]]:
    """The folders among these and below, each once; no lines, as nothing else is looked at."""
    return list({folder.resolve(): folder for path in paths for folder in placed_in(path)}.values()), []


def read_task(folder: Path, size: int = PX, stops: float = 0.0) -> Task:
    """Turn a folder into a task of its name: `photo`, the first one, `others` and `places`.

    Args:
        folder: of photographs and text files.
        size: side in px; where it is more than 256, of photographs as fine as that alone.
        stops: by how many stops all of them are too bright.

    Raises:
        ValueError: fewer than two photographs; one that is not square, or of another size; as `read_photo` and
            `read_places`.
    """
    paths = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".") and is_photo(path)]
    if len(paths) < 2:
        raise ValueError(
            f"{folder}: {'1 photo' if paths else 'no photos'} beside places of camera or flash, expected two or more; "
            "add some, or give one photo by its name."
        )
    places = read_places(folder, len(paths))
    shapes = {path: shape_of(path) for path in paths}
    for path, (height, width) in shapes.items():
        if width != height or (height, width) != shapes[paths[0]]:
            raise ValueError(
                f"{path}: {width} x {height} px, expected square photos of one size, all of the same part of the "
                "material; rectify them."
            )
    photo, *others = (rightly_exposed(read_photo(path, size, least=min(size, PX)), stops) for path in paths)
    given = torch.stack([places.camera, places.light], 1)
    return Task(task_name(folder.resolve().name), {"photo": photo, "others": torch.stack(others), "places": given})
