"""Contact sheets that show fits of several methods beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.presenter import Presenter
from metapp.learning.task import Task
from metapp.runs.fit import Fit
from metapp.runs.outputs.contact_sheet import (
    TASK_PICTURE_NAMES,
    Tiles,
    to_display_values,
    write_contact_sheet,
)
from metapp.storage.fit_folders import read_params

PICTURE_KEY = "picture"  # the tensor that methods without a network keep in place of parameters


def tiles_of_methods(task: Task, fits: Sequence[tuple[str, Fit]]) -> Tiles:
    """Return the reference, the photo or the samples of a task, then a picture of each fit of the task by its label.

    Args:
        task: the task.
        fits: the label and the fit of each method.
    """
    tiles: dict[str, np.ndarray] = {}
    for label, fit in fits:
        theta = read_params(fit.folder)
        with torch.no_grad():
            is_picture = PICTURE_KEY in theta
            pictures = {"fit": theta[PICTURE_KEY]} if is_picture else fit.presenter.preview(fit.parameters, task)
        if not tiles:
            tiles |= to_display_values({name: pictures[name] for name in TASK_PICTURE_NAMES if name in pictures})
        tiles[label] = composite_to_srgb(pictures["fit"])
    return Tiles(tiles, task.name, {label: fit.error_text() for label, fit in fits})


def write_comparison_sheet(presenter: Presenter[Any], tasks: list[Tiles], file: Path) -> Path:
    """Write a contact sheet of fits that are compared, with the error of each fit below its picture.

    Args:
        presenter: the presenter of the application.
        tasks: the rows, each with all fits of one task.
        file: the file to write, a PNG.

    Returns:
        The file that was written.
    """
    return write_contact_sheet(
        tasks, f"{presenter.title}: mean error{presenter.app.error_measure.factor} of each fit below it", file
    )
