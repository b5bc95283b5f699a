"""Parameters of fits that are read back: those of the network that their settings describe, or refused."""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.app import App
from metapp.learning.task import Params
from metapp.storage import Document
from metapp.storage.fit_folders import read_params


def read_checked_params(record: Document, app: App) -> Params:
    """The parameters of a fit of an application, checked.

    Raises:
        ValueError: they are missing or damaged; as `check_params`.
    """
    theta = read_params(record["folder"])
    check_params(theta, app, record["folder"])
    return theta


def check_params(theta: Params, app: App, place: str) -> None:
    """Compare parameters of one fit, which anybody may have written, with the network of an application.

    Fits may hold more than the network: what an application knows of a task, such as suns.

    Args:
        theta: without a task axis.
        app: of the fit.
        place: of the fit, named in errors.

    Raises:
        ValueError: names, shapes or kinds of numbers of another network; values that are not finite.

    >>> from metapp.apps import app_of, recipe_of
    >>> app = app_of("brdf", recipe_of("brdf", "quick"))
    >>> check_params({"w2": torch.zeros(2)}, app, "gold")
    Traceback (most recent call last):
    ValueError: gold: parameters w2 without 'w1', expected those of the network of its settings; fit anew.
    """
    for key, expected in app.postprocess(app.init(Generator().manual_seed(0), 1)).items():
        if key not in theta:
            found = f"{', '.join(sorted(theta))[:80] or 'none'} without {key!r}"
            raise ValueError(f"{place}: parameters {found}, expected those of the network of its settings; fit anew.")
        shape, of_network = tuple(theta[key].shape), tuple(expected.shape[1:])
        if shape != of_network:
            found = f"{key!r} of shape {shape}, expected {of_network}"
            raise ValueError(f"{place}: parameters {found} of the network of its settings; fit anew.")
    for key, value in theta.items():
        kind = "NaN or infinite values" if value.is_floating_point() else str(value.dtype).removeprefix("torch.")
        if not value.is_floating_point() or not bool(torch.isfinite(value).all()):
            raise ValueError(f"{place}: parameters {key!r} hold {kind}, expected finite numbers; fit anew.")
