"""Real materials for training, whatever maps they lack, beside drawn ones: the format `materials`.

A set of maps without a roughness map gets MISSING_ROUGHNESS, and the specular reflectance of dielectrics; the task says
that both are made up, and their losses count nothing. A set with a specular but no roughness map comes from an old
game, whose colours have shading baked in: they count less. Smaller sets tile and are repeated. Data sets hold drawn
materials.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from pathlib import Path

import torch

from data_tools.readers import material_maps
from data_tools.readers.input_source import Sources, sources_of_files
from data_tools.readers.map_names import PLAIN_COLOUR_ROLE
from data_tools.readers.material_files import MaterialFiles, material_of
from data_tools.readers.material_maps import read_material
from data_tools.readers.svbrdf_task import UNITS as OF_MAPS
from data_tools.readers.svbrdf_task import make_svbrdf_task
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.storage.folders import SHARD_SUFFIX, is_data_set
from metapp.storage.shards import ManifestEntry, read_data_set, read_manifest

APP = "svbrdf_nonstationary"
UNITS = {
    **OF_MAPS,
    "map_weights": "float32 [4], weights of losses of diffuse, specular, roughness and normals; 0: the map is made up",
    "kind": "uint8 [1], 1 of real materials, 0 of drawn ones",
}
MISSING_ROUGHNESS = 0.6  # roughness of a material that lacks the map
SHADED_COLOUR_WEIGHT = 0.3  # weight of the diffuse loss where colours have shading in them


def find(path: Path) -> Sources:
    """Find one file of each set of maps, or all files of a data set.

    Raises:
        ValueError: the path holds neither; see :func:`material_maps.find` and :func:`read_data_set`.
    """
    if is_data_set(path):
        return sources_of_files(([path / file for file in _read_drawn(path)], []))
    return material_maps.find(path)


def entries(sources: Sequence[Path], folders: Iterable[Path], split: str) -> dict[Path, ManifestEntry]:
    """Return the manifest's entry of each material.

    A drawn material has the entry of its data set, a real one that of :func:`material_maps.entries`.
    """
    drawn_entries = {
        source: _read_drawn(source.parent)[source.name][0] for source in sources if source.suffix == SHARD_SUFFIX
    }
    return (
        material_maps.entries([source for source in sources if source not in drawn_entries], folders, split)
        | drawn_entries
    )


def read_task(source: Path, size: int, normals: str, layer: str = "", content: MaterialFiles | None = None) -> Task:
    """Read the material that a map belongs to, with the weights of its maps.

    Args:
        source: one of the material's maps, or a drawn material's file in its data set.
        size: the side of the maps, in px.
        normals: where green points in normal maps; see :func:`material_maps.read_task`.
        layer: the layer of EXR files; see :func:`data_tools.readers.image_files.read_pixels`.
        content: the material, as :func:`find` found it; None to look for it.

    Raises:
        ValueError: the maps cannot be read (see :func:`material_maps.read_task`), but for a missing roughness; a drawn
            material has another size, or is a photo alone.
    """
    if source.suffix == SHARD_SUFFIX:
        return _read_drawn_task(source, size)
    material = content or material_of(source)
    assert material is not None, source  # `find` found it by the names of its maps
    files = material.files
    has_roughness = "roughness" in files or "gloss" in files
    is_of_game = PLAIN_COLOUR_ROLE in files or ("specular" in files and not has_roughness)
    if not has_roughness:
        # reading needs a file of roughness: the normals take its place, and its values are overwritten below
        stand_in = next((maps for role, maps in files.items() if role.startswith("normal")), ())
        other_files = {role: maps for role, maps in files.items() if role != "specular"}
        material = material._replace(files=other_files | ({"roughness": stand_in} if stand_in else {}))
    task = read_material(material, size, normals, 1, layer)
    repeats = -(-size // task.data["maps"].shape[-1])
    maps = task.data["maps"].float().repeat(1, repeats, repeats)[:, :size, :size]
    if not has_roughness:
        maps[6] = MISSING_ROUGHNESS
    weights = torch.tensor([SHADED_COLOUR_WEIGHT if is_of_game else 1.0, has_roughness, has_roughness, 1.0])
    return _add_weights(make_svbrdf_task(task.name, maps), weights, 1)


def _add_weights(task: Task, weights: torch.Tensor, kind: int) -> Task:
    """Add to a task the weights of its map losses, [4], and its kind, 1 for real materials and 0 for drawn ones."""
    return task._replace(data=task.data | {"map_weights": weights, "kind": torch.tensor([kind], dtype=torch.uint8)})


def _read_drawn_task(source: Path, size: int) -> Task:
    """Return a drawn material of a data set, with weights 1.

    Raises:
        ValueError: the material has another size, or is a photo alone.
    """
    _, task = _read_drawn(source.parent)[source.name]
    side = task.data["maps"].shape[-1] if "maps" in task.data else 0
    if side != size:
        found = f"maps of {side} px" if side else "a photo without maps"
        raise ValueError(
            f"{source}: {found}, expected maps of {size} px; set --size to that of the data set, or draw the set anew."
        )
    return _add_weights(task._replace(data={key: task.data[key] for key in OF_MAPS}), torch.ones(4), 0)


@functools.lru_cache(maxsize=8)
def _read_drawn(folder: Path) -> dict[str, tuple[ManifestEntry, Task]]:
    """Read the manifest's entry and the task of each file of a data set.

    Raises:
        ValueError: the data set cannot be read; see :func:`read_data_set`.
    """
    tasks = read_data_set(folder, app=APP, holds=registry().applications[APP].app.load().tensors)
    return {entry.file: (entry, task) for entry, task in zip(read_manifest(folder).tasks, tasks, strict=True)}
