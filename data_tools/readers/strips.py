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
from data_tools.readers.image_files import Pixels, is_heif, read_pixels, shape_of
from data_tools.readers.normal_maps import complete_normals
from data_tools.readers.square_photos import SIZE, central_square, reading_side_px, resample_square
from data_tools.readers.square_photos import find as find
from data_tools.readers.svbrdf_task import UNITS as OF_TASKS
from data_tools.readers.svbrdf_task import decode_unit_normals, encode_srgb, make_svbrdf_task, task_name
from metapp.appearance.flash import Maps, pack_maps
from metapp.learning.task import Task
from metapp.storage.shards import AUTO_SPLIT, ManifestEntry, split_auto

STRIP_TILES = 5
WHITE_RADIANCE = 1.35  # radiance of white right below the flash
UNITS = {
    **OF_TASKS,
    "photo": "sRGB, uint8 0..255 [3, height, width], rows from the top; the strip's own flash photograph, exposed so "
    "that white has radiance 1 right below the flash",
    "predicted": "as maps: those that another method predicts of the photograph",
}

_GAMMA = 2.2  # of predicted colours
_CLIPPED = 0.995
_DARKEST = 1 / 255  # neither diffuse nor specular above it anywhere: nothing to see
_FEW = 5  # components; fewer have no fifth to leave for tests
_CANDIDATES, _WALKS = 256, 4096  # blends that a step chooses from; walks times blends


def is_strip(path: Path) -> bool:
    """True if an image is five times as wide as high, within a texel of a tile; phones' HEIF files are none."""
    return not is_heif(path) and _has_tiles(*shape_of(path))


def read_task(
    path: Path,
    size: int = SIZE,
    gamma: float = 1.0,
    white: float = WHITE_RADIANCE,
    predicted: Path | None = None,
    least: int = 0,
    layer: str = "",
) -> Task:
    """A strip as a task with the maps and the photograph that it holds, and `predicted` maps if there is a folder.

    If these have fewer px than the strip's tiles they show the middle of them, and so does then the task.

    Args:
        path: the file.
        size: side of maps and photograph in px; means over areas, smaller tiles are interpolated.
        gamma: all tiles but the normals are encoded so; 1 is linear.
        white: the radiance that white would have right below the flash; the photograph becomes so much darker, but
            where it is clipped.
        predicted: a folder of predicted maps, of the strip's stem or its part before the first `;`.
        least: as of `photo_of`.
        layer: as of `read_pixels`.

    Raises:
        ValueError: as `read_pixels` and `read_predicted`; not five squares, NaN, black, normals that are none.
    """
    tiles = _read_tiles(path, gamma, white, layer)
    of_others = read_predicted(predicted, (path.stem, path.stem.split(";")[0])) if predicted else []
    share = min(1.0, len(of_others[0]) / len(tiles[0])) if of_others else 1.0
    size = reading_side_px(round(share * len(tiles[0])), size, least)
    photo, *true = (_resampled(tile, size, share) for tile in tiles)
    if max(float(true[1].max()), float(true[3].max())) < _DARKEST:
        raise ValueError(f"{path}: diffuse and specular are black, expected a material that reflects; leave it out.")
    task = make_svbrdf_task(path.stem, _packed(path, *true), photo=encode_srgb(photo))
    if not predicted:
        return task
    maps = _packed(predicted / path.name, *(_resampled(tile, size) for tile in of_others))
    return task._replace(data=task.data | {"predicted": maps.half()})


def read_predicted(folder: Path, names: tuple[str, ...]) -> list[Floats]:
    """The maps N, D, R, S, [S, S, 3] in [0, 1], that a folder has under the first of some names; colours linear.

    Raises:
        ValueError: one is missing, not square or of another size, or damaged.
    """
    name = next((name for name in names if (folder / f"{name}_N.png").is_file()), names[-1])
    normal, diffuse, roughness, specular = tiles = [
        _read_predicted(folder / f"{name}_{letter}.png") for letter in "NDRS"
    ]
    shapes = [tile.shape[:2] for tile in tiles]
    if len(set(shapes)) > 1 or shapes[0][0] != shapes[0][1]:
        found = ", ".join(f"{width} x {height}" for height, width in shapes)
        raise ValueError(f"{folder / name}_N.png and so on: {found} px, expected squares of one size; export them.")
    return [normal, diffuse**_GAMMA, roughness, specular**_GAMMA]


