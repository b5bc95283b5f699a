"""Baselines of texture networks: the nearest training texture, and image quilting (Efros & Freeman 2001)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Generator, Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import distance
from metapp.appearance.quilting import block_of, quilted
from metapp.extensions.baselines.baseline import (
    INDEX,
    Allowed,
    Baseline,
    BaselineFit,
    PreparedBaseline,
    Training,
    bytes_of,
)
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.networks.exemplar import JUDGED_PICTURES, ExemplarApp

AT_ONCE = 8  # training tasks whose matrices are compared


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of textures."""
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
            "make anything that is no copy of pieces of the exemplar, which it holds; nor does it tile",
            _quilting,
            learns=False,
        ),
    )


def nearest_exemplar(training: Training, allowed: Allowed) -> PreparedBaseline:
    """The training exemplar with the least error; the set itself is shared, its pictures and their Gram matrices."""
    assert isinstance(training.app, ExemplarApp)
    exemplars = training.stacked
    names = sorted(name for name in exemplars.data if name.startswith("gram"))
    pictures = training.app.exemplar(exemplars.data["image"].float() / 255)

    def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        targets = [tasks.data[name][tasks.rows] for name in names]
        parts = torch.arange(len(exemplars)).split(AT_ONCE)
        errors = [distance([exemplars.data[name][rows] for name in names], targets) for rows in parts]
        nearest = pictures[int(torch.cat(errors).reshape(len(exemplars), -1).mean(1).argmin())]
        return BaselineFit(lambda: nearest[None, None], *INDEX, picture=picture_of(nearest))

    shared = bytes_of(exemplars.data["image"], *(exemplars.data[name] for name in names))
    return PreparedBaseline(fit, shared)


def picture_of(srgb: Tensor) -> Tensor:
    """Linear RGB [H, W, 3] of a picture [3, H, W], sRGB in [0, 1]."""
    return srgb_to_linear(srgb).permute(1, 2, 0)


def quilts(exemplar: Tensor, size: tuple[int, int], rng: Generator, *, tiles: bool = False) -> Tensor:
    """As many pictures [1, JUDGED_PICTURES, C, *size] as are judged, of blocks of an exemplar [C, H, W].

    Blocks agree where they overlap and are cut where they agree most.
    """
    numbers = np.random.default_rng(int(torch.randint(2**31, (), generator=rng)))
    picture = exemplar.permute(1, 2, 0).numpy()
    block, overlap = block_of(picture)
    made = [quilted(picture, size, numbers, block=block, overlap=overlap, tiles=tiles) for _ in range(JUDGED_PICTURES)]
    return torch.from_numpy(np.stack(made)).permute(0, 3, 1, 2)[None]


def _quilting(training: Training, allowed: Allowed) -> PreparedBaseline:
    app = training.app
    assert isinstance(app, ExemplarApp)

    def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        exemplar = app.exemplar(tasks.data["image"][tasks.rows].float() / 255)[0]
        pictures = quilts(exemplar, (exemplar.shape[1], exemplar.shape[2]), rng)
        kept = exemplar.numel()  # numbers, and as many bytes
        return BaselineFit(lambda: pictures, kept, kept, picture=picture_of(pictures[0, 0]))

    return PreparedBaseline(fit)
