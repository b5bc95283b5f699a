"""The files of materials that are kept as separate maps in a folder, found by the usual names of maps.

A file is called after its material and its role, such as `rock_diff_4k.jpg`, `RockNormalGL.png` or just `normal.png` in
a folder of the material's name; case and a size at the end do not count. Files of packed channels, `rock_arm.png`, have
several roles. Variants, `ROCK_COL_VAR1.jpg`, and tiles, `rock_normal.1001.png`, are materials that share the files
without a mark.

Old games keep a colour without any role in its name, `rock.png`, beside `rock_norm.png` and `rock_gloss.png`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from typing_extensions import override

from data_tools.readers.map_names import (
    COLOUR_ROLES,
    NORMAL_ROLES,
    PACKED_CHANNEL_ROLES,
    PLAIN_COLOUR_ROLE,
    parse_map_name,
)
from data_tools.readers.opened_images import IMAGE_SUFFIXES
from metapp.storage.folders import cached_lookup, list_folder

EXPECTED_NAMES = "expected names such as rock_diffuse.png, rock_normal.png, rock_roughness.png"


class MaterialFiles(NamedTuple):
    """The files of a material's maps.

    Attributes:
        folder: the folder that holds all of them.
        name: the material's name in the files' names, "" for none; with a mark if it is one of several variants or
            tiles.
        files: the files by role; a file of packed channels has several roles.
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
        """The file that stands for the material: its colour, which variants do not share."""
        return min(next((self.files[role] for role in COLOUR_ROLES if role in self.files), self.maps))

    @property
    def maps(self) -> list[Path]:
        """The files of all maps, each once."""
        return list(dict.fromkeys(file for files in self.files.values() for file in files))

    @override
    def __str__(self) -> str:
        return str(self.folder / self.name)


def material_of(file: Path) -> MaterialFiles | None:
    """Return the material that a map belongs to; None for a file that is no map."""
    materials = list_materials(file.parent)[0]
    return next((material for material in materials if file.name in [map_.name for map_ in material.maps]), None)


def require_material(file: Path) -> MaterialFiles:
    """Return the material that a map belongs to, or raise ValueError for a file that is no map."""
    if material := material_of(file):
        return material
    raise ValueError(f"{file}: no map under a usual name, {EXPECTED_NAMES}; rename it, or name a folder.")


@cached_lookup
def list_materials(folder: Path) -> tuple[list[MaterialFiles], list[Path]]:
    """Return the materials right in a folder, sorted by name, and the image files there whose role is unknown."""
    files = (Path(entry.path) for entry in list_folder(str(folder)) if entry.is_file())
    images = sorted(file for file in files if file.suffix.lower() in IMAGE_SUFFIXES)
    name_parts = {file: parse_map_name(file.stem) for file in images if not file.name.startswith(".")}
    names = {name.lower() for name, _, role in name_parts.values() if role}
    groups: dict[str, dict[Path, tuple[str, str, str]]] = {}
    files_without_role = []
    for file, (name, mark, role) in name_parts.items():
        if role is None or file.stem.lower() in names:  # rusty_metal beside rusty_metal_normal is no metal
            files_without_role.append(file)
        elif role:
            groups.setdefault(name.lower(), {})[file] = name, mark, role
    for key, group in list(groups.items()):
        (name, _, _), *further_files = group.values()
        if not further_files and any(beginning in groups for beginning in _name_beginnings(name) - {key}):
            files_without_role += groups.pop(key)  # not a material of its own: its role has more words than are known
    unknown_files = []
    for file in files_without_role:
        maps = groups.get(file.stem.lower())
        if maps and not any(role in COLOUR_ROLES[:2] for _, _, role in maps.values()):
            maps[file] = file.stem, "", PLAIN_COLOUR_ROLE
        else:
            unknown_files.append(file)
    stems = {file.stem.lower(): file for file in unknown_files}
    unknown_by_key: dict[str, set[Path]] = {key: set() for key in groups}
    for file in unknown_files:
        for key in _name_beginnings(file.stem) & groups.keys():
            unknown_by_key[key].add(file)
    for key, group in groups.items():
        unknown_by_key[key] |= {
            stems[beginning] for beginning in _name_beginnings(next(iter(group.values()))[0]) & stems.keys()
        }
    materials = [
        MaterialFiles(folder, *variant, tuple(sorted(unknown_by_key[key])))
        for key in sorted(groups)
        for variant in _list_variants(folder, groups[key])
    ]
    return materials, sorted(unknown_files)


def _name_beginnings(stem: str) -> set[str]:
    """Return the names that a name may begin with, up to the start of one of its words, in small letters."""
    return {stem[:end].rstrip("_-. ").lower() for end in range(len(stem) + 1) if not stem[end : end + 1].islower()}


def _list_variants(
    folder: Path, group: Mapping[Path, tuple[str, str, str]]
) -> Iterator[tuple[str, dict[str, tuple[Path, ...]]]]:
    """Yield the name and the files by role of each variant or tile of a material; they share the files without a mark.

    Args:
        folder: the folder of the material.
        group: name, mark and role of each of its files.
    """
    by_role: dict[str, dict[str, tuple[Path, ...]]] = {}
    for file, (_, mark, role) in group.items():
        files_by_mark = by_role.setdefault(role, {})
        files_by_mark[mark] = (*files_by_mark.get(mark, ()), file)
    marks = sorted(
        {
            mark
            for files_by_mark in by_role.values()
            if len(files_by_mark) > 1 or "" not in files_by_mark
            for mark in files_by_mark
        }
    )
    name = next(iter(group.values()))[0]
    for mark in marks or [""]:
        files = {role: files_by_mark.get(mark, files_by_mark.get("")) for role, files_by_mark in by_role.items()}
        variant_name = f"{name or folder.resolve().name}_{mark}" if mark and len(marks) > 1 else name
        yield variant_name, unpack_channels({role: role_files for role, role_files in files.items() if role_files})


def unpack_channels(files: dict[str, tuple[Path, ...]]) -> dict[str, tuple[Path, ...]]:
    """Return files by role, with files of packed channels under each of their roles that has no file yet."""
    for packed, channels in PACKED_CHANNEL_ROLES.items():
        for file in files.pop(packed, ()):
            for role in filter(None, channels):
                files.setdefault(role, (file,))
    return files


def choose_files(material: MaterialFiles) -> dict[str, Path]:
    """Choose one file for each role that counts.

    Raises:
        ValueError: a role has no file or several.
    """
    roles = dict(material.files)
    if {
        *COLOUR_ROLES[:2],
        "specular",
    } <= roles.keys():  # the specular workflow is taken, and the metallic one beside it left
        roles = {role: files for role, files in roles.items() if role not in ("base colour", "metallic")}
    if diffuse := roles.pop("diffuse", ()):
        roles["base colour"] = (*roles.get("base colour", ()), *diffuse)
    names_found = ", ".join(sorted(file.name for file in material.maps))
    unknown_names = ", ".join(file.name for file in material.unknown[:3])
    remedy = f"; of {unknown_names} the role is unknown: rename it" if unknown_names else "; add it"
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
            raise ValueError(f"{material}: no {noun} map ({names_found}), {EXPECTED_NAMES}{remedy}.")
        if role is None:
            continue
        if len(roles[role]) > 1:
            names = " and ".join(file.name for file in roles[role][:2])
            raise ValueError(f"{material}: {names} for {noun or role}, expected one of them; remove or rename others.")
        chosen[role] = roles[role][0]
    return chosen
