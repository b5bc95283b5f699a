"""Pictures of runs: reference beside fit, with the error under each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from metapp.appearance.colour import linear_to_srgb, stretched, tone_map
from metapp.appearance.presentation import Picture, Presentation
from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.runs.session import title_of
from metapp.runs.sheet import Column, write_sheet
from metapp.storage.images import write_exr, write_png
from metapp.storage.records import file_name, read_theta, summary

COMPARED = 20  # tasks in a picture of all paradigms
OUTPUTS = "outputs"  # the folder of what fits make for their users, in a run's
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


def write_files(shown: Presentation[Any], task: Task, theta: Params, folder: Path) -> bool:
    """Write what a fit makes for its user, <folder>/<task>/<name>.png, 8 bits; False where that is nothing.

    Colours are sRGB; data such as roughness, normals and heights are linear: the PNG's text `encoding` says which.
    Heights h, in texels, are kept as (h - minimum) / (maximum - minimum), of which the texts `height_minimum` and
    `height_maximum` tell. Radiance is kept as <name>.exr, and tone-mapped beside it.
    """
    files = shown.files(theta, task)
    _write(files, folder / file_name(task.name))
    return bool(files)


def write_renders(app: App, tasks: Sequence[Task], folder: Path, side: int) -> list[str]:
    """Write pictures of the tasks' scenes, <folder>/<task>/<name>.exr and .png, their longer side in px.

    Returns:
        what to say of them.
    """
    shown, lines = presentation_of(app), []
    for task in tasks:
        made = shown.rendered(task, side)
        if made is None:
            raise ValueError(f"{task.name}: no scene, expected one to render; leave --render out.")
        _write(made.files, folder / file_name(task.name))
        lines += [f"{task.name}: {line}" for line in made.lines]
    return lines


def _write(files: dict[str, Picture], folder: Path) -> None:
    for name, (pixels, kind) in files.items():
        file = folder / f"{name}.png"
        texts = {"encoding": "linear" if kind in ("data", "height") else "sRGB"}
        if kind == "height":
            pixels, low, high = stretched(pixels)
            texts |= {"height_minimum": f"{low:.9g}", "height_maximum": f"{high:.9g}", "height_unit": "texels"}
        if kind == "radiance":
            write_exr(pixels, file.with_name(f"{name}.exr"))
            pixels = tone_map(pixels / pixels.mean().clamp_min(1e-20))  # whatever its unit
        write_png(pixels, texts, file)


def _theta(folder: Path, task: Task) -> dict[str, Any]:
    return read_theta(folder, task.name)


def _label(record: dict[str, Any]) -> str:
    return "" if record["error"] is None else f"{record['error']:.3f}"


def _factor(app: App) -> str:
    return f" x{app.traits.scale:g}" if app.traits.scale != 1 else ""


def _shown(pictures: dict[str, Any]) -> dict[str, np.ndarray]:
    return {name: to_srgb(picture) for name, picture in pictures.items()}