def _read_predicted(file: Path) -> Floats:
    if not file.is_file():
        raise ValueError(
            f"{file}: no such file, expected _N, _D, _R and _S of each material; add it, or leave its material out."
        )
    return _finite(file, read_pixels(file)).clip(0, 1)


def _finite(file: Path, pixels: Pixels) -> Floats:
    values = integers_to_unit_range(pixels.values[..., :3])
    wrong = int((~np.isfinite(values)).sum())
    if wrong:
        raise ValueError(f"{file}: {wrong:,} values are NaN or infinite, expected finite ones; export it again.")
    return values


def _packed(source: Path, normal: Tensor, diffuse: Tensor, roughness: Tensor, specular: Tensor) -> Tensor:
    """Maps [10, S, S] of images, [3, S, S] each; errors name the source."""
    return pack_maps(Maps(diffuse, specular, roughness.mean(0, keepdim=True), decode_unit_normals(normal, source)))


def entries(sources: Sequence[Path], folders: object, split: str) -> dict[Path, ManifestEntry]:
    """Strips by the materials that they blend; with a split by it those of both sides are left out."""
    groups = group_strips(sources)
    sides, by = split_strips(sources) if split == AUTO_SPLIT else (dict.fromkeys(sources, ""), "")
    if by == "preset":
        found = "base materials are blended with all others: training and test strips show other presets of them."
        warnings.warn(found, stacklevel=2)
    if left_out := len(sources) - len(sides):
        found = f"{left_out} of {len(sources)} strips left out: they blend {by}s of training with {by}s of tests."
        warnings.warn(found, stacklevel=2)
    return {
        strip: ManifestEntry(task_name(strip.stem), split=side, group=groups[strip]) for strip, side in sides.items()
    }


def _has_tiles(height: int, width: int) -> bool:
    return abs(width - STRIP_TILES * height) <= STRIP_TILES


