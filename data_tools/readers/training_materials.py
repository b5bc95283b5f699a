"""Real materials for training, whatever maps they lack, beside drawn ones: the format `materials`.

A set of maps without roughness gets one of ROUGHNESS, and a specular reflectance of dielectrics; the task says that
both are made up, and the loss of these maps counts nothing. A specular map without a roughness is that of an old game,
whose colours have shading baked in: they count less. Smaller sets tile and are repeated. Data sets hold drawn ones.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from pathlib import Path

import torch

from data_tools.readers import material_maps
from data_tools.readers.input_source import Sources, sources_of_files
from data_tools.readers.map_names import PLAIN_COLOUR_ROLE
from data_tools.readers.material_maps import material_of, read_material
from data_tools.readers.svbrdf_task import UNITS as OF_MAPS
from data_tools.readers.svbrdf_task import make_svbrdf_task
from metapp.apps import class_of
from metapp.learning.task import Task
from metapp.storage.folders import SHARD_SUFFIX, PathKind, path_kind
from metapp.storage.shards import ManifestEntry, read_data_set, read_manifest

APP = "svbrdf_nonstationary"
UNITS = {
    **OF_MAPS,
    "known": "float32 [4], what the loss of diffuse, specular, roughness and normals counts; 0: the map is made up",
    "kind": "uint8 [1], 1 of real materials, 0 of drawn ones",
}
MISSING_ROUGHNESS = 0.6  # where there is none
SHADED_COLOUR_WEIGHT = 0.3  # what colours with shading in them count


def find(path: Path) -> Sources:
    """Find one file of each set of maps, or all files of a data set; errors as of maps and `read_data_set`."""
    if path_kind(path) is PathKind.DATA_SET:
        return sources_of_files(([path / file for file in _drawn(path)], []))
    return material_maps.find(path)


def entries(sources: Sequence[Path], folders: Iterable[Path], split: str) -> dict[Path, ManifestEntry]:
    """As of maps; of data sets as their manifests have them."""
    drawn = {source: _drawn(source.parent)[source.name][0] for source in sources if source.suffix == SHARD_SUFFIX}
    return material_maps.entries([source for source in sources if source not in drawn], folders, split) | drawn


def read_task(
    source: Path, size: int, normals: str, layer: str = "", content: material_maps.MaterialFiles | None = None
) -> Task:
    """Read the material that a map belongs to, with the weights of its maps.

    Args:
        source: one of its maps, or a drawn material's file in its data set.
        size: side in px.
        normals, layer, content: as of `data_tools.readers.material_maps.read_task`.

    Raises:
        ValueError: as there, but for a missing roughness; a drawn material of another size, or a photo alone.
    """
    if source.suffix == SHARD_SUFFIX:
        return _drawn_task(source, size)
    material = content or material_of(source)
    assert material is not None, source  # it was found by its name
    files = material.files
    has = "roughness" in files or "gloss" in files
    old = PLAIN_COLOUR_ROLE in files or ("specular" in files and not has)
    if not has:
        # any map stands for the one that is missing until its values are known
        other = next((maps for role, maps in files.items() if role.startswith("normal")), ())
        kept = {role: maps for role, maps in files.items() if role != "specular"}
        material = material._replace(files=kept | ({"roughness": other} if other else {}))
    task = read_material(material, size, normals, 1, layer)
    times = -(-size // task.data["maps"].shape[-1])
    maps = task.data["maps"].float().repeat(1, times, times)[:, :size, :size]
    if not has:
        maps[6] = MISSING_ROUGHNESS
    known = torch.tensor([SHADED_COLOUR_WEIGHT if old else 1.0, has, has, 1.0])
    return _with(make_svbrdf_task(task.name, maps), known, 1)


def _with(task: Task, known: torch.Tensor, kind: int) -> Task:
    return task._replace(data=task.data | {"known": known, "kind": torch.tensor([kind], dtype=torch.uint8)})


def _drawn_task(source: Path, size: int) -> Task:
    _, task = _drawn(source.parent)[source.name]
    side = task.data["maps"].shape[-1] if "maps" in task.data else 0
    if side != size:
        found = f"maps of {side} px" if side else "a photo without maps"
        raise ValueError(f"{source}: {found}, expected maps of {size} px; set --size, or draw others.")
    return _with(task._replace(data={key: task.data[key] for key in OF_MAPS}), torch.ones(4), 0)


@functools.lru_cache(maxsize=8)
def _drawn(folder: Path) -> dict[str, tuple[ManifestEntry, Task]]:
    """The tasks of a data set by their files, and its manifest's entry of each; ValueError as of `read_data_set`."""
    tasks = read_data_set(folder, app=APP, holds=class_of(APP).tensors)
    return {entry.file: (entry, task) for entry, task in zip(read_manifest(folder).tasks, tasks, strict=True)}
