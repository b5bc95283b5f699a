"""Materials that are kept as separate maps in a folder, under the usual names, as tasks.

A file is called after its material and its role, such as `rock_diff_4k.jpg`, `RockNormalGL.png` or just `normal.png` in
a folder of the material's name; case and a size at the end do not count. Colours of integer files are sRGB, all other
maps are data.

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
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.readers import photos
from data_tools.readers.arrays import check_range, checked, is_pil, pixels_of, planes_of
from data_tools.readers.colours import LINEAR
from data_tools.readers.image_files import SUFFIXES, Pixels, read_pixels, shape_of
from data_tools.readers.listing import Found, files_below
from data_tools.readers.photos import SIZE, central_square, resample, side_of
from data_tools.readers.svbrdf_task import UNITS as UNITS
from data_tools.readers.svbrdf_task import svbrdf_task, task_name, unit_normals
from metapp.appearance.flash import Maps, pack
from metapp.appearance.surface import DIELECTRIC, from_metallic
from metapp.learning.task import Task
from metapp.storage.files import read_bytes
from metapp.storage.shards import Entry

_ROLES = {
    "base colour": ("diffuse", "diff", "albedo", "basecolor", "basecolour", "color", "colour", "col"),
    "normal": ("normal", "norm", "nrm", "nor"),
    "normal (OpenGL)": ("normalgl", "normgl", "nrmgl", "norgl", "normalopengl", "noropengl"),
    "normal (DirectX)": ("normaldx", "normdx", "nrmdx", "nordx", "normaldirectx", "nordirectx"),
    "roughness": ("roughness", "rough"),
    "gloss": ("gloss", "glossiness", "smoothness"),
    "specular": ("specular", "spec", "f0"),
    "metallic": ("metallic", "metalness", "metal"),
    "": (  # of no use here, but no base colour either
        "ambientocclusion", "ao", "occlusion", "height", "disp", "displacement", "bump", "opacity", "alpha", "mask",
        "emissive", "emission", "glow", "reflect", "cavity", "curvature", "arm", "orm", "rma", "preview", "thumb",
        "thumbnail", "render", "translucency", "sheen", "anisotropy",
    ),
}  # fmt: skip
_ROLE = {word: role for role, words in _ROLES.items() for word in words}
_BODY = ("diffuse", "diff")
PLAIN = "plain"  # a colour by its place beside the others
_NORMALS = ("normal (OpenGL)", "normal", "normal (DirectX)")
_WORD = re.compile(r"\d+[kK](?![a-z])|[A-Z]+(?![a-z])\d*|[A-Z]?[a-z]+\d*|\d+")
_RESOLUTION = re.compile(r"\d{1,2}k|128|256|512|1024|2048|4096|8192", re.IGNORECASE)
_IS_CLEAR = 0.2  # correlation of the two mixed slopes, 1 for an exact height field and -1 for an upturned one
_SAME_SHAPE = 0.02  # log of a ratio of width to height
_UNIT = 0.1  # by which the length of normals, which may be averages, differs from 1 in the mean at most
OR_MAPS = " or maps (a dictionary of such)"  # what errors say of objects in memory
_EXPECTED = "expected names such as rock_diffuse.png, rock_normal.png, rock_roughness.png"


class Material(NamedTuple):
    """The maps of a material: their folder, its name in files ("" for none), and the files by role."""

    folder: Path
    name: str
    files: Mapping[str, tuple[Path, ...]]

    @property
    def title(self) -> str:
        """The material's own name, or its folder's."""
        return self.name or self.folder.resolve().name

    @property
    def source(self) -> Path:
        """The file that stands for all."""
        return min(self.maps)

    @property
    def maps(self) -> list[Path]:
        """All its files."""
        return [file for files in self.files.values() for file in files]

    def __str__(self) -> str:
        return str(self.folder / self.name)


def recognises(path: Path) -> bool:
    """True for one of the maps of a material, and for a folder with a material at any depth."""
    if not path.is_dir():
        return path.is_file() and material_of(path) is not None
    return any(materials_in(folder)[0] for folder in {file.parent for file in files_below(path, SUFFIXES)})


def find(path: Path) -> Found:
    """One file of each material in a folder at any depth, or of the one of a named map; and files that are no map.

    Raises:
        ValueError: a path that does not exist, a folder without a map.
    """
    files, skipped = photos.find(path)
    if not path.is_dir():
        return [_material(path).source], []
    in_folders = [materials_in(folder) for folder in sorted({file.parent for file in files})]
    materials = [material.source for some, _ in in_folders for material in some]
    if not materials:
        names = ", ".join(file.name for file in files[:3])
        raise ValueError(f"{path}: no maps in this folder ({names}), {_EXPECTED}; rename them.")
    others = [file for _, files in in_folders for file in files]
    return materials, skipped + [f"{file}: no map under a usual name, {_EXPECTED}; rename it." for file in others]


def material_of(file: Path) -> Material | None:
    """The material that a map belongs to."""
    materials = materials_in(file.parent)[0]
    return next((material for material in materials if file.name in [map_.name for map_ in material.maps]), None)


def _material(file: Path) -> Material:
    if material := material_of(file):
        return material
    raise ValueError(f"{file}: no map under a usual name, {_EXPECTED}; rename it, or name a folder.")


def materials_in(folder: Path) -> tuple[list[Material], list[Path]]:
    """The materials right in a folder, by name, and image files that are no map."""
    images = sorted(file for file in folder.iterdir() if file.is_file() and file.suffix.lower() in SUFFIXES)
    images = [file for file in images if not file.name.startswith(".")]
    names: dict[str, str] = {}
    roles: dict[str, dict[str, tuple[Path, ...]]] = {}
    plain: list[tuple[str, Path]] = []
    for file in images:
        name, role = _parts(file.stem)
        if role is None:
            plain.append((name, file))
        elif role:
            names.setdefault(name.lower(), name)
            maps = roles.setdefault(name.lower(), {})
            maps[role] = (*maps.get(role, ()), file)
    others = []
    for name, file in plain:
        maps = roles.get(name.lower(), {})
        if maps and "base colour" not in maps:
            maps[PLAIN] = (*maps.get(PLAIN, ()), file)
        elif not maps:
            others.append(file)
    return [Material(folder, names[key], roles[key]) for key in sorted(roles)], others


def lies_aside(file: Path) -> bool:
    """True for a file of a material that is of no use here, by its name, such as heights."""
    return _parts(file.stem)[1] == ""


def _parts(stem: str) -> tuple[str, str | None]:
    """A stem as the material's name and a role: "" for one of no use here, None for none."""
    words = list(_WORD.finditer(stem))
    end = len(words)
    while end > 1 and _RESOLUTION.fullmatch(words[end - 1].group()):
        end -= 1
    for count in (3, 2, 1):  # NormalOpenGL, nor_gl, normal
        tail = "".join(word.group() for word in words[max(end - count, 0) : end]).lower()
        if end >= count and tail in _ROLE:
            return stem[: words[end - count].start()].rstrip("_-. "), _ROLE[tail]
    return stem, None