def _read_tiles(path: Path, gamma: float, white: float, layer: str) -> list[Floats]:
    """The tiles, [S, S, 3] in [0, 1]; all but the normals linear; the photograph's white as `read_task` says."""
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
    values = _finite(path, pixels)
    side = min(height, width // STRIP_TILES)
    tiles = []
    for index in range(STRIP_TILES):
        left = min(round(index * width / STRIP_TILES), width - side)
        tile = values[:side, left : left + side].clip(0, 1)
        tile = complete_normals(tile, path) if index == 1 else tile**gamma
        if index == 0:
            tile = np.where(tile < _CLIPPED, (tile / white).clip(0, 1), 1)  # who knows how bright what is clipped was
        tiles.append(tile)
    return tiles


def _resampled(tile: Floats, size: int, share: float = 1.0) -> Tensor:
    """The middle of a tile [S, S, 3], such a share of its side, [3, size, size]."""
    shown = central_square(Pixels(tile, LINEAR_SPACE, False), share)
    return torch.from_numpy(resample_square(shown, size)).permute(2, 0, 1).float()


def blended_materials(strip: Path) -> tuple[frozenset[str], frozenset[str]]:
    """The base materials of a strip and their presets, `marble;1`, by its name; else the strip itself for both.

    Every capital X parts, of a material's own name, too, so that no strip seems to share less than it does.
    """
    parts = strip.stem.split(";")
    if len(parts) < 3:
        return frozenset([strip.stem]), frozenset([strip.stem])
    materials = [material for material in parts[1].split("X") if material] or [strip.stem]
    presets = parts[2].split("X")
    if len(presets) != len(materials):  # which belongs to which is not known
        return frozenset(materials), frozenset(materials)
    return frozenset(materials), frozenset(f"{one};{preset}" for one, preset in zip(materials, presets, strict=True))


def group_strips(strips: Iterable[Path]) -> dict[Path, str]:
    """The groups of strips: components that share base materials, if these are _FEW or more, else single blends."""
    components = _components({strip: blended_materials(strip)[0] for strip in strips})
    if len(set(components.values())) >= _FEW:
        return components
    return {strip: " + ".join(sorted(blended_materials(strip)[1])) for strip in components}


def split_strips(strips: Sequence[Path]) -> tuple[dict[Path, str], str]:
    """The sides, "train" or "test", of strips, so that no material of theirs is on both; and what the split is by.

    That is "material", or "preset" if base materials cannot be parted. Of _FEW components of strips that share base
    materials, or more, every fifth is for tests, the largest first in line. Fewer are cut: test strips, of test
    materials alone, are a fifth or more and no more than training strips, and fewest are left out, of both. Where no
    choice does that, presets are parted; where none of these, all train.
    """
    materials, presets = ({strip: blended_materials(strip)[which] for strip in strips} for which in (0, 1))
    components = _components(materials)
    sizes = Counter(components.values())
    if len(sizes) >= _FEW:
        in_line = sorted(sizes, key=lambda component: (-sizes[component], component))
        side = split_auto(in_line)
        return {strip: side[components[strip]] for strip in strips}, "material"
    for by, made_of in (("material", materials), ("preset", presets)):
        if test := _test_side(Counter(made_of.values())):
            kept = {strip: units <= test for strip, units in made_of.items() if units <= test or not units & test}
            return {strip: "test" if is_test else "train" for strip, is_test in kept.items()}, by
    return dict.fromkeys(strips, "train"), "material"


def _components(made_of: Mapping[Path, frozenset[str]]) -> dict[Path, str]:
    """The first name, as sorted, of all that each strip is connected with by shared parts."""
    above: dict[str, str] = {}

    def root(unit: str) -> str:
        while above.setdefault(unit, unit) != unit:
            above[unit] = unit = above[above[unit]]
        return unit

    for units in made_of.values():
        roots = sorted(map(root, units))
        above.update(dict.fromkeys(roots, roots[0]))  # a root is the first of its component
    return {strip: root(min(units)) for strip, units in made_of.items()}


def _test_side(blends: Counter[frozenset[str]]) -> frozenset[str]:
    """The parts of test strips alone, as `split_strips` says, of numbers of strips by their parts; empty for none.

    The test side grows from one blend by the one after which most strips are left; the best state of several walks.
    """
    kinds = sorted(blends, key=sorted)
    units = sorted(frozenset().union(*kinds))
    member = torch.tensor([[float(unit in kind) for unit in units] for kind in kinds])
    weight = torch.tensor([float(blends[kind]) for kind in kinds])
    candidates = member[:: -(-len(kinds) // _CANDIDATES)]
    best, chosen_best = (0.0, 0.0), torch.zeros(len(units))
    for start in range(0, len(kinds), -(-len(kinds) // max(_WALKS // len(kinds), 1))):
        chosen, test, train = member[start], 0.0, weight.sum().item()
        while test <= train:
            test, train = (float(count) for count in _kept(member, weight, chosen[None]))
            if test <= train and test * _FEW >= test + train and (test + train, -test) > best:
                best, chosen_best = (test + train, -test), chosen
            after = torch.maximum(chosen, candidates)
            tests, trains = _kept(member, weight, after)
            left = torch.where(tests > test, tests + trains, -1)
            if left.max() < 0:
                break
            chosen = after[left.argmax()]
    return frozenset(unit for unit, is_chosen in zip(units, chosen_best, strict=True) if is_chosen)


def _kept(member: Tensor, weight: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
    """Numbers of strips made of chosen units alone, and of none of them, for K choices [K, U]; both [K]."""
    return weight @ (member @ (1 - chosen).T == 0).float(), weight @ (member @ chosen.T == 0).float()
