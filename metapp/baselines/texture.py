"""Baselines of texture networks: the nearest training texture, and pictures of patches of the exemplar itself."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from torch import Generator

from metapp.baselines.baseline import Allowed, Baseline, Fitted, Prepared, Training
from metapp.baselines.exemplars import nearest_exemplar, picture_of
from metapp.baselines.methods.quilting import quilted, random_patches
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.networks.exemplar import JUDGED, ExemplarApp

Make = Callable[[np.ndarray, np.random.Generator], np.ndarray]


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


def _copies(make: Make, training: Training, allowed: Allowed) -> Prepared:
    """Pictures of patches of the exemplar; seconds are of as many pictures as are judged."""
    app = training.app
    assert isinstance(app, ExemplarApp)

    def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> Fitted:
        exemplar = app.exemplar(tasks.data["image"][tasks.rows].float() / 255)[0]
        numbers = np.random.default_rng(int(torch.randint(2**31, (), generator=rng)))
        made = [make(exemplar.permute(1, 2, 0).numpy(), numbers) for _ in range(JUDGED)]
        pictures = torch.from_numpy(np.stack(made)).permute(0, 3, 1, 2)[None]
        count = exemplar.numel()  # and as many bytes
        return Fitted(lambda: pictures, count, count, picture=picture_of(pictures[0, 0]))

    return Prepared(fit)
