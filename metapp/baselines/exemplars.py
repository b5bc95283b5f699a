"""What baselines of textures and of stationary svBRDFs share: the nearest training exemplar by the same statistics."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import distance
from metapp.baselines.baseline import Allowed, Prepared, Training, bytes_of, nearest
from metapp.learning.task import Tasks
from metapp.networks.exemplar import ExemplarApp

AT_ONCE = 8  # training tasks whose matrices are compared


def nearest_exemplar(training: Training, allowed: Allowed) -> Prepared:
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
    return Prepared(fit, shared)


def picture_of(srgb: Tensor) -> Tensor:
    """Linear RGB [H, W, 3] of a picture [3, H, W], sRGB in [0, 1]."""
    return srgb_to_linear(srgb).permute(1, 2, 0)