def read_task(source: Path, size: int = SIZE, normals: str = "auto", least: int = 0) -> Task:
    """The material that a map belongs to as a task, photographed by the renderer.

    Args:
        source: one of its maps.
        size: side in px; of each map the central square counts.
        normals: whether green points up ("opengl") or down ("directx"); "auto": as names say, else as a height field
            could have it, up if that is not clear.
        least: as of `photo_of`, if all maps are smaller.

    Raises:
        ValueError: as `read_pixels`; a map that is missing or there twice, maps of different shapes, NaN, black,
            normals that are none.
    """
    return read_material(_material(source), size, normals, least)


def task_of_arrays(maps: Mapping[Any, object], name: str, size: int = SIZE, least: int = 0) -> Task:
    """As `read_task`, of maps in memory.

    Args:
        maps: pictures as of `pixels_of` by their usual names, such as "diffuse", "normal", "roughness", "specular".
            Integers are as files hold them: colours sRGB, normals 0..255 for -1..1. Floating-point values are linear:
            colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of the surface.
        name: of the material.
        size, least: as of `read_task`.
    """
    words = {key: _parts(str(key))[1] for key in maps}
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
    return _task(Material(Path(), name, roles), files.__getitem__, side_of(side, size, least), "auto")


def _map_of(subject: str, source: object, role: str) -> tuple[str, Pixels]:
    """The role of a map in memory and its values, those of floating point linear, normals 0..1 for -1..1."""
    if is_pil(source) or (values := planes_of(subject, source)).dtype.kind != "f":
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
    return role, checked(subject, Pixels(values.astype(np.float32), LINEAR, False))


def read_material(material: Material, size: int = SIZE, normals: str = "auto", least: int = 0) -> Task:
    """As `read_task`, of a material that was found."""
    side = max(min(shape_of(file)) for file in _choose(material).values())
    size = side_of(side, size, least)
    return _task(material, read_pixels, size, normals)


def _task(material: Material, pixels_of: Callable[[Path], Pixels], size: int, normals: str) -> Task:
    chosen = _choose(material)
    shapes: dict[str, tuple[int, int]] = {}
    maps = {role: _read(file, pixels_of(file), size, role, shapes) for role, file in chosen.items()}
    _check_shapes(material, chosen, shapes)
    colour = maps["base colour"] if "base colour" in maps else maps[PLAIN]
    if "metallic" in maps:
        diffuse, specular = from_metallic(colour, _gray(maps["metallic"]))
    else:
        diffuse, specular = colour, maps.get("specular", torch.full_like(colour, DIELECTRIC))
    if "roughness" in maps:
        roughness = _gray(maps["roughness"])
    elif PLAIN in maps:  # that of a GGX lobe whose peak is as bright
        roughness = (DIELECTRIC / 4 / _gray(maps["gloss"]).clamp_min(1e-6)).sqrt().sqrt().clamp_max(1)
    else:
        roughness = 1 - _gray(maps["gloss"])
    role = next(role for role in _NORMALS if role in maps)
    normal = unit_normals(maps[role], chosen[role])
    if normals == "auto" and role == "normal":
        is_down = mixed_slopes(normal) < -_IS_CLEAR
    else:
        is_down = normals == "directx" or (normals == "auto" and role == "normal (DirectX)")
    if is_down:
        normal = normal * normal.new_tensor([1, -1, 1])[:, None, None]
    if not max(float(diffuse.max()), float(specular.max())) > 0:
        raise ValueError(
            f"{material}: diffuse and specular are black, expected a material that reflects; leave it out."
        )
    return svbrdf_task(material.title, pack(Maps(diffuse, specular, roughness, normal)))


