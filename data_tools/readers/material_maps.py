"""Materials that are kept as separate maps in a folder, under the usual names, as tasks.

The module :mod:`data_tools.readers.material_files` tells by names which files are the maps of a material. Colours of
integer files are sRGB, all other maps are data; floating-point normals may be -1..1, and z may be left out (see
:mod:`normal_maps`).

Roughness is 1 - gloss if there is no roughness map. With a metallic map m, diffuse = base (1 - m) and specular =
0.04 (1 - m) + base m, and a specular map is ignored; but where a diffuse map lies beside the base colour, as in
metapp's asset folders, diffuse and specular maps are taken. With neither metallic nor specular map, specular is 0.04.

The gloss of old games' materials, whose colour has no role in its name, is the strength g of a highlight, in display
values: the roughness is that of a GGX lobe of specular 0.04 whose peak is as bright, pi D F / 4 = g, so alpha^2 =
0.01 / g, at most 1.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from data_tools.readers import square_photos
from data_tools.readers.arrays import check_pixels, check_range, is_pil, picture_values, pixels_of
from data_tools.readers.colours import LINEAR_SPACE
from data_tools.readers.image_files import Pixels, read_pixels, shape_of
from data_tools.readers.input_source import DEFAULT_PHOTO_PX, Source, Sources
from data_tools.readers.listing import files_below
from data_tools.readers.map_names import (
    COLOUR_ROLES,
    NORMAL_ROLES,
    PACKED_CHANNEL_ROLES,
    PLAIN_COLOUR_ROLE,
    parse_map_name,
)
from data_tools.readers.material_files import (
    EXPECTED_NAMES,
    MaterialFiles,
    choose_files,
    list_materials,
    material_of,
    require_material,
    unpack_channels,
)
from data_tools.readers.normal_maps import complete_normals
from data_tools.readers.opened_images import IMAGE_SUFFIXES
from data_tools.readers.square_photos import central_square, reading_side_px, resample
from data_tools.readers.svbrdf_task import UNITS as UNITS
from data_tools.readers.svbrdf_task import decode_unit_normals, make_svbrdf_task, task_name
from metapp.appearance.surface import DIELECTRIC_F0, metallic_to_specular
from metapp.appearance.svbrdf_maps import Maps, pack_maps
from metapp.learning.task import Task
from metapp.storage.files import read_bytes
from metapp.storage.shards import ManifestEntry

# Correlation of mixed slopes from which on it is clear where green points: 1 for an exact height field, -1 for one
# whose y is turned over.
_MIN_CLEAR_CORRELATION = 0.2
_MAX_LOG_RATIO_DIFFERENCE = 0.02  # difference of two maps' log(width / height)
_MAX_LENGTH_ERROR = 0.1  # mean of |length - 1| of normals, which may be averages
OR_MAPS_TEXT = " or maps (a dictionary of such)"  # continues errors about an object in memory


def recognises(path: Path) -> bool:
    """Tell whether a path is one of the maps of a material, or a folder with a material at any depth."""
    if not path.is_dir():
        return path.is_file() and material_of(path) is not None
    return any(list_materials(folder)[0] for folder in {file.parent for file in files_below(path, IMAGE_SUFFIXES)})


def find(path: Path) -> Sources:
    """Find the materials in a folder at any depth, or the one of a named map; images that are no maps are skipped.

    Raises:
        ValueError: the path does not exist, or is a folder without a map.
    """
    images, skipped = square_photos.find_images(path)
    if not path.is_dir():
        return [_make_source(require_material(path))], []
    in_folders = [list_materials(folder) for folder in sorted({file.parent for file in images})]
    materials = [_make_source(material) for folder_materials, _ in in_folders for material in folder_materials]
    if not materials:
        names = ", ".join(file.name for file in images[:3])
        raise ValueError(f"{path}: no maps in this folder ({names}), {EXPECTED_NAMES}; rename them.")
    unknown_files = [file for _, images in in_folders for file in images]
    return materials, skipped + [
        f"{file}: no map under a usual name, {EXPECTED_NAMES}; rename it." for file in unknown_files
    ]


def _make_source(material: MaterialFiles) -> Source:
    """Return a material as a source, at the file that stands for it."""
    return Source(material.title, material.source, content=material)


def read_task(
    source: Path,
    size: int = DEFAULT_PHOTO_PX,
    normals: str = "auto",
    least: int = 0,
    layer: str = "",
    content: MaterialFiles | None = None,
) -> Task:
    """Read the material that a map belongs to as a task, with its photograph rendered.

    Args:
        source: one of the material's maps.
        size: the side of the result, in px; the central square of each map is read.
        normals: whether green points up ("opengl") or down ("directx"); "auto": as names say, else as a height field
            could have it, up if that is not clear.
        least: the least side of the result, in px, to which smaller maps are enlarged; 0: maps are enlarged to `size`.
        layer: the layer of EXR files; see :func:`read_pixels`.
        content: the material, as :func:`find` found it.

    Raises:
        ValueError: a file cannot be read (see :func:`read_pixels`); a map is missing or there twice; maps have
            different shapes, hold NaN or are black; normals are none.
    """
    return read_material(content or require_material(source), size, normals, least, layer)


def task_of_arrays(maps: Mapping[Any, object], name: str, size: int = DEFAULT_PHOTO_PX, least: int = 0) -> Task:
    """Make the task of a material from maps in memory, as :func:`read_task` does from files.

    Args:
        maps: pictures that :func:`pixels_of` reads, by their usual names, such as "diffuse", "normal", "roughness",
            "specular". Integers are as files hold them: colours sRGB, normals 0..255 for -1..1. Floating-point values
            are linear: colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of the surface.
        name: the name of the material.
        size: the side of the result, in px.
        least: the least side of the result, in px, to which smaller maps are enlarged; 0: maps are enlarged to `size`.
    """
    role_by_key = {key: parse_map_name(str(key)).role for key in maps}
    unknown_keys = [key for key, role in role_by_key.items() if role is None]
    if unknown_keys or len(set(filter(None, role_by_key.values()))) < 2:
        found = f"a map {unknown_keys[0]!r}" if unknown_keys else f"maps {', '.join(map(str, maps)) or 'none'}"
        raise ValueError(f"{name}: {found}, expected diffuse, normal, roughness, and, if there is one, specular.")
    files: dict[Path, Pixels] = {}
    roles: dict[str, tuple[Path, ...]] = {}
    for key, named_role in role_by_key.items():
        if named_role:
            role, pixels = _prepare_map(f"{name}: {key}", maps[key], named_role)
            files[file := Path(f"{name}_{key}")] = pixels
            roles[role] = (*roles.get(role, ()), file)
    side = max(min(pixels.values.shape[:2]) for pixels in files.values())
    material = MaterialFiles(Path(), name, unpack_channels(roles))
    return _make_task(material, lambda file, _: files[file], reading_side_px(side, size, least), "auto")


def _prepare_map(subject: str, source: object, role: str) -> tuple[str, Pixels]:
    """Read a map in memory; floating-point values are linear, and their normals become 0..1 for -1..1.

    Args:
        subject: the name of the map in errors.
        source: the map, a picture.
        role: its role by its name.

    Returns:
        The map's role, where floating-point normals point up (OpenGL) unless the name says otherwise, and its values.
    """
    if is_pil(source) or (values := picture_values(subject, source)).dtype.kind != "f":
        return role, pixels_of(subject, source)
    if not role.startswith("normal"):
        check_range(subject, values, "linear values", "scale them to it")
    else:
        check_range(subject, values, "unit vectors", "divide them by their length", -1.0)
        lengths = np.linalg.norm(values, axis=-1)
        if np.abs(lengths - 1).mean() > _MAX_LENGTH_ERROR:
            raise ValueError(
                f"{subject}: vectors of length {lengths.min():.3g} to {lengths.max():.3g}, expected unit vectors "
                "[H, W, 3], x right, y up; of values in [0, 1] take 2 v - 1."
            )
        values, role = values * 0.5 + 0.5, "normal (OpenGL)" if role == "normal" else role
    return role, check_pixels(subject, Pixels(values.astype(np.float32), LINEAR_SPACE, False))


def read_material(
    material: MaterialFiles, size: int = DEFAULT_PHOTO_PX, normals: str = "auto", least: int = 0, layer: str = ""
) -> Task:
    """Read a material that was found as a task, with its photograph rendered.

    Args:
        material: the files of the material.
        size: the side of the result, in px.
        normals: where green points in normal maps; see :func:`read_task`.
        least: the least side of the result, in px, to which smaller maps are enlarged; 0: maps are enlarged to `size`.
        layer: the layer of EXR files; see :func:`read_pixels`.
    """
    side = max(min(shape_of(file)) for file in choose_files(material).values())
    size = reading_side_px(side, size, least)

    def pixels_of_map(file: Path, role: str) -> Pixels:
        return read_pixels(file, layer, lacks_blue=role in NORMAL_ROLES)

    return _make_task(material, pixels_of_map, size, normals)


def _make_task(material: MaterialFiles, pixels_of_map: Callable[[Path, str], Pixels], size: int, normals: str) -> Task:
    """Make the task of a material of the maps that count.

    Args:
        material: the files of the material.
        pixels_of_map: a function that reads a file in a role.
        size: the side of the result, in px.
        normals: where green points in normal maps; see :func:`read_task`.
    """
    chosen = choose_files(material)
    shapes: dict[str, tuple[int, int]] = {}
    maps = {role: _read_map(file, pixels_of_map(file, role), size, role, shapes) for role, file in chosen.items()}
    _check_shapes(material, chosen, shapes)
    colour = next(maps[role] for role in COLOUR_ROLES if role in maps)
    if "metallic" in maps:
        diffuse, specular = metallic_to_specular(colour, _to_gray(maps["metallic"]))
    else:
        diffuse, specular = colour, maps.get("specular", torch.full_like(colour, DIELECTRIC_F0))
    if "roughness" in maps:
        roughness = _to_gray(maps["roughness"])
    elif PLAIN_COLOUR_ROLE in maps:  # the roughness of a GGX lobe whose peak is as bright as the game's
        roughness = (DIELECTRIC_F0 / 4 / _to_gray(maps["gloss"]).clamp_min(1e-6)).sqrt().sqrt().clamp_max(1)
    else:
        roughness = 1 - _to_gray(maps["gloss"])
    role = next(role for role in NORMAL_ROLES if role in maps)
    normal = decode_unit_normals(maps[role], chosen[role])
    if normals == "auto" and role == "normal":
        is_down = mixed_slope_correlation(normal) < -_MIN_CLEAR_CORRELATION
    else:
        is_down = normals == "directx" or (normals == "auto" and role == "normal (DirectX)")
    if is_down:
        normal = normal * normal.new_tensor([1, -1, 1])[:, None, None]
    if not max(float(diffuse.max()), float(specular.max())) > 0:
        raise ValueError(
            f"{material}: diffuse and specular are black, expected a material that reflects; leave it out."
        )
    return make_svbrdf_task(material.title, pack_maps(Maps(diffuse, specular, roughness, normal)))


def mixed_slope_correlation(normal: Tensor) -> float:
    """Return the correlation 2 <u v> / <u^2 + v^2> of the mixed second derivatives u and v of normals' height.

    Of a height field u = v, so the correlation is 1; it is -1 for normals whose y is turned over, and 0 for a plane.

    Args:
        normal: unit normals, [3, H, W].
    """
    slopes = -normal[:2] / normal[2:].clamp_min(0.1)
    u = (slopes[1, :, 2:] - slopes[1, :, :-2])[1:-1]
    v = (slopes[0, :-2] - slopes[0, 2:])[:, 1:-1]
    total = float((u.square() + v.square()).sum())
    return 2 * float((u * v).sum()) / total if total > 0 else 0.0


def entries(sources: Sequence[Path], folders: object, split: str) -> dict[Path, ManifestEntry]:
    """Return the manifest's entry of each material; materials with equal files of normals, as variants, are a group."""
    entry_by_source: dict[Path, ManifestEntry] = {}
    groups: dict[str, str] = {}
    for source in sources:
        material = require_material(source)
        files = next((material.files[role] for role in NORMAL_ROLES if role in material.files), (material.source,))
        digest = hashlib.sha256(read_bytes(files[0])).hexdigest()
        group = groups.setdefault(digest, material.title)
        entry_by_source[source] = ManifestEntry(task_name(material.title), group=group)
    return entry_by_source


