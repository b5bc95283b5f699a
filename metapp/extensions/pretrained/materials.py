"""Real materials for training, whatever maps they lack, beside drawn ones: the format `materials`.

A set of maps without roughness gets one of ROUGHNESS, and a specular reflectance of dielectrics; the task says that
both are made up, and the loss of these maps counts nothing. A specular map without a roughness is that of an old game,
whose colours have shading baked in: they count less. Smaller sets tile and are repeated. Data sets hold drawn ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import torch

from data_tools.readers.conversion import Conversion, Label
from data_tools.readers.material_maps import (
    PLAIN,
    find,
    find_materials,
    material_of,
    read_material,
    recognises,
    split_materials,
)
from data_tools.readers.svbrdf_task import UNITS as OF_MAPS
from data_tools.readers.svbrdf_task import svbrdf_task
from metapp.apps import class_of
from metapp.learning.task import Task
from metapp.storage.manifest import MANIFEST, read_manifest
from metapp.storage.shards import read_shard

__all__ = ["UNITS", "conversion", "find", "read_task", "recognises"]

APP = "svbrdf_nonstationary"
UNITS = {
    **OF_MAPS,
    "known": "float32 [4], what the loss of diffuse, specular, roughness and normals counts; 0: the map is made up",
    "kind": "uint8 [1], 1 of real materials, 0 of drawn ones",
}
ROUGHNESS = 0.6  # where there is none
OLD = 0.3  # what colours with shading in them count


def read_task(source: Path, size: int, normals: str) -> Task:
    """The material that a map belongs to, with what is known of it.

    Args:
        source: one of its maps.
        size: side in px.
        normals: as of `data_tools.readers.material_maps.read_task`.

    Raises:
        ValueError: as there, but for a missing roughness.
    """
    material = material_of(source)
    assert material is not None, source  # it was found by its name
    files = material.files
    has = "roughness" in files or "gloss" in files
    old = PLAIN in files or ("specular" in files and not has)
    if not has:
        # any map stands for the one that is missing until its values are known
        other = next((maps for role, maps in files.items() if role.startswith("normal")), ())
        kept = {role: maps for role, maps in files.items() if role != "specular"}
        material = material._replace(files=kept | ({"roughness": other} if other else {}))
    task = read_material(material, size, normals, least=1)
    times = -(-size // task.data["maps"].shape[-1])
    maps = task.data["maps"].float().repeat(1, times, times)[:, :size, :size]
    if not has:
        maps[6] = ROUGHNESS
    known = torch.tensor([OLD if old else 1.0, has, has, 1.0])
    return _with(svbrdf_task(task.name, maps), known, 1)


def conversion(paths: Iterable[Path], split: str, *, size: int, normals: str) -> Conversion:
    """Conversion of sets of maps, and of drawn materials as they are."""
    paths = list(paths)
    sets, folders = ([path for path in paths if (path / MANIFEST).is_file() == is_set] for is_set in (True, False))
    drawn = {source: one for path in sets for source, one in _drawn(path, size).items()}
    labels: Mapping[Path, Label] = split_materials(find_materials(folders)[0]) if folders else {}

    def found(some: Iterable[Path]) -> tuple[list[Path], list[str]]:
        some = list(some)
        scans = [path for path in some if path not in sets]
        sources, skipped = find(scans) if scans else ([], [])
        return [*sources, *(source for source in drawn if source.parent in some)], skipped

    def read(source: Path) -> Task:
        return _with(drawn[source][0], torch.ones(4), 0) if source in drawn else read_task(source, size, normals)

    def label(source: Path) -> Label:
        return drawn[source][1] if source in drawn else labels[source.resolve()]

    notes = {"made_by": "metapp data materials", "size": size, "normals": normals}
    return Conversion(APP, "material", UNITS, found, read, notes, label)


def _with(task: Task, known: torch.Tensor, kind: int) -> Task:
    return task._replace(data=task.data | {"known": known, "kind": torch.tensor([kind], dtype=torch.uint8)})


def _drawn(folder: Path, size: int) -> dict[Path, tuple[Task, Label]]:
    """The tasks of a data set by their files, and where they belong.

    Raises:
        ValueError: as `read_shard`; maps of another size; photos alone.
    """
    drawn = {}
    entries = read_manifest(folder).tasks
    for entry, task in zip(entries, read_shard(folder, app=APP, holds=class_of(APP).tensors), strict=True):
        side = task.data["maps"].shape[-1] if "maps" in task.data else 0
        if side != size:
            found = f"maps of {side} px" if side else "a photo without maps"
            raise ValueError(f"{folder / entry.file}: {found}, expected maps of {size} px; set --size, or draw others.")
        task = task._replace(data={key: task.data[key] for key in OF_MAPS})
        drawn[folder / entry.file] = task, Label(entry.name, entry.group, entry.split)
    return drawn