def mixed_slopes(normal: Tensor) -> float:
    """Correlation 2 <u v> / <u^2 + v^2> of the mixed second derivatives of a height with normals [3, H, W].

    A height field has u = v and 1, one whose y is turned over -1, a plane 0.
    """
    slopes = -normal[:2] / normal[2:].clamp_min(0.1)
    along_x = (slopes[1, :, 2:] - slopes[1, :, :-2])[1:-1]
    along_y = (slopes[0, :-2] - slopes[0, 2:])[:, 1:-1]
    total = float((along_x.square() + along_y.square()).sum())
    return 2 * float((along_x * along_y).sum()) / total if total > 0 else 0.0


def entries(sources: Sequence[Path], folders: object, split: str) -> dict[Path, Entry]:
    """Materials by their maps; those with the very same file of normals are a group, as variants."""
    found: dict[Path, Entry] = {}
    groups: dict[str, str] = {}
    for source in sources:
        material = _material(source)
        files = next((material.files[role] for role in _NORMALS if role in material.files), (material.source,))
        digest = hashlib.sha256(read_bytes(files[0])).hexdigest()
        group = groups.setdefault(digest, material.title)
        found[source] = Entry(task_name(material.title), group=group)
    return found


def _choose(material: Material) -> dict[str, Path]:
    """One file for each role that counts."""
    roles = _specular_workflow(material.files)
    found = ", ".join(sorted(file.name for file in material.maps))
    needed = {
        "base colour": ("base colour", PLAIN),
        "normal": _NORMALS,
        "roughness or gloss": ("roughness", "gloss"),
        "": ("metallic", "specular"),
    }
    chosen = {}
    for noun, candidates in needed.items():
        role = next((role for role in candidates if role in roles), None)
        if role is None and noun:
            raise ValueError(f"{material}: no {noun} map ({found}), {_EXPECTED}; add it.")
        if role is None:
            continue
        if len(roles[role]) > 1:
            names = " and ".join(file.name for file in roles[role][:2])
            raise ValueError(f"{material}: {names} for {noun or role}, expected one of them; remove or rename others.")
        chosen[role] = roles[role][0]
    return chosen


def _specular_workflow(roles: Mapping[str, tuple[Path, ...]]) -> dict[str, tuple[Path, ...]]:
    """The maps without those of the metallic workflow if those of both are there, as in our asset folders."""

    def last_word(file: Path) -> str:
        words = [word.group() for word in _WORD.finditer(file.stem) if not _RESOLUTION.fullmatch(word.group())]
        return words[-1].lower() if words else ""

    colours = roles.get("base colour", ())
    diffuse = tuple(file for file in colours if last_word(file) in _BODY)
    if not ("specular" in roles and len(diffuse) == 1 and len(colours) == 2):
        return dict(roles)
    return {role: files for role, files in roles.items() if role != "metallic"} | {"base colour": diffuse}


def _read(file: Path, pixels: Pixels, size: int, role: str, shapes: dict[str, tuple[int, int]]) -> Tensor:
    """The central square of a map, [3, size, size] in [0, 1]; its whole size in px goes to `shapes`."""
    height, width = pixels.values.shape[:2]
    shapes[role] = height, width
    is_colour = role in ("base colour", PLAIN, "specular")
    values = pixels.values[..., :3]  # alpha holds opacity or something else again
    square = central_square(pixels._replace(values=values, space=pixels.space if is_colour else LINEAR))
    linear = resample(square, size)
    if not np.isfinite(linear).all():
        raise ValueError(f"{file}: holds NaN, expected finite values; export the map again.")
    return torch.from_numpy(linear).permute(2, 0, 1).float()


def _check_shapes(material: Material, files: Mapping[str, Path], shapes: Mapping[str, tuple[int, int]]) -> None:
    """Sizes may differ, but not the ratio of width to height."""
    ratios = {role: math.log(width / height) for role, (height, width) in shapes.items()}
    low, high = min(ratios, key=ratios.__getitem__), max(ratios, key=ratios.__getitem__)
    if ratios[high] - ratios[low] > _SAME_SHAPE:
        differ = " and ".join(f"{files[role].name} {shapes[role][1]}x{shapes[role][0]} px" for role in (high, low))
        raise ValueError(f"{material}: {differ}, expected maps of one shape; crop or scale them alike.")


def _gray(values: Tensor) -> Tensor:
    return values.mean(0, keepdim=True)
