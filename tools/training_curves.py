"""Draw the validation error of trainings over outer steps: training_curves.py PICTURE CHECKPOINT...

A panel for each checkpoint, on logarithmic axes: what its header holds. A broken line goes on as the last half of the
curve falls, a straight line of least squares in these axes, as far as the recipe's number of steps.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from metapp.evaluation.style import FIGURE_STYLE, PARADIGM_COLOURS, save_figure
from metapp.storage.checkpoint_files import load_checkpoint


def extrapolate_errors(steps: NDArray[np.float64], errors: NDArray[np.float64], until: NDArray[np.float64]) -> Any:
    """The errors at other steps, by a power law of the second half of a curve."""
    half = steps >= steps[-1] / 2
    slope, level = np.polyfit(np.log(steps[half]), np.log(errors[half]), 1)
    return np.exp(level + slope * np.log(until))


def draw_panel(axes: Axes, path: Path, info: dict[str, Any]) -> None:
    """The curve of one checkpoint with this header, and what it extrapolates to."""
    curve = np.array([(step, error) for step, _, error in info["curve"][1:]])
    steps, errors, planned = curve[:, 0], np.minimum.accumulate(curve[:, 1]), info["training"]["steps"]
    axes.plot(steps, curve[:, 1], color="lightgrey", linewidth=0.8)
    axes.plot(steps, errors, color=PARADIGM_COLOURS["meta"])
    title = f"{info['app']}, seed {info['seed']}\n{info['checkpoint']}, {info['recipe']}"
    axes.set(xscale="log", xlabel="outer steps", title=title)
    words = f"{path}: {errors[-1]:.3f} after {steps[-1]:,.0f} steps"
    if steps[-1] < planned and errors.min() > 0:
        until = np.geomspace(steps[-1], planned, 20)
        axes.plot(until, extrapolate_errors(steps, errors, until), "--", color=PARADIGM_COLOURS["meta"])
        words += (
            f"; {extrapolate_errors(steps, errors, until)[-1]:.3f} after {planned:,} by a power law of the second half"
        )
    if errors.min() > 0:
        axes.set(yscale="log")
        axes.yaxis.set_major_formatter("{x:g}")
        few = axes.get_ylim()[1] < 3 * axes.get_ylim()[0]  # of a decade: all of its ticks have room for a label
        axes.yaxis.set_minor_formatter(lambda y, _: f"{y:g}" if few or f"{y:e}"[0] in "235" else "")
    print(words, file=sys.stderr)


def main(picture: Path, *checkpoints: Path) -> None:
    """Draw all curves side by side."""
    with rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(3.2 * len(checkpoints), 2.4))
        infos = [load_checkpoint(path)[1] for path in checkpoints]
        alike = len({info["app"] for info in infos}) == 1
        panels = figure.subplots(1, len(infos), squeeze=False, sharex=alike, sharey=alike)
        for axes, path, info in zip(panels[0], checkpoints, infos, strict=True):
            draw_panel(axes, path, info)
        panels[0, 0].set_ylabel("validation error")
        save_figure(figure, picture)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
