"""Pictures of runs: reference beside fit, with the error under each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.torch import load_file

from metapp.files import write_atomically
from metapp.records import file_name
from metapp.task import App, Task


def to_srgb(linear: Any) -> np.ndarray:
    """Linear RGB [H, W, 3] or, on black with coverage, [H, W, 4] to sRGB on white, in [0, 1] (IEC 61966-2-1)."""
    image = np.asarray(linear, dtype=np.float64)
    # composited after encoding, so that the rim stays as smooth as its coverage
    coverage = image[..., 3:] if image.shape[-1] == 4 else np.ones_like(image[..., :1])
    colour = np.clip(image[..., :3] / np.maximum(coverage, 1e-6), 0, 1)
    encoded = np.where(colour <= 0.0031308, 12.92 * colour, 1.055 * colour ** (1 / 2.4) - 0.055)
    return coverage * encoded + (1 - coverage)


def picture_of_run(app: App, paradigm: str, tasks: Sequence[Task], records: Sequence[dict], folder: Path) -> Path:
    """Write `pictures.png` into a run's folder: up to 20 tasks, the reference above the fit, the error under it.

    Returns:
        The file.
    """
    shown = list(zip(tasks, records, strict=True))[:20]
    cells = []
    for task, record in shown:
        theta = load_file(folder / "params" / f"{file_name(task.name)}.safetensors")
        cells.append((app.outputs(theta, task), f"{task.name}\n{record['error']:.3f}"))
    mean = np.mean([record["error"] for record in records])
    factor = f" x{app.scale:g}" if app.scale != 1 else ""
    return _grid(cells, f"{app.title}, {paradigm}: mean error{factor} {mean:.3f}", folder / "pictures.png")


def _grid(cells: list[tuple[dict[str, Any], str]], title: str, path: Path) -> Path:
    from matplotlib.figure import Figure

    columns = min(10, len(cells))
    rows = -(-len(cells) // columns)
    figure = Figure(figsize=(max(1.25 * columns + 0.5, 3.5), 2.8 * rows + 0.4), layout="constrained")
    axes = figure.subplots(2 * rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
        axis.set_frame_on(False)
    for i, (pictures, label) in enumerate(cells):
        row, column = divmod(i, columns)
        for k, name in enumerate(("reference", "fit")):
            axis = axes[2 * row + k, column]
            axis.imshow(to_srgb(pictures[name]))
            if column == 0:
                axis.set_ylabel(name, fontsize=7)
        axes[2 * row + 1, column].set_xlabel(_wrapped(label), fontsize=6, parse_math=False)
    figure.suptitle(title, fontsize=9)
    write_atomically(path, lambda target: figure.savefig(target, dpi=120))
    return path


def _wrapped(label: str) -> str:
    name, error = label.split("\n")
    return f"{name if len(name) < 24 else name[:22] + '…'}\n{error}"
