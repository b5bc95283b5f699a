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
    Training,
    bytes_of,
)
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.networks.exemplar import JUDGED_PICTURES, ExemplarApp

AT_ONCE = 8  # training tasks whose matrices are compared


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of textures."""
    return NearestExemplar(app), Quilting(app)


class NearestExemplar(Baseline):
    """The training exemplar with the least error; the set itself is shared, its pictures and their Gram matrices."""

    name = "nearest"
    title = "the training texture with the least error"
    cannot = "be a texture that is not in its set, nor make more of it"
    learns = True

    def prepare(self, training: Training, allowed: Allowed) -> None:
        """Take the pictures and matrices of the set."""
        assert isinstance(self.app, ExemplarApp)
        data = training.stacked.data
        self.grams = {name: data[name] for name in sorted(data) if name.startswith("gram")}
        self.pictures = self.app.exemplar(data["image"].float() / 255)
        self.shared = bytes_of(data["image"], *self.grams.values())

    def fit(self, tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        """The number of an exemplar is kept."""
        targets = [tasks.data[name][tasks.rows] for name in self.grams]
        parts = torch.arange(len(self.pictures)).split(AT_ONCE)
        errors = [distance([gram[rows] for gram in self.grams.values()], targets) for rows in parts]
        nearest = self.pictures[int(torch.cat(errors).reshape(len(self.pictures), -1).mean(1).argmin())]
        return BaselineFit(lambda: nearest[None, None], *INDEX, picture=picture_of(nearest))


class Quilting(Baseline):
    """Image quilting."""

    name = "quilting"
    title = "image quilting (Efros & Freeman 2001), blocks of a quarter of the exemplar"
    cannot = "make anything that is no copy of pieces of the exemplar, which it holds; nor does it tile"

    def fit(self, tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        """The exemplar is kept: numbers, and as many bytes."""
        assert isinstance(self.app, ExemplarApp)
        exemplar = self.app.exemplar(tasks.data["image"][tasks.rows].float() / 255)[0]
        pictures, kept = quilts(exemplar, (exemplar.shape[1], exemplar.shape[2]), rng), exemplar.numel()
        return BaselineFit(lambda: pictures, kept, kept, picture=picture_of(pictures[0, 0]))


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
