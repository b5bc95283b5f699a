"""Baselines of texture networks: the nearest training texture, and image quilting (Efros & Freeman 2001)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Generator, Tensor

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


def quilt(exemplar: Picture, rng: np.random.Generator) -> Picture:
    """A picture of the exemplar's size [H, W, C]: blocks that agree where they overlap, cut where they agree most."""
    block, overlap = block_of(exemplar)
    return quilted(exemplar, (exemplar.shape[0], exemplar.shape[1]), rng, block=block, overlap=overlap)


def _quilting(training: Training, allowed: Allowed) -> PreparedBaseline:
    """Seconds are of as many pictures as are judged."""
    app = training.app
    assert isinstance(app, ExemplarApp)

    def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        exemplar = app.exemplar(tasks.data["image"][tasks.rows].float() / 255)[0]
        numbers = np.random.default_rng(int(torch.randint(2**31, (), generator=rng)))
        made = [quilt(exemplar.permute(1, 2, 0).numpy(), numbers) for _ in range(JUDGED)]
        pictures = torch.from_numpy(np.stack(made)).permute(0, 3, 1, 2)[None]
        kept = exemplar.numel()  # numbers, and as many bytes
        return BaselineFit(lambda: pictures, kept, kept, picture=picture_of(pictures[0, 0]))

    return PreparedBaseline(fit)
