"""Baselines of texture networks: the nearest training texture, and pictures of patches of the exemplar itself.

These are image quilting (Efros & Freeman 2001), and patches at random.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from torch import Generator, Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import distance
from metapp.baselines.baseline import Allowed, Baseline, BaselineFit, PreparedBaseline, Training, bytes_of, nearest
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.networks.exemplar import JUDGED, ExemplarApp

AT_ONCE = 8  # training tasks whose matrices are compared
Picture = NDArray[np.float32]
Mask = NDArray[np.bool_]
TOLERANCE = 0.1  # as published: patches whose overlaps differ by so much more than the best one's are as good
Make = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def nearest_exemplar(training: Training, allowed: Allowed) -> PreparedBaseline:
    """The training exemplar with the least error; the set itself is shared, its pictures and their Gram matrices."""
    assert isinstance(training.app, ExemplarApp)
    known = training.stacked
    names = sorted(name for name in known.data if name.startswith("gram"))
    pictures = training.app.exemplar(known.data["image"].float() / 255)

    def distances(tasks: Tasks, rng: Generator, allowed: Allowed) -> Tensor:
        targets = [tasks.data[name][tasks.rows] for name in names]
        parts = torch.arange(len(known)).split(AT_ONCE)
        errors = [distance([known.data[name][rows] for name in names], targets) for rows in parts]
        return torch.cat(errors).reshape(len(known), -1).mean(1)

    shared = bytes_of(known.data["image"], *(known.data[name] for name in names))
    fit = nearest(distances, lambda index: pictures[index][None, None], lambda index: picture_of(pictures[index]))
    return PreparedBaseline(fit, shared)


def picture_of(srgb: Tensor) -> Tensor:
    """Linear RGB [H, W, 3] of a picture [3, H, W], sRGB in [0, 1]."""
    return srgb_to_linear(srgb).permute(1, 2, 0)


def block_of(exemplar: Picture) -> tuple[int, int]:
    """Side of a block and of what neighbours share, in px."""
    block = max(2, min(exemplar.shape[:2]) // 4)
    return block, max(1, round(block / 6))


def random_patches(exemplar: Picture, rng: np.random.Generator) -> Picture:
    """A picture of the exemplar's size [H, W, C] of square patches from anywhere in it, side by side."""
    block, _ = block_of(exemplar)
    patches = sliding_window_view(exemplar, (block, block), (0, 1)).transpose(0, 1, 3, 4, 2)
    result = np.empty_like(exemplar)
    for top in range(0, len(exemplar), block):
        for left in range(0, exemplar.shape[1], block):
            part = result[top : top + block, left : left + block]
            part[:] = patches[rng.integers(len(patches)), rng.integers(patches.shape[1])][: len(part), : part.shape[1]]
    return result


def quilted(exemplar: Picture, rng: np.random.Generator) -> Picture:
    """A picture of the exemplar's size [H, W, C]: patches that agree where they overlap, cut where they agree most."""
    height, width, channels = exemplar.shape
    block, overlap = block_of(exemplar)
    step = block - overlap
    patches = sliding_window_view(exemplar, (block, block), (0, 1)).transpose(0, 1, 3, 4, 2)
    rows, columns = (-(-(size - overlap) // step) for size in (height, width))
    result = np.zeros((rows * step + overlap, columns * step + overlap, channels), exemplar.dtype)
    for i in range(rows):
        for j in range(columns):
            part = result[i * step : i * step + block, j * step : j * step + block]
            shared = _shared(block, overlap, above=i > 0, before=j > 0)
            patch = _chosen(patches, part, shared, rng)
            part[:] = np.where(_mask(part, patch, overlap, above=i > 0, before=j > 0)[..., None], patch, part)
    return result[:height, :width]


def _shared(block: int, overlap: int, *, above: bool, before: bool) -> Mask:
    """Which pixels [block, block] of a block are there already."""
    shared = np.zeros((block, block), bool)
    shared[:overlap] |= above
    shared[:, :overlap] |= before
    return shared


def _chosen(patches: Picture, part: Picture, shared: Mask, rng: np.random.Generator) -> Picture:
    """A patch at random of those that agree with what is there about as well as the best."""
    if not shared.any():
        return np.asarray(patches[rng.integers(len(patches)), rng.integers(patches.shape[1])])
    error = np.square(patches[:, :, shared] - part[shared]).sum((2, 3))
    good = np.argwhere(error <= (1 + TOLERANCE) * error.min())
    i, j = good[rng.integers(len(good))]
    return np.asarray(patches[i, j])


def _mask(part: Picture, patch: Picture, overlap: int, *, above: bool, before: bool) -> Mask:
    """Which pixels [block, block] the patch takes: those beyond the cuts."""
    differs = np.square(part - patch).sum(2)
    mask = np.ones(differs.shape, bool)
    if before:
        mask[:, :overlap] &= beyond_cut(differs[:, :overlap])
    if above:
        mask[:overlap] &= beyond_cut(differs[:overlap].T).T
    return mask


def beyond_cut(cost: Picture) -> Mask:
    """Which entries lie on or beyond the path from top to bottom of least total cost, one entry a row, [H, W]."""
    height, width = cost.shape
    total = cost.copy()
    for row in range(1, height):
        padded = np.pad(total[row - 1], 1, constant_values=np.inf)
        total[row] += np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    path = np.empty(height, int)
    path[-1] = total[-1].argmin()
    for row in range(height - 2, -1, -1):
        low = max(path[row + 1] - 1, 0)
        path[row] = low + total[row, low : path[row + 1] + 2].argmin()
    return np.arange(width) >= path[:, None]


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of textures."""
    cannot = "make anything that is no copy of pieces of the exemplar, which it holds; nor does it tile"
    return (
        Baseline(
            "nearest",
            "the training texture with the least error",
            "be a texture that is not in its set, nor make more of it",
            nearest_exemplar,
        ),
        Baseline(
            "quilting",
            "image quilting (Efros & Freeman 2001), blocks of a quarter of the exemplar",
            cannot,
            functools.partial(_copies, quilted),
            learns=False,
        ),
        Baseline(
            "patches",
            "random patches of a quarter of the exemplar, a floor for the eye",
            f"{cannot}, nor hide its seams",
            functools.partial(_copies, random_patches),
            learns=False,
        ),
    )


def _copies(make: Make, training: Training, allowed: Allowed) -> PreparedBaseline:
    """Pictures of patches of the exemplar; seconds are of as many pictures as are judged."""
    app = training.app
    assert isinstance(app, ExemplarApp)

    def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        exemplar = app.exemplar(tasks.data["image"][tasks.rows].float() / 255)[0]
        numbers = np.random.default_rng(int(torch.randint(2**31, (), generator=rng)))
        made = [make(exemplar.permute(1, 2, 0).numpy(), numbers) for _ in range(JUDGED)]
        pictures = torch.from_numpy(np.stack(made)).permute(0, 3, 1, 2)[None]
        count = exemplar.numel()  # and as many bytes
        return BaselineFit(lambda: pictures, count, count, picture=picture_of(pictures[0, 0]))

    return PreparedBaseline(fit)
