"""Maps that another method predicts for a flash photograph, kept as images, to be judged beside fits.

The files of a material are called after it, `<name>_N.png`, `_D`, `_R`, `_S`: normals as 0..1 for -1..1, x right, y up;
diffuse colour, roughness, specular colour; colours encoded with gamma 2.2. So Nie et al. 2024 publish theirs.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from data_tools.readers.image_files import read_pixels
from data_tools.readers.photos import Floats, fraction

GAMMA = 2.2


class Tiles(NamedTuple):
    """Images of maps, [side, side, 3] in [0, 1]; colours linear, normals as files keep them."""

    normal: Floats
    diffuse: Floats
    roughness: Floats
    specular: Floats


def read_predicted(folder: Path, names: tuple[str, ...]) -> Tiles:
    """The maps that a folder has under the first of some names.

    Args:
        folder: of the images.
        names: of the material, the preferred one first.

    Raises:
        ValueError: a file is missing; as `read_pixels`; not square, of different sizes, NaN.
    """
    name = next((name for name in names if (folder / f"{name}_N.png").is_file()), names[-1])
    tiles = Tiles(*(_read(folder / f"{name}_{letter}.png") for letter in "NDRS"))
    shapes = [tile.shape[:2] for tile in tiles]
    if len(set(shapes)) > 1 or shapes[0][0] != shapes[0][1]:
        found = ", ".join(f"{width} x {height}" for height, width in shapes)
        raise ValueError(f"{folder / name}_N.png and so on: {found} px, expected squares of one size; export them.")
    return tiles._replace(diffuse=tiles.diffuse**GAMMA, specular=tiles.specular**GAMMA)


def _read(file: Path) -> Floats:
    if not file.is_file():
        raise ValueError(
            f"{file}: no such file, expected _N, _D, _R and _S of each material; add it, or leave its material out."
        )
    values = fraction(read_pixels(file).values[..., :3])
    if not np.isfinite(values).all():
        raise ValueError(f"{file}: holds NaN, expected finite values; export the map again.")
    return np.clip(values, 0, 1)
