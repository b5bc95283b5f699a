"""What a fit makes for its user, in a run's folder: pictures and maps, renders of its scene, other formats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from metapp.appearance.colour import stretched, tone_map
from metapp.appearance.presentation import Picture, Presentation
from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.runs.export import export_fit
from metapp.storage.images import write_exr, write_png
from metapp.storage.records import RunFolder, file_name

OUTPUTS = "outputs"  # the folder of pictures and maps, in a run's


def write_fit(shown: Presentation[Any], run: RunFolder, task: Task, theta: Params, form: str) -> None:
    """Write what a fit makes, <run>/outputs, and in the form of --export, if any, <run>/<form>."""
    write_files(shown, task, theta, run.path / OUTPUTS)
    if form:
        export_fit(shown, task, theta, run.path / form / file_name(task.name), form, run.settings)


def write_files(shown: Presentation[Any], task: Task, theta: Params, folder: Path) -> None:
    """Write what a fit makes for its user, if anything, <folder>/<task>/<name>.png, 8 bits.

    Colours are sRGB; data such as roughness, normals and heights are linear: the PNG's text `encoding` says which.
    Heights h, in texels, are kept as (h - minimum) / (maximum - minimum), of which the texts `height_minimum` and
    `height_maximum` tell. Radiance is kept as <name>.exr, and tone-mapped beside it.
    """
    _write(shown.files(theta, task), folder / file_name(task.name))


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
