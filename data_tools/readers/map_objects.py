"""Materials in memory: maps as arrays or as a function of places, and flash photographs; as files.

Maps are a dictionary by their usual names, such as "diffuse", "normal", "roughness", "specular", each a picture as of
`picture_objects`. Integers are as files hold them: colours sRGB, normals 0..255 for -1..1. Floating-point values are
linear, as `metapp.Fit.maps` has them: colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of
the surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from PIL.Image import Image

from data_tools.readers import material_maps
from data_tools.readers.picture_objects import (
    EXPECTED,
    SIDE,
    Array,
    check_range,
    is_picture,
    planes_of,
    rows_of,
    texel_places,
    write_picture,
)
from metapp.storage.images import write_exr

_UNIT = 0.1  # by which the length of normals, which may be averages, differs from 1 in the mean at most


def to_file(source: object, name: str, folder: Path, observe: str) -> Path:
    """Write a material in memory as files.

    Args:
        source: maps; or f(xy) -> maps of [N, 3] or [N], at places xy [N, 2] in [0, 1), float32 arrays, x to the right
            and y down; or a picture, the flash photograph of a material.
        name: of the material.
        folder: where to.
        observe: what fits see; of no use here.

    Returns:
        The photograph, or one of the maps.

    Raises:
        ValueError: none of these; values of another shape or out of range, maps that are missing.
    """
    if callable(source):
        source = _evaluated(name, source(texel_places(SIDE)))
    if isinstance(source, Mapping):
        return _write_maps(name, source, folder)
    if is_picture(source):
        return write_picture(name, source, folder)
    raise ValueError(
        f"{name}: {type(source).__name__}, expected {EXPECTED}, maps (a dictionary of such) or a function f(xy)."
    )


def _evaluated(name: str, returned: object) -> dict[str, Array]:
    """The maps [S, S, 1 or 3] that a function returned for the places of `texel_places`."""
    if not isinstance(returned, Mapping):
        raise ValueError(f"{name}: returned {type(returned).__name__}, expected a dictionary of maps.")
    return {key: rows_of(f"{name}: {key}", values, SIDE**2).reshape(SIDE, SIDE, -1) for key, values in returned.items()}


def _write_maps(name: str, maps: Mapping[str, object], folder: Path) -> Path:
    roles = {key: material_maps.role_of(str(key)) for key in maps}
    unknown = [key for key, role in roles.items() if role is None]
    if unknown or len(set(filter(None, roles.values()))) < 2:
        found = f"a map {unknown[0]!r}" if unknown else f"maps {', '.join(map(str, maps)) or 'none'}"
        raise ValueError(f"{name}: {found}, expected diffuse, normal, roughness, and, if there is one, specular.")
    used = {key: role for key, role in roles.items() if role}
    files = [_write_map(f"{name}: {key}", maps[key], folder / f"{name}_{key}", role) for key, role in used.items()]
    return files[0]


def _write_map(subject: str, source: object, stem: Path, role: str) -> Path:
    """Write one map as PNG, or, of floating-point values, as EXR."""
    if isinstance(source, Image):
        return write_picture(stem.name, source, stem.parent)
    values = planes_of(subject, source)
    if values.dtype.kind != "f":
        return write_picture(stem.name, values, stem.parent)
    if not role.startswith("normal"):
        check_range(subject, values, "linear values", "scale them to it")
    else:
        check_range(subject, values, "unit vectors", "divide them by their length", -1.0)
        lengths = np.linalg.norm(values, axis=-1)
        if values.shape[-1] != 3 or np.abs(lengths - 1).mean() > _UNIT:
            raise ValueError(
                f"{subject}: vectors of length {lengths.min():.3g} to {lengths.max():.3g}, expected unit vectors "
                "[H, W, 3], x right, y up; of values in [0, 1] take 2 v - 1."
            )
        values, stem = values * 0.5 + 0.5, stem if role != "normal" else stem.with_name(f"{stem.name}_gl")
    path = stem.with_name(f"{stem.name}.exr")
    write_exr(torch.from_numpy(values.astype(np.float32)), path, half=False)
    return path
