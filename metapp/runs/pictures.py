"""Pictures of runs: reference beside fit, with the error under each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from metapp.appearance.colour import linear_to_srgb
from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs.naming import title_of
from metapp.runs.sheet import Column, write_sheet
from metapp.storage.records import read_theta, summary

COMPARED = 20  # tasks in a picture of all paradigms
PICTURE = "picture"  # what is kept in place of parameters where there are none


def to_srgb(linear: Any) -> np.ndarray:
    """Linear RGB [H, W, 3] or, on black with coverage, [H, W, 4] to sRGB on white, in [0, 1] (IEC 61966-2-1)."""
    image = np.asarray(linear, dtype=np.float64)
    # composited after encoding, so that the rim stays as smooth as its coverage
    coverage = image[..., 3:] if image.shape[-1] == 4 else np.ones_like(image[..., :1])
    colour = np.clip(image[..., :3] / np.maximum(coverage, 1e-6), 0, 1)
    result: np.ndarray = coverage * linear_to_srgb(torch.from_numpy(colour)).numpy() + (1 - coverage)
    return result


def picture_of_run(
    app: App, paradigm: str, tasks: Sequence[Task], records: Sequence[dict[str, Any]], folder: Path
) -> Path:
    """Write `pictures.png` into a run's folder: up to 20 tasks, a column each, the reference above the fit.

    Returns:
        The file.
    """
    columns, outputs = [], presentation_of(app).outputs
    for task, record in list(zip(tasks, records, strict=True))[:20]:
        columns.append(Column(_shown(outputs(_theta(folder, task), task)), task.name, _label(record)))
    mean = summary(records)["error"]
    found = "" if mean is None else f": mean error{_factor(app)} {mean:.3f}"
    return write_sheet(columns, f"{title_of(app)}, {paradigm}{found}", folder / "pictures.png")


def picture_of_table(
    app: App,
    tasks: Sequence[Task],
    runs: Sequence[tuple[str, Path, list[dict[str, Any]]]],
    file: Path,
    tell: Callable[[], None] = lambda: None,
) -> Path:
    """Write one picture of up to COMPARED tasks, a column each: the reference, and the fit of every paradigm below it.

    Args:
        app: the application.
        tasks: what was fitted.
        runs: (label, run folder, records of all tasks) of each paradigm.
        file: where to.
        tell: called after each task's pictures, as those of a scene take seconds.

    Returns:
        The file.
    """
    columns = []
    for i, task in enumerate(tasks[:COMPARED]):
        columns.append(column_of(task, [(label, app, folder, records[i]) for label, folder, records in runs]))
        tell()
    return write_compared(app, columns, file)


def column_of(task: Task, fits: Sequence[tuple[str, App, Path, dict[str, Any]]]) -> Column:
    """The reference of a task, and its fits below it: (label, application, run folder, record) of each."""
    rows: dict[str, np.ndarray] = {}
    for label, app, folder, record in fits:
        theta = _theta(folder, task)
        pictures = {"fit": theta[PICTURE]} if PICTURE in theta else presentation_of(app).outputs(theta, task)
        rows |= _shown({"reference": pictures["reference"]}) if not rows and "reference" in pictures else {}
        rows[f"{label} {_label(record)}".rstrip()] = to_srgb(pictures["fit"])
    return Column(rows, task.name)


def write_compared(app: App, columns: list[Column], file: Path) -> Path:
    """Write columns of fits that are compared as one picture."""
    return write_sheet(columns, f"{title_of(app)}: mean error{_factor(app)} of each fit below it", file)


def _theta(folder: Path, task: Task) -> dict[str, Any]:
    return read_theta(folder, task.name)


def _label(record: dict[str, Any]) -> str:
    return "" if record["error"] is None else f"{record['error']:.3f}"


def _factor(app: App) -> str:
    return f" x{app.traits.scale:g}" if app.traits.scale != 1 else ""


def _shown(pictures: dict[str, Any]) -> dict[str, np.ndarray]:
    return {name: to_srgb(picture) for name, picture in pictures.items()}
