"""Strips of Deschaintre et al. 2018, "Single-Image SVBRDF Capture with a Rendering-Aware Deep Network", as tasks.

A strip is an image of five equal squares side by side: flash photograph, normal, diffuse, roughness, specular. Normals
are 0..1 for -1..1, x right, y up; all else is linear. Names such as `0000001;marbleXbricks;1Xdefault.png` say which
base materials a strip blends, `marble` and `bricks`, and which preset of each, `1` and `default`. Measured on 32
strips, white would have radiance 1.35 right below their flash.

Another method's maps of a strip are `<name>_N.png`, `_D`, `_R`, `_S`, as Nie et al. 2024 publish theirs: D and S are
encoded with gamma 2.2, all else is as in strips.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.colours import LINEAR_SPACE, Floats, integers_to_unit_range
from data_tools.readers.image_files import Pixels, read_pixels, shape_of
from data_tools.readers.input_source import DEFAULT_PHOTO_PX
from data_tools.readers.normal_maps import complete_normals
from data_tools.readers.opened_images import is_heif
from data_tools.readers.square_photos import central_square, reading_side_px, resample
from data_tools.readers.square_photos import find as find
from data_tools.readers.svbrdf_task import UNITS as OF_TASKS
from data_tools.readers.svbrdf_task import decode_unit_normals, encode_srgb, make_svbrdf_task, task_name
from metapp.appearance.svbrdf_maps import Maps, pack_maps
from metapp.learning.task import Task
from metapp.storage.shards import AUTO_SPLIT, ManifestEntry, split_auto

STRIP_TILES = 5
WHITE_RADIANCE = 1.35  # radiance of white right below the flash, measured on 32 strips
UNITS = {
    **OF_TASKS,
    "photo": "sRGB, uint8 0..255 [3, height, width], rows from the top; the strip's own flash photograph, exposed so "
    "that white has radiance 1 right below the flash",
    "predicted": "as maps: those that another method predicts of the photograph",
}

_PREDICTED_GAMMA = 2.2  # encoding of predicted diffuse and specular maps
_CLIPPED_LINEAR_VALUE = 0.995  # linear value from which on a strip's photograph counts as clipped
_MIN_VISIBLE_REFLECTANCE = 1 / 255  # a material with less in all texels is black
_ONE_TEST_IN = 5  # share of components for tests; fewer than five components have no fifth
# The base materials of the 48 published strips that `make real-svbrdf` measures, each blended with both others, and
# those of their presets that are for tests. The list was made once, by a search over sets of presets for the split that
# leaves out the fewest strips, with a fifth or more of the others for tests: 8 test, 32 train, and 8 are left out.
_PUBLISHED_MATERIALS = frozenset({"PolishedMarbleFloor_01", "brick_uneven_stones", "metal_bumpy_squares"})
_PUBLISHED_TEST_PRESETS = frozenset(
    {"PolishedMarbleFloor_01;1", "PolishedMarbleFloor_01;2", "brick_uneven_stones;1", "metal_bumpy_squares;1"}
)


def is_strip(path: Path) -> bool:
    """Tell whether an image is five times as wide as high, within a texel of a tile; HEIF files never are strips."""
    return not is_heif(path) and _has_tiles(*shape_of(path))


def read_task(
    path: Path,
    size: int = DEFAULT_PHOTO_PX,
    gamma: float = 1.0,
    white: float = WHITE_RADIANCE,
    predicted: Path | None = None,
    least: int = 0,
    layer: str = "",
) -> Task:
    """Read a strip as a task with its maps and its photograph, and with `predicted` maps if there is a folder of them.

    Predicted maps of fewer px than the strip's tiles show the middle of the tiles; the task then does so, too.

    Args:
        path: the file.
        size: the side of maps and photograph, in px; means are taken over areas, smaller tiles are interpolated.
        gamma: the exponent by which all tiles but the normals are encoded; 1 is linear.
        white: the radiance that white would have right below the flash; the photograph is divided by it, except where
            it is clipped.
        predicted: a folder of predicted maps, named by the strip's stem or its part before the first `;`.
        least: the least side of the result, in px, to which smaller tiles are enlarged; 0: tiles are enlarged to
            `size`.
        layer: the layer of an EXR file; see :func:`read_pixels`.

    Raises:
        ValueError: the file cannot be read (see :func:`read_pixels` and :func:`read_predicted`); it is not five
            squares, holds NaN, is black, or its normals are none.
    """
    tiles = _read_tiles(path, gamma, white, layer)
    predicted_tiles = read_predicted(predicted, (path.stem, path.stem.split(";")[0])) if predicted else []
    share = min(1.0, len(predicted_tiles[0]) / len(tiles[0])) if predicted_tiles else 1.0
    size = reading_side_px(round(share * len(tiles[0])), size, least)
    photo, *true_tiles = (_resample_tile(tile, size, share) for tile in tiles)
    if max(float(true_tiles[1].max()), float(true_tiles[3].max())) < _MIN_VISIBLE_REFLECTANCE:
        raise ValueError(f"{path}: diffuse and specular are black, expected a material that reflects; leave it out.")
    task = make_svbrdf_task(path.stem, _pack_images(path, *true_tiles), photo=encode_srgb(photo))
    if not predicted:
        return task
    maps = _pack_images(predicted / path.name, *(_resample_tile(tile, size) for tile in predicted_tiles))
    return task._replace(data=task.data | {"predicted": maps.half()})


def read_predicted(folder: Path, names: tuple[str, ...]) -> list[Floats]:
    """Read predicted maps.

    Args:
        folder: the folder of the maps.
        names: the names that the maps may have; the first one that is there counts.

    Returns:
        Normal, diffuse, roughness and specular map, [S, S, 3] each, in [0, 1], all linear.

    Raises:
        ValueError: a map is missing, not square or of another size, or damaged.
    """
    name = next((name for name in names if (folder / f"{name}_N.png").is_file()), names[-1])
    normal, diffuse, roughness, specular = tiles = [
        _read_predicted(folder / f"{name}_{letter}.png") for letter in "NDRS"
    ]
    shapes = [tile.shape[:2] for tile in tiles]
    if len(set(shapes)) > 1 or shapes[0][0] != shapes[0][1]:
        found = ", ".join(f"{width} x {height}" for height, width in shapes)
        raise ValueError(
            f"{folder / name}_N.png and so on: {found} px, expected squares of one size; export all four again."
        )
    return [normal, diffuse**_PREDICTED_GAMMA, roughness, specular**_PREDICTED_GAMMA]


def _read_predicted(file: Path) -> Floats:
    """Read a predicted map, [H, W, 3] in [0, 1], or raise ValueError if it is missing or damaged."""
    if not file.is_file():
        raise ValueError(
            f"{file}: no such file, expected _N, _D, _R and _S of each material; add it, or leave its material out."
        )
    return _finite_values(file, read_pixels(file)).clip(0, 1)


def _finite_values(file: Path, pixels: Pixels) -> Floats:
    """Return the colours of a picture, [H, W, 3], or raise ValueError if some are not finite."""
    values = integers_to_unit_range(pixels.values[..., :3])
    bad_count = int((~np.isfinite(values)).sum())
    if bad_count:
        raise ValueError(f"{file}: {bad_count:,} values are NaN or infinite, expected finite ones; export it again.")
    return values


def _pack_images(source: Path, normal: Tensor, diffuse: Tensor, roughness: Tensor, specular: Tensor) -> Tensor:
    """Pack maps, images [3, S, S] in [0, 1] each, as one tensor [10, S, S].

    Raises:
        ValueError: normals do not point out of the surface; errors name the source.
    """
    return pack_maps(Maps(diffuse, specular, roughness.mean(0, keepdim=True), decode_unit_normals(normal, source)))


def entries(sources: Sequence[Path], folders: object, split: str) -> dict[Path, ManifestEntry]:
    """Return the manifest's entry of each strip, grouped by the materials that it blends.

    With the split "auto", warnings say which strips :func:`split_strips` leaves out, or that it chooses none for tests.
    """
    groups = group_strips(sources)
    side_by_strip = split_strips(sources) if split == AUTO_SPLIT else dict.fromkeys(sources, "")
    if left_out := len(sources) - len(side_by_strip):
        message = (
            f"{left_out} of {len(sources)} strips left out: they blend presets of training with presets of tests, "
            "which share base materials; --split train or --split test keeps all."
        )
        warnings.warn(message, stacklevel=2)
    elif split == AUTO_SPLIT and "test" not in side_by_strip.values():
        message = (
            f"0 of {len(sources)} strips are for tests: expected {_ONE_TEST_IN} or more groups that share no base "
            "material; convert test strips by --split test."
        )
        warnings.warn(message, stacklevel=2)
    return {
        strip: ManifestEntry(task_name(strip.stem), split=side, group=groups[strip])
        for strip, side in side_by_strip.items()
    }


def _has_tiles(height: int, width: int) -> bool:
    """Tell whether a picture of these sides, in px, is five times as wide as high."""
    return abs(width - STRIP_TILES * height) <= STRIP_TILES


def _read_tiles(path: Path, gamma: float, white: float, layer: str) -> list[Floats]:
    """Read the tiles of a strip, [S, S, 3] in [0, 1] each; all but the normals are linear. See :func:`read_task`.

    Raises:
        ValueError: the file is not five squares, or holds NaN.
    """
    pixels = read_pixels(path, layer)
    height, width = pixels.values.shape[:2]
    if not _has_tiles(height, width):
        count = round(width / height)
        found = (
            f"{count} tiles" if abs(width - count * height) <= 1 else f"tiles of {width / STRIP_TILES:g}x{height} px"
        )
        raise ValueError(
            f"{path}: {width}x{height} px, {found}, expected {STRIP_TILES} squares: photo, normal, diffuse, roughness, "
            "specular; choose strips only."
        )
    values = _finite_values(path, pixels)
    side = min(height, width // STRIP_TILES)
    tiles = []
    for index in range(STRIP_TILES):
        left = min(round(index * width / STRIP_TILES), width - side)
        tile = values[:side, left : left + side].clip(0, 1)
        tile = complete_normals(tile, path) if index == 1 else tile**gamma
        if index == 0:
            # how bright clipped texels were is not known: they stay white
            tile = np.where(tile < _CLIPPED_LINEAR_VALUE, (tile / white).clip(0, 1), 1)
        tiles.append(tile)
    return tiles


def _resample_tile(tile: Floats, size: int, share: float = 1.0) -> Tensor:
    """Return the middle of a tile at another resolution, [3, size, size].

    Args:
        tile: the tile, [S, S, 3].
        size: the side of the result, in px.
        share: the share of the tile's side that the middle has.
    """
    middle = central_square(Pixels(tile, LINEAR_SPACE, False), share)
    return torch.from_numpy(resample(middle, size, size)).permute(2, 0, 1).float()


def blended_materials(strip: Path) -> tuple[frozenset[str], frozenset[str]]:
    """Return the base materials of a strip, and their presets such as `marble;1`, by its name; else its stem for both.

    Every capital X separates two materials, even one within a material's own name, so that no strip seems to share
    fewer materials than it does.
    """
    parts = strip.stem.split(";")
    if len(parts) < 3:
        return frozenset([strip.stem]), frozenset([strip.stem])
    materials = [material for material in parts[1].split("X") if material] or [strip.stem]
    presets = parts[2].split("X")
    if len(presets) != len(materials):  # whose preset is which is not known
        return frozenset(materials), frozenset(materials)
    pairs = zip(materials, presets, strict=True)
    return frozenset(materials), frozenset(f"{base_material};{preset}" for base_material, preset in pairs)


def group_strips(strips: Iterable[Path]) -> dict[Path, str]:
    """Return the group of each strip: the component of strips that share base materials, or the blend of presets.

    Components count if there are five or more of them; else strips of one blend are a group.
    """
    components = _connect_strips({strip: blended_materials(strip)[0] for strip in strips})
    if len(set(components.values())) >= _ONE_TEST_IN:
        return components
    return {strip: " + ".join(sorted(blended_materials(strip)[1])) for strip in components}


def split_strips(strips: Sequence[Path]) -> dict[Path, str]:
    """Split strips so that no material is on both sides.

    If there are five or more components of strips that share base materials, every fifth is for tests, counted from the
    largest. Of published strips, which blend three base materials alone, those made of _PUBLISHED_TEST_PRESETS are for
    tests, and those that blend them with other presets are left out. All other strips are for training.

    Returns:
        The sides, "train" or "test", of strips that are not left out.
    """
    materials, presets = ({strip: blended_materials(strip)[index] for strip in strips} for index in (0, 1))
    if set().union(*materials.values()) <= _PUBLISHED_MATERIALS:
        return {
            strip: "test" if units <= _PUBLISHED_TEST_PRESETS else "train"
            for strip, units in presets.items()
            if units <= _PUBLISHED_TEST_PRESETS or not units & _PUBLISHED_TEST_PRESETS
        }
    components = _connect_strips(materials)
    sizes = Counter(components.values())
    side_by_component = split_auto(sorted(sizes, key=lambda component: (-sizes[component], component)))
    return {strip: side_by_component[components[strip]] for strip in strips}


def _connect_strips(materials_by_strip: Mapping[Path, frozenset[str]]) -> dict[Path, str]:
    """Return the component of each strip: the first name, as sorted, of all base materials that it is connected with.

    Args:
        materials_by_strip: the base materials that each strip blends; strips that share one are connected.
    """
    components: list[frozenset[str]] = []
    for materials in set(materials_by_strip.values()):
        touched = [component for component in components if component & materials]
        components = [component for component in components if not component & materials]
        components.append(materials.union(*touched))
    names = {material: min(component) for component in components for material in component}
    return {strip: names[min(materials)] for strip, materials in materials_by_strip.items()}
