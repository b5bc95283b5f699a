"""The true maps of stationary svBRDFs, which outer losses compare with maps of fits, and data augmentation changes."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.appearance.svbrdf_maps import STATISTICS_SIDES_PX, Maps, map_statistics
from metapp.apps.exemplar.exemplar_statistics import turn_picture
from metapp.apps.svbrdf_stationary.material_codec import display, encode_gloss

TRUTH_WEIGHT = 3.0  # weight in the outer loss of the difference of the maps' statistics from the true maps'
# Weights in the outer loss of mean specular and roughness, in logits: of their difference from the true ones, and where
# these are unknown, of their squared deviation from usual ones
GLOSS_WEIGHT, UNUSUAL_WEIGHT = 0.05, 0.05
ROUGHNESS_WEIGHT = 0.4  # weight of roughness beside specular, as it varies more between materials
# Weights in the difference from the true maps of diffuse colour, specular reflectance, roughness, slopes, and squared
# slopes
PART_WEIGHTS = (1.0, 1.0, 1.0, 2.0, 8.0)


def compare_map_statistics(maps: Maps, truth: Tensor | None) -> Tensor:
    """Return the difference of maps from the statistics of the true ones, [T].

    Where the true maps are unknown, it is the deviation of gloss from a usual one. Without either, General comes to
    explain all photographs by one bright, rough, specular surface without colour.

    Args:
        maps: maps [T, B, ...].
        truth: the statistics of the true maps at three resolutions, [T, 3, 2, 6]; None if they are unknown.
    """
    if truth is None:
        return UNUSUAL_WEIGHT * gloss_deviation(maps, maps.diffuse.new_zeros(len(maps.diffuse), 2))
    resolution = sum(maps.diffuse.shape[-1] < side for side in STATISTICS_SIDES_PX[:-1])  # nearest to these maps
    known = truth[:, resolution]
    specular, roughness = (known[:, 0, 3] ** DISPLAY_GAMMA).clamp_min(1e-3), known[:, 0, 4].clamp(0.12, 0.98)
    pairs = zip(encode_gloss(maps.specular, maps.roughness), encode_gloss(specular, roughness), strict=True)
    # in logits, where no gradient vanishes
    gloss_difference = torch.stack([(values.mean((1, 2, 3, 4)) - target).abs() for values, target in pairs]).sum(0)
    statistics_difference = (map_statistics(maps) - known[:, None]).abs().mean((1, 2, 3))
    return TRUTH_WEIGHT * statistics_difference + GLOSS_WEIGHT * gloss_difference


def gloss_deviation(maps: Maps, expected: Tensor) -> Tensor:
    """Return the mean squared deviation of specular and, weighted, of roughness from expected logits [T, 2]: [T]."""
    specular, roughness = (
        (values - expected_values[:, None, None, None, None]).square().mean((1, 2, 3, 4))
        for values, expected_values in zip(encode_gloss(maps.specular, maps.roughness), expected.unbind(1), strict=True)
    )
    return specular + ROUGHNESS_WEIGHT * roughness


def compare_texels(maps: Maps, true_maps: Maps) -> Tensor:
    """Return the weighted mean difference of maps [T, B, ...] from the true ones, texel by texel, [T]."""
    slope_differences = (maps.normal - true_maps.normal)[:, :, :2]
    differences = (
        display(maps.diffuse) - display(true_maps.diffuse),
        display(maps.specular) - display(true_maps.specular.mean(2, keepdim=True)),
        maps.roughness - true_maps.roughness,
        slope_differences,
        slope_differences.square(),
    )
    pairs = zip(differences, PART_WEIGHTS, strict=True)
    return torch.stack([weight * difference.abs().mean((1, 2, 3, 4)) for difference, weight in pairs]).sum(0)


def turn_maps(maps: Tensor, is_flipped: Tensor, is_transposed: Tensor, channels: Tensor) -> Tensor:
    """Change packed maps [10, H, W] as the picture over them is changed.

    Args:
        maps: packed by :func:`metapp.appearance.svbrdf_maps.pack_maps`.
        is_flipped, is_transposed: whether the picture is flipped from left to right, then transposed; bool [].
        channels: the number that each colour channel had before, [3].
    """
    normal, diffuse, roughness, specular = turn_picture(maps, bool(is_flipped), bool(is_transposed)).split((3, 3, 1, 3))
    x, y, z = normal.split(1)
    x = -x if is_flipped else x
    # y points up, against the rows
    x, y = (-y, -x) if is_transposed else (x, y)
    return torch.cat([x, y, z, diffuse[channels], roughness, specular[channels]])
