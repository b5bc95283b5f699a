"""Draw the validation error of trainings over outer steps: training_curves.py PICTURE FILE:ENTRY...

Each entry of a checkpoint gets a panel with logarithmic axes, drawn from its description. A broken line continues the
curve to the recipe's number of steps: the least-squares line, in these axes, of the curve's second half.
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
from metapp.storage.checkpoint_files import read_headers


def extrapolate_errors(
    steps: NDArray[np.float64], errors: NDArray[np.float64], wanted_steps: NDArray[np.float64]
) -> Any:
    """Return the errors after other numbers of steps, by a power law that is fitted to the second half of a curve.

    Args:
        steps: outer steps of the curve, [N].
        errors: validation errors after these steps, [N].
        wanted_steps: outer steps to extrapolate to, [M].

    Returns:
        The extrapolated errors, [M].
    """
    is_second_half = steps >= steps[-1] / 2
    slope, level = np.polyfit(np.log(steps[is_second_half]), np.log(errors[is_second_half]), 1)
    return np.exp(level + slope * np.log(wanted_steps))


def draw_panel(axes: Axes, entry: str, info: dict[str, Any]) -> None:
    """Draw the validation curve of one checkpoint and its extrapolation, and print both last errors."""
    curve = np.array([(step, error) for step, _, error in info["curve"][1:]])
    steps, errors, planned = curve[:, 0], np.minimum.accumulate(curve[:, 1]), info["training"]["steps"]
    axes.plot(steps, curve[:, 1], color="lightgrey", linewidth=0.8)
    axes.plot(steps, errors, color=PARADIGM_COLOURS["meta"])
    title = f"{info['app']}, seed {info['seed']}\n{info['checkpoint']}, {info['recipe']}"
    axes.set(xscale="log", xlabel="outer steps", title=title)
    summary = f"{entry}: {errors[-1]:.3f} after {steps[-1]:,.0f} steps"
    if steps[-1] < planned and errors.min() > 0:
        planned_steps = np.geomspace(steps[-1], planned, 20)
        axes.plot(planned_steps, extrapolate_errors(steps, errors, planned_steps), "--", color=PARADIGM_COLOURS["meta"])
        last_error = extrapolate_errors(steps, errors, planned_steps)[-1]
        summary += f"; {last_error:.3f} after {planned:,} by a power law of the second half"
    if errors.min() > 0:
        axes.set(yscale="log")
        axes.yaxis.set_major_formatter("{x:g}")
        # on less than half a decade each tick has room for a label
        has_few_ticks = axes.get_ylim()[1] < 3 * axes.get_ylim()[0]
        axes.yaxis.set_minor_formatter(lambda y, _: f"{y:g}" if has_few_ticks or f"{y:e}"[0] in "235" else "")
    print(summary, file=sys.stderr)


def main(picture: str, *entries: str) -> None:
    """Draw the curves of all entries side by side."""
    with rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(3.2 * len(entries), 2.4))
        files_and_names = [entry.rpartition(":")[::2] for entry in entries]
        infos = [read_headers(Path(file))[name] for file, name in files_and_names]
        is_one_app = len({info["app"] for info in infos}) == 1
        panels = figure.subplots(1, len(infos), squeeze=False, sharex=is_one_app, sharey=is_one_app)
        for axes, entry, info in zip(panels[0], entries, infos, strict=True):
            draw_panel(axes, entry, info)
        panels[0, 0].set_ylabel("validation error")
        save_figure(figure, Path(picture))


if __name__ == "__main__":
    main(*sys.argv[1:])
