"""The check of parameters that are read back from fits: they must belong to the network that the settings describe.

Anybody may have written the files, so that names, shapes and values are compared before a network is evaluated.
"""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.app import App
from metapp.learning.task import Params, Task, problems_of


def check_params(theta: Params, app: App, place: str) -> None:
    """Compare parameters of one fit with the network of an application, and with the forms of what tasks determine.

    A parameter that tasks determine, such as flashes, replaces the network's: its shape may differ from task to task.

    Args:
        theta: the parameters, without a task axis.
        app: the application, with the network that the settings of the fit describe.
        place: the place of the fit, which messages name.

    Raises:
        ValueError: a parameter is missing or has another shape, or values are integers or not finite.

    >>> from metapp.apps.brdf.recipes import RECIPES
    >>> app = RECIPES["quick"].app
    >>> check_params({"w2": torch.zeros(2)}, app, "gold")
    Traceback (most recent call last):
    ValueError: gold: parameters w2 without 'w1', expected those of the network of its settings; fit anew.
    """
    network_theta, specs = app.postprocess(app.init(Generator().manual_seed(0), 1)), app.task_parameter_specs
    for key, expected in network_theta.items():
        if key in specs:
            continue
        if key not in theta:
            found = f"{', '.join(sorted(theta))[:80] or 'none'} without {key!r}"
            raise ValueError(f"{place}: parameters {found}, expected those of the network of its settings; fit anew.")
        shape, network_shape = tuple(theta[key].shape), tuple(expected.shape[1:])
        if shape != network_shape:
            found = f"{key!r} of shape {shape}, expected {network_shape}"
            raise ValueError(f"{place}: parameters {found} of the network of its settings; fit anew.")
    for key in specs:
        # what is stored as several parameters, such as suns, is there as a whole or not at all
        group = key.partition(".")[0] + "."
        if key not in theta and any(name.startswith(group) for name in theta):
            raise ValueError(f"{place}: parameters without {key!r}, but with others of {group}*; fit anew.")
    if problems := problems_of(Task(place, {key: theta[key] for key in specs if key in theta}), specs):
        raise ValueError(f"{place}: {problems[0]}; fit anew.")
    for key, value in theta.items():
        kind = "NaN or infinite values" if value.is_floating_point() else str(value.dtype).removeprefix("torch.")
        if not value.is_floating_point() or not bool(torch.isfinite(value).all()):
            raise ValueError(f"{place}: parameters {key!r} hold {kind}, expected finite numbers; fit anew.")
