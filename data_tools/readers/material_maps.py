"""Materials that are kept as separate maps in a folder, under the usual names, as tasks.

A file is called after its material and its role, such as `rock_diff_4k.jpg`, `RockNormalGL.png` or just `normal.png` in
a folder of the material's name; case and a size at the end do not count. Colours of integer files are sRGB, all other
maps are data; floating-point normals may be -1..1, and z may be left out (`normal_maps`). Files of packed channels,
`rock_arm.png`, have several roles. Variants, `ROCK_COL_VAR1.jpg`, and tiles, `rock_normal.1001.png`, are materials that
share the files without a mark.

Roughness is 1 - gloss if there is none. With a metallic map m diffuse = base (1 - m) and specular = 0.04 (1 - m) +
base m, a specular map being left aside, but for a diffuse map beside the base colour, as in metapp's asset folders.
Without both, specular is 0.04.

Old games keep a colour without any role in its name, `rock.png`, beside `rock_norm.png` and `rock_gloss.png`. Their
gloss is the strength g of a highlight, in display values: the roughness is that of a GGX lobe of specular 0.04 whose
peak is as bright, pi D F / 4 = g, so alpha^2 = 0.01 / g, at most 1.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.readers import square_photos
from data_tools.readers.arrays import check_pixels, check_range, is_pil, picture_values, pixels_of
from data_tools.readers.colours import LINEAR_SPACE
from data_tools.readers.image_files import IMAGE_SUFFIXES, Pixels, read_pixels, shape_of
from data_tools.readers.input_source import Source, Sources
from data_tools.readers.listing import files_below
from data_tools.readers.map_names import (
    COLOUR_ROLES,
    NORMAL_ROLES,
    PACKED_CHANNEL_ROLES,
    PLAIN_COLOUR_ROLE,
    parse_map_name,
)
from data_tools.readers.normal_maps import complete_normals
from data_tools.readers.square_photos import SIZE, central_square, reading_side_px, resample_square
from data_tools.readers.svbrdf_task import UNITS as UNITS
from data_tools.readers.svbrdf_task import decode_unit_normals, make_svbrdf_task, task_name
from metapp.appearance.flash import Maps, pack_maps
from metapp.appearance.surface import DIELECTRIC_F0, metallic_to_specular
from metapp.learning.task import Task
from metapp.storage.files import read_bytes
from metapp.storage.folders import cached_lookup, list_folder
from metapp.storage.shards import ManifestEntry

_IS_CLEAR = 0.2  # correlation of the two mixed slopes, 1 for an exact height field and -1 for an upturned one
_SAME_SHAPE = 0.02  # log of a ratio of width to height
_UNIT = 0.1  # by which the length of normals, which may be averages, differs from 1 in the mean at most
OR_MAPS_TEXT = " or maps (a dictionary of such)"  # what errors say of objects in memory
_EXPECTED = "expected names such as rock_diffuse.png, rock_normal.png, rock_roughness.png"


class MaterialFiles(NamedTuple):
    """The maps of a material.

    Attributes:
        folder: of all.
        name: in files, "" for none; of one of several variants or tiles with its mark.
        files: by role; a file of packed channels has several.
        unknown: other images whose names begin alike.
    """

    folder: Path
    name: str
    files: Mapping[str, tuple[Path, ...]]
    unknown: tuple[Path, ...] = ()

    @property
    def title(self) -> str:
        """The material's own name, or its folder's."""
        return self.name or self.folder.resolve().name

    @property
    def source(self) -> Path:
        """The file that stands for all: the colour, which variants do not share."""
        return min(next((self.files[role] for role in COLOUR_ROLES if role in self.files), self.maps))

    @property
    def maps(self) -> list[Path]:
        """All its files."""
        return list(dict.fromkeys(file for files in self.files.values() for file in files))

    def __str__(self) -> str:
        return str(self.folder / self.name)


def recognises(path: Path) -> bool:
    """True for one of the maps of a material, and for a folder with a material at any depth."""
    if not path.is_dir():
        return path.is_file() and material_of(path) is not None
    return any(list_materials(folder)[0] for folder in {file.parent for file in files_below(path, IMAGE_SUFFIXES)})


def find(path: Path) -> Sources:
    """Find one file of each material in a folder at any depth, or of the one of a named map; and files that are no map.

    Raises:
        ValueError: a path that does not exist, a folder without a map.
    """
    files, skipped = square_photos.find_images(path)
    if not path.is_dir():
        return [_source_of(_material(path))], []
    in_folders = [list_materials(folder) for folder in sorted({file.parent for file in files})]
    materials = [_source_of(material) for some, _ in in_folders for material in some]
    if not materials:
        names = ", ".join(file.name for file in files[:3])
        raise ValueError(f"{path}: no maps in this folder ({names}), {_EXPECTED}; rename them.")
    others = [file for _, files in in_folders for file in files]
    return materials, skipped + [f"{file}: no map under a usual name, {_EXPECTED}; rename it." for file in others]


def _source_of(material: MaterialFiles) -> Source:
    return Source(material.title, material.source, content=material)


def material_of(file: Path) -> MaterialFiles | None:
    """The material that a map belongs to."""
    materials = list_materials(file.parent)[0]
    return next((material for material in materials if file.name in [map_.name for map_ in material.maps]), None)


def _material(file: Path) -> MaterialFiles:
    if material := material_of(file):
        return material
    raise ValueError(f"{file}: no map under a usual name, {_EXPECTED}; rename it, or name a folder.")


@cached_lookup
def list_materials(folder: Path) -> tuple[list[MaterialFiles], list[Path]]:
    """The materials right in a folder, by name, and image files whose role is unknown."""
    files = (Path(entry.path) for entry in list_folder(str(folder)) if entry.is_file())
    images = sorted(file for file in files if file.suffix.lower() in IMAGE_SUFFIXES)
    parts = {file: parse_map_name(file.stem) for file in images if not file.name.startswith(".")}
    names = {name.lower() for name, _, role in parts.values() if role}
    groups: dict[str, dict[Path, tuple[str, str, str]]] = {}
    plain = []
    for file, (name, mark, role) in parts.items():
        if role is None or file.stem.lower() in names:  # rusty_metal beside rusty_metal_normal is no metal
            plain.append(file)
        elif role:
            groups.setdefault(name.lower(), {})[file] = name, mark, role
    for key, group in list(groups.items()):
        (name, _, _), *more = group.values()
        if not more and any(begin in groups for begin in _beginnings(name) - {key}):
            plain += groups.pop(key)  # no material: its role is of more words than are known
    others = []
    for file in plain:
        maps = groups.get(file.stem.lower())
        if maps and not any(role in COLOUR_ROLES[:2] for _, _, role in maps.values()):
            maps[file] = file.stem, "", PLAIN_COLOUR_ROLE
        else:
            others.append(file)
    stems = {file.stem.lower(): file for file in others}
    unknown: dict[str, set[Path]] = {key: set() for key in groups}
    for file in others:
        for key in _beginnings(file.stem) & groups.keys():
            unknown[key].add(file)
    for key, group in groups.items():
        unknown[key] |= {stems[begin] for begin in _beginnings(next(iter(group.values()))[0]) & stems.keys()}
    made = [
        MaterialFiles(folder, *variant, tuple(sorted(unknown[key])))
        for key in sorted(groups)
        for variant in _variants(folder, groups[key])
    ]
    return made, sorted(others)


def _beginnings(stem: str) -> set[str]:
    """The names that a name begins with, before another word, in small letters."""
    return {stem[:end].rstrip("_-. ").lower() for end in range(len(stem) + 1) if not stem[end : end + 1].islower()}


def _variants(
    folder: Path, group: Mapping[Path, tuple[str, str, str]]
) -> Iterator[tuple[str, dict[str, tuple[Path, ...]]]]:
    """Name and files by role of each variant or tile of a material; they share files without a mark."""
    by_role: dict[str, dict[str, tuple[Path, ...]]] = {}
    for file, (_, mark, role) in group.items():
        marked = by_role.setdefault(role, {})
        marked[mark] = (*marked.get(mark, ()), file)
    marks = sorted({mark for marked in by_role.values() if len(marked) > 1 or "" not in marked for mark in marked})
    name = next(iter(group.values()))[0]
    for mark in marks or [""]:
        files = {role: marked.get(mark, marked.get("")) for role, marked in by_role.items()}
        shown = f"{name or folder.resolve().name}_{mark}" if mark and len(marks) > 1 else name
        yield shown, _unpacked({role: some for role, some in files.items() if some})


def _unpacked(files: dict[str, tuple[Path, ...]]) -> dict[str, tuple[Path, ...]]:
    """The files by role, those of packed channels for each of their roles that has no file of its own."""
    for packed, channels in PACKED_CHANNEL_ROLES.items():
        for file in files.pop(packed, ()):
            for role in filter(None, channels):
                files.setdefault(role, (file,))
    return files


def read_task(
    source: Path,
    size: int = SIZE,
    normals: str = "auto",
    least: int = 0,
    layer: str = "",
    content: MaterialFiles | None = None,
) -> Task:
    """Turn the material that a map belongs to into a task, photographed by the renderer.

    Args:
        source: one of its maps.
        size: side in px; of each map the central square counts.
        normals: whether green points up ("opengl") or down ("directx"); "auto": as names say, else as a height field
            could have it, up if that is not clear.
        least: as of `photo_of`, if all maps are smaller.
        layer: as of `read_pixels`, of each map.
        content: the material, as `find` found it.

    Raises:
        ValueError: as `read_pixels`; a map that is missing or there twice, maps of different shapes, NaN, black,
            normals that are none.
    """
    return read_material(content or _material(source), size, normals, least, layer)


def task_of_arrays(maps: Mapping[Any, object], name: str, size: int = SIZE, least: int = 0) -> Task:
    """As `read_task`, of maps in memory.

    Args:
        maps: pictures as of `pixels_of` by their usual names, such as "diffuse", "normal", "roughness", "specular".
            Integers are as files hold them: colours sRGB, normals 0..255 for -1..1. Floating-point values are linear:
            colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of the surface.
        name: of the material.
        size, least: as of `read_task`.
    """
    words = {key: parse_map_name(str(key)).role for key in maps}
    unknown = [key for key, role in words.items() if role is None]
    if unknown or len(set(filter(None, words.values()))) < 2:
        found = f"a map {unknown[0]!r}" if unknown else f"maps {', '.join(map(str, maps)) or 'none'}"
        raise ValueError(f"{name}: {found}, expected diffuse, normal, roughness, and, if there is one, specular.")
    files: dict[Path, Pixels] = {}
    roles: dict[str, tuple[Path, ...]] = {}
    for key, word in words.items():
        if word:
            role, pixels = _map_of(f"{name}: {key}", maps[key], word)
            files[file := Path(f"{name}_{key}")] = pixels
            roles[role] = (*roles.get(role, ()), file)
    side = max(min(pixels.values.shape[:2]) for pixels in files.values())
    material = MaterialFiles(Path(), name, _unpacked(roles))
    return _task(material, lambda file, _: files[file], reading_side_px(side, size, least), "auto")


def _map_of(subject: str, source: object, role: str) -> tuple[str, Pixels]:
    """The role of a map in memory and its values, those of floating point linear, normals 0..1 for -1..1."""
    if is_pil(source) or (values := picture_values(subject, source)).dtype.kind != "f":
        return role, pixels_of(subject, source)
    if not role.startswith("normal"):
        check_range(subject, values, "linear values", "scale them to it")
    else:
        check_range(subject, values, "unit vectors", "divide them by their length", -1.0)
        lengths = np.linalg.norm(values, axis=-1)
        if np.abs(lengths - 1).mean() > _UNIT:
            raise ValueError(
                f"{subject}: vectors of length {lengths.min():.3g} to {lengths.max():.3g}, expected unit vectors "
                "[H, W, 3], x right, y up; of values in [0, 1] take 2 v - 1."
            )
        values, role = values * 0.5 + 0.5, "normal (OpenGL)" if role == "normal" else role
    return role, check_pixels(subject, Pixels(values.astype(np.float32), LINEAR_SPACE, False))


def read_material(
    material: MaterialFiles, size: int = SIZE, normals: str = "auto", least: int = 0, layer: str = ""
) -> Task:
    """As `read_task`, of a material that was found."""
    side = max(min(shape_of(file)) for file in _choose(material).values())
    size = reading_side_px(side, size, least)

    def pixels_of_map(file: Path, role: str) -> Pixels:
        return read_pixels(file, layer, lacks_blue=role in NORMAL_ROLES)

    return _task(material, pixels_of_map, size, normals)


def _task(material: MaterialFiles, pixels_of_map: Callable[[Path, str], Pixels], size: int, normals: str) -> Task:
    chosen = _choose(material)
    shapes: dict[str, tuple[int, int]] = {}
    maps = {role: _read(file, pixels_of_map(file, role), size, role, shapes) for role, file in chosen.items()}
    _check_shapes(material, chosen, shapes)
    colour = next(maps[role] for role in COLOUR_ROLES if role in maps)
    if "metallic" in maps:
        diffuse, specular = metallic_to_specular(colour, _gray(maps["metallic"]))
    else:
        diffuse, specular = colour, maps.get("specular", torch.full_like(colour, DIELECTRIC_F0))
    if "roughness" in maps:
        roughness = _gray(maps["roughness"])
    elif PLAIN_COLOUR_ROLE in maps:  # that of a GGX lobe whose peak is as bright
        roughness = (DIELECTRIC_F0 / 4 / _gray(maps["gloss"]).clamp_min(1e-6)).sqrt().sqrt().clamp_max(1)
    else:
        roughness = 1 - _gray(maps["gloss"])
    role = next(role for role in NORMAL_ROLES if role in maps)
    normal = decode_unit_normals(maps[role], chosen[role])
    if normals == "auto" and role == "normal":
        is_down = mixed_slope_correlation(normal) < -_IS_CLEAR
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
    """Correlation 2 <u v> / <u^2 + v^2> of the mixed second derivatives of a height with normals [3, H, W].

    A height field has u = v and 1, one whose y is turned over -1, a plane 0.
    """
    slopes = -normal[:2] / normal[2:].clamp_min(0.1)
    along_x = (slopes[1, :, 2:] - slopes[1, :, :-2])[1:-1]
    along_y = (slopes[0, :-2] - slopes[0, 2:])[:, 1:-1]
    total = float((along_x.square() + along_y.square()).sum())
    return 2 * float((along_x * along_y).sum()) / total if total > 0 else 0.0


def entries(sources: Sequence[Path], folders: object, split: str) -> dict[Path, ManifestEntry]:
    """Materials by their maps; those with the very same file of normals are a group, as variants."""
    found: dict[Path, ManifestEntry] = {}
    groups: dict[str, str] = {}
    for source in sources:
        material = _material(source)
        files = next((material.files[role] for role in NORMAL_ROLES if role in material.files), (material.source,))
        digest = hashlib.sha256(read_bytes(files[0])).hexdigest()
        group = groups.setdefault(digest, material.title)
        found[source] = ManifestEntry(task_name(material.title), group=group)
    return found


def _choose(material: MaterialFiles) -> dict[str, Path]:
    """One file for each role that counts."""
    roles = dict(material.files)
    if {*COLOUR_ROLES[:2], "specular"} <= roles.keys():  # the specular workflow, not the metallic one beside it
        roles = {role: files for role, files in roles.items() if role not in ("base colour", "metallic")}
    if diffuse := roles.pop("diffuse", ()):
        roles["base colour"] = (*roles.get("base colour", ()), *diffuse)
    found = ", ".join(sorted(file.name for file in material.maps))
    unknown = ", ".join(file.name for file in material.unknown[:3])
    remedy = f"; of {unknown} the role is unknown: rename it" if unknown else "; add it"
    needed = {
        "base colour": ("base colour", PLAIN_COLOUR_ROLE),
        "normal": NORMAL_ROLES,
        "roughness or gloss": ("roughness", "gloss"),
        "": ("metallic", "specular"),
    }
    chosen = {}
    for noun, candidates in needed.items():
        role = next((role for role in candidates if role in roles), None)
        if role is None and noun:
            raise ValueError(f"{material}: no {noun} map ({found}), {_EXPECTED}{remedy}.")
        if role is None:
            continue
        if len(roles[role]) > 1:
            names = " and ".join(file.name for file in roles[role][:2])
            raise ValueError(f"{material}: {names} for {noun or role}, expected one of them; remove or rename others.")
        chosen[role] = roles[role][0]
    return chosen


def _read(file: Path, pixels: Pixels, size: int, role: str, shapes: dict[str, tuple[int, int]]) -> Tensor:
    """The central square of a map, [3, size, size] in [0, 1]; its whole size in px goes to `shapes`."""
    height, width = pixels.values.shape[:2]
    shapes[role] = height, width
    is_colour = role in (*COLOUR_ROLES, "specular")
    values = pixels.values[..., :3]  # alpha holds opacity or something else again
    channels = PACKED_CHANNEL_ROLES.get(
        parse_map_name(file.stem if file.suffix.lower() in IMAGE_SUFFIXES else file.name).role or "", ()
    )
    if role in channels:
        channel, count = channels.index(role), pixels.values.shape[-1]
        if channel >= count:
            raise ValueError(f"{file}: {count} channels, expected {role} in alpha; export it with that.")
        values = pixels.values[..., [channel] * 3]
    if role in NORMAL_ROLES:
        values, slopes = pixels.values, pixels.values[..., :2]
        if values.dtype.kind == "f" and (slopes.min() < -0.1 or slopes.mean() < 0.25):  # -1..1
            values = values / 2 + 0.5
        values = complete_normals(values, file)
    square = central_square(pixels._replace(values=values, space=pixels.space if is_colour else LINEAR_SPACE))
    linear = resample_square(square, size)
    if not np.isfinite(linear).all():
        raise ValueError(f"{file}: holds NaN, expected finite values; export the map again.")
    return torch.from_numpy(linear).permute(2, 0, 1).float()


def _check_shapes(material: MaterialFiles, files: Mapping[str, Path], shapes: Mapping[str, tuple[int, int]]) -> None:
    """Sizes may differ, but not the ratio of width to height."""
    ratios = {role: math.log(width / height) for role, (height, width) in shapes.items()}
    low, high = min(ratios, key=ratios.__getitem__), max(ratios, key=ratios.__getitem__)
    if ratios[high] - ratios[low] > _SAME_SHAPE:
        differ = " and ".join(f"{files[role].name} {shapes[role][1]}x{shapes[role][0]} px" for role in (high, low))
        raise ValueError(f"{material}: {differ}, expected maps of one shape; crop or scale them alike.")


def _gray(values: Tensor) -> Tensor:
    return values.mean(0, keepdim=True)
