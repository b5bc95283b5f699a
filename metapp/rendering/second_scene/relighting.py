"""Pictures of the second scene under maps: a matte and a glossy sphere on a floor, by Mitsuba.

All is neutral grey, as the grey and the mirror ball that film sets are lit by: any colour in a picture is the
light's. The floor fills the picture and reaches to the horizon, so no pixel shows the map itself, and the lower half of
a map does nothing. Pictures are linear in the map, which makes the scene a matrix: a thousand maps cost one rendering.

The paths that fill the matrix are in :mod:`metapp.rendering.second_scene.paths`.
"""

from __future__ import annotations

import functools
import math
from contextlib import suppress
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.appearance import latlong
from metapp.rendering.second_scene.geometry import PICTURE_HEIGHT_PX, PICTURE_WIDTH_PX
from metapp.rendering.variant import load_mitsuba
from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import read_tensors, write_bytes

MATRIX_VERSION = 1  # version of the scene and its matrix, in the name of the cached file
PATHS_PER_PIXEL = 16384  # paths from each pixel to the light, spread over the texels

_BOUNCES = 4  # bounces of light between patches; further ones would add 0.1 % of the light


def transfer_matrix(height: int = 32, width: int = 64) -> Tensor:
    """Return the scene as a matrix, from the cache, or else built now, in about 20 s on one core.

    Args:
        height: rows of the maps, even.
        width: columns of the maps.

    Returns:
        [P, N] float32, >= 0, with the pixels P and the texels N in row-major order, the same for each colour:
        picture[p] = sum over t of matrix[p, t] * map[t]. It is kept in memory: do not change it.

    Raises:
        ValueError: an odd height; no Mitsuba that can render here.
    """
    if height < 2 or height % 2 or width < 1:
        raise ValueError(f"second scene: maps of {height} x {width} texels, expected an even number of rows.")
    path = matrix_file(height, width)
    with suppress(OSError, SafetensorError, KeyError):  # the file is missing or damaged
        return _load_matrix(path, path.stat().st_mtime_ns)
    matrix = _build_matrix(height, width)
    write_bytes(path, save({"matrix": matrix}))
    return matrix


def matrix_file(height: int = 32, width: int = 64) -> Path:
    """Return the path of the cached matrix for maps of height x width texels."""
    return cache_folder() / f"second-scene-{height}x{width}-v{MATRIX_VERSION}.safetensors"


@functools.lru_cache(maxsize=1)
def _load_matrix(path: Path, changed: int) -> Tensor:
    """Read a matrix from a file and keep it; a file that changes is read again."""
    return read_tensors(path)["matrix"]


def relight(maps: Tensor, *, height: int = 32, width: int = 64) -> Tensor:
    """Render pictures [B, 3, 64, 96] of the scene, linear RGB radiance, under maps of any size.

    Args:
        maps: linear RGB radiance, [B, 3, H, W]; each texel of the matrix's maps takes the mean radiance over its area.
        height: rows of the matrix's maps.
        width: columns of the matrix's maps.
    """
    texels = latlong.resample_maps(maps, height, width).flatten(-2)
    pictures: Tensor = (texels @ transfer_matrix(height, width).to(maps).T).unflatten(
        -1, (PICTURE_HEIGHT_PX, PICTURE_WIDTH_PX)
    )
    return pictures


def _build_matrix(height: int, width: int) -> Tensor:
    """Build the matrix by tracing paths: light of the map on surfaces, then light of patches that it lights."""
    load_mitsuba()
    from metapp.rendering.second_scene.paths import MATRIX_ROWS, PICTURE_PIXELS, TransferPaths

    paths = TransferPaths()
    passes = math.ceil(PATHS_PER_PIXEL / (height // 2 * width))
    lit = torch.zeros(MATRIX_ROWS, height // 2 * width)
    for number in range(passes):
        lit += paths.trace_to_texels(height, width, number) / passes
    from_patches, total = paths.trace_to_patches(), lit
    for _ in range(_BOUNCES):
        total = lit + torch.sparse.mm(from_patches, total[PICTURE_PIXELS:])
    upper = total[:PICTURE_PIXELS]
    return torch.cat([upper, torch.zeros_like(upper)], dim=1)  # the floor hides all below the horizon