def _read_map(file: Path, pixels: Pixels, size: int, role: str, shapes: dict[str, tuple[int, int]]) -> Tensor:
    """Read the central square of a map.

    Args:
        file: the file, whose name tells packed channels.
        pixels: its values.
        size: the side of the result, in px.
        role: the role of the map.
        shapes: height and width of whole maps in px, by role; the map's are added.

    Returns:
        The map, [3, size, size] in [0, 1].
    """
    height, width = pixels.values.shape[:2]
    shapes[role] = height, width
    is_colour = role in (*COLOUR_ROLES, "specular")
    values = pixels.values[..., :3]  # alpha holds opacity or something else
    channels = PACKED_CHANNEL_ROLES.get(
        parse_map_name(file.stem if file.suffix.lower() in IMAGE_SUFFIXES else file.name).role or "", ()
    )
    if role in channels:
        channel, count = channels.index(role), pixels.values.shape[-1]
        if channel >= count:
            raise ValueError(f"{file}: {count} channels, expected {role} in alpha; export it with that.")
        values = pixels.values[..., [channel] * 3]
    if role in NORMAL_ROLES:
        values, xy = pixels.values, pixels.values[..., :2]
        if values.dtype.kind == "f" and (xy.min() < -0.1 or xy.mean() < 0.25):  # stored as -1..1
            values = values / 2 + 0.5
        values = complete_normals(values, file)
    square = central_square(pixels._replace(values=values, space=pixels.space if is_colour else LINEAR_SPACE))
    linear = resample(square, size, size)
    if not np.isfinite(linear).all():
        raise ValueError(f"{file}: holds NaN, expected finite values; export the map again.")
    return torch.from_numpy(linear).permute(2, 0, 1).float()


def _check_shapes(material: MaterialFiles, files: Mapping[str, Path], shapes: Mapping[str, tuple[int, int]]) -> None:
    """Raise ValueError if maps have different ratios of width to height; their sizes may differ.

    Args:
        material: the material, in errors.
        files: its files by role.
        shapes: height and width of the maps in px, by role.
    """
    ratios = {role: math.log(width / height) for role, (height, width) in shapes.items()}
    narrowest, widest = min(ratios, key=ratios.__getitem__), max(ratios, key=ratios.__getitem__)
    if ratios[widest] - ratios[narrowest] > _MAX_LOG_RATIO_DIFFERENCE:
        names_and_sizes = " and ".join(
            f"{files[role].name} {shapes[role][1]}x{shapes[role][0]} px" for role in (widest, narrowest)
        )
        raise ValueError(f"{material}: {names_and_sizes}, expected maps of one shape; crop or scale them alike.")


def _to_gray(values: Tensor) -> Tensor:
    """Return the mean of the channels of a map, [1, H, W]."""
    return values.mean(0, keepdim=True)
