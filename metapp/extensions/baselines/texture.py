"""Baselines of texture networks: the nearest training texture, and pictures made of the exemplar itself.

These are image quilting (Efros & Freeman 2001), pictures with the patches of the exemplar (Elnekave & Weiss 2022), and
patches at random.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from torch import Generator, Tensor
from torch.nn.functional import conv2d, interpolate, pad

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import distance
from metapp.appearance.quilting import Picture, block_of, quilted
from metapp.extensions.baselines.baseline import (
    Allowed,
    Baseline,
    BaselineFit,
    PreparedBaseline,
    Training,
    bytes_of,
    nearest,
)
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.networks.exemplar import JUDGED, ExemplarApp

AT_ONCE = 8  # training tasks whose matrices are compared
PATCH, SLICES, COARSEST = 7, 64, 21  # of pictures with the exemplar's patches: px, directions, px of the coarsest
DESCENT, FEWEST_STEPS = 150, 40  # steps at up to 64 px, and at the finest scale at least
Make = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def nearest_exemplar(training: Training, allowed: Allowed) -> PreparedBaseline:
    """The training exemplar with the least error; the set itself is shared, its pictures and their Gram matrices."""
    assert isinstance(training.app, ExemplarApp)
    exemplars = training.stacked
    names = sorted(name for name in exemplars.data if name.startswith("gram"))
    pictures = training.app.exemplar(exemplars.data["image"].float() / 255)

    def distances(tasks: Tasks, rng: Generator, allowed: Allowed) -> Tensor:
        targets = [tasks.data[name][tasks.rows] for name in names]
        parts = torch.arange(len(exemplars)).split(AT_ONCE)
        errors = [distance([exemplars.data[name][rows] for name in names], targets) for rows in parts]
        return torch.cat(errors).reshape(len(exemplars), -1).mean(1)

    shared = bytes_of(exemplars.data["image"], *(exemplars.data[name] for name in names))
    fit = nearest(distances, lambda index: pictures[index][None, None], lambda index: picture_of(pictures[index]))
    return PreparedBaseline(fit, shared)


def picture_of(srgb: Tensor) -> Tensor:
    """Linear RGB [H, W, 3] of a picture [3, H, W], sRGB in [0, 1]."""
    return srgb_to_linear(srgb).permute(1, 2, 0)


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


def quilt(exemplar: Picture, rng: np.random.Generator) -> Picture:
    """A picture of the exemplar's size [H, W, C]: blocks that agree where they overlap, cut where they agree most."""
    block, overlap = block_of(exemplar)
    return quilted(exemplar, (exemplar.shape[0], exemplar.shape[1]), rng, block=block, overlap=overlap)


def with_its_patches(exemplar: Picture, rng: np.random.Generator) -> Picture:
    """A picture [H, W, 3] that tiles and whose patches are distributed as the exemplar's, at all scales.

    GPDM (Elnekave & Weiss 2022): from coarse to fine, Adam moves the pixels themselves down the sliced Wasserstein
    distance of patches, along random directions drawn anew in each step.
    """
    target = torch.from_numpy(exemplar).permute(2, 0, 1)[None].float()
    generator = Generator().manual_seed(int(rng.integers(2**31)))
    sizes = [tuple(max(COARSEST, round(side * 0.75**level)) for side in target.shape[-2:]) for level in range(99)]
    sizes = sizes[: next(i for i, size in enumerate(sizes) if min(size) == COARSEST) + 1]
    made = target.mean((2, 3), keepdim=True) + 0.1 * torch.randn(1, 3, *sizes[-1], generator=generator)
    for size in reversed(sizes):
        wanted = interpolate(target, size=size, mode="area")
        made = interpolate(made, size=size, mode="bicubic")
        made = _descended(made, wanted, max(FEWEST_STEPS, round(DESCENT * (64 / max(size)) ** 2)), generator)
    return made[0].clamp(0, 1).permute(1, 2, 0).numpy()


def _descended(made: Tensor, wanted: Tensor, steps: int, generator: Generator) -> Tensor:
    """A picture [1, 3, H, W] after so many steps towards the patches of another one of its size."""
    with torch.enable_grad():
        made = made.detach().requires_grad_()
        adam = torch.optim.Adam([made], lr=0.02)
        for _ in range(min(steps, DESCENT)):
            directions = torch.randn(SLICES, 3, PATCH, PATCH, generator=generator)
            directions = directions / directions.flatten(1).norm(dim=1)[:, None, None, None]
            tiled = pad(made, (0, PATCH - 1, 0, PATCH - 1), mode="circular")
            projected = conv2d(tiled, directions).flatten(2)[0].sort(1).values
            target = conv2d(wanted, directions).flatten(2)[0].sort(1).values
            target = interpolate(target[None], size=projected.shape[1], mode="linear", align_corners=True)[0]
            adam.zero_grad()
            (projected - target).abs().mean().backward()
            adam.step()
    return made.detach()


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
            functools.partial(_copies, quilt),
            learns=False,
        ),
        Baseline(
            "gpdm",
            "pixels moved until patches are distributed as the exemplar's (Elnekave & Weiss 2022)",
            "be kept in less than its pixels, or make more of it without another descent; it tiles",
            functools.partial(_copies, with_its_patches, count=1),
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


def _copies(make: Make, training: Training, allowed: Allowed, count: int = JUDGED) -> PreparedBaseline:
    """Pictures of patches of the exemplar; seconds are of as many pictures as are judged, `count` of them."""
    app = training.app
    assert isinstance(app, ExemplarApp)

    def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        exemplar = app.exemplar(tasks.data["image"][tasks.rows].float() / 255)[0]
        numbers = np.random.default_rng(int(torch.randint(2**31, (), generator=rng)))
        made = [make(exemplar.permute(1, 2, 0).numpy(), numbers) for _ in range(count)]
        pictures = torch.from_numpy(np.stack(made)).permute(0, 3, 1, 2)[None]
        kept = exemplar.numel()  # numbers, and as many bytes
        return BaselineFit(lambda: pictures, kept, kept, picture=picture_of(pictures[0, 0]))

    return PreparedBaseline(fit)
