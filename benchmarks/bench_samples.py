"""Errors of BRDF fits against the number of samples that they see; `make bench-samples` runs it.

The test materials of a data set (the embedded one, or the folder that is named), cut down to N
samples: N at random angles, held-out ones as they are. Checkpoints are those that ship;
components are of the data set's own training materials with all their samples, and their penalties are chosen for N.
"""

from __future__ import annotations

import math
import statistics
import sys
from pathlib import Path
from typing import NamedTuple

import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

from benchmarks.simulated_measurements import simulate_measurement
from metapp.cli.console import run_command
from metapp.evaluation.error_statistics import compare_errors
from metapp.evaluation.style import FIGURE_STYLE, MUTED_COLOUR, PARADIGM_COLOURS, save_figure
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import TrainingTasks, judge_answer
from metapp.extensions.baselines.baseline_fits import cost_limits_of_run, read_training_tasks
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from metapp.runs.checkpoint_selection import attach_checkpoint
from metapp.runs.fit_options import fit_options
from metapp.runs.fitting import fit_tasks, rng_of
from metapp.runs.inputs.run_inputs import read_test_tasks, training_data_folder
from metapp.runs.run import Run

MEASURED_COUNTS: tuple[int, ...] = (64, 256, 1024, 5120)
SAMPLES_FIGURE_FILE = Path("runs/bench/samples.png")
LABEL_DISTANCE_SHARE = 0.04  # of names beside the figure, as a share of its height


class ComparedMethod(NamedTuple):
    """A way to fit, by a paradigm's recipe where it has one, else a baseline, and how its line looks."""

    title: str
    name: str
    recipe: str
    colour: str
    dashes: str = "-"


COMPARED_METHODS = (
    ComparedMethod("meta, ridge", "meta", "full", PARADIGM_COLOURS["meta"]),
    ComparedMethod("pca_20", "pca_20", "", "#99c7e0"),
    ComparedMethod("pca_66", "pca_66", "", PARADIGM_COLOURS["finetune"]),
    ComparedMethod("pca_150", "pca_150", "", PARADIGM_COLOURS["overfit"]),
    ComparedMethod("meta, ten gradient steps", "meta", "quick", PARADIGM_COLOURS["meta"], ":"),
    ComparedMethod("quickft", "quickft", "quick", PARADIGM_COLOURS["quickft"]),
    ComparedMethod("general", "general", "quick", PARADIGM_COLOURS["general"]),
    ComparedMethod("two GGX lobes", "ggx_2", "", MUTED_COLOUR),
)

BASE_METHOD = COMPARED_METHODS[0]
ErrorsByName = dict[str, float]  # by the task's name


def errors_of_method(
    way: ComparedMethod, tasks: list[Task], data: Path | None, count: int, training: TrainingTasks
) -> ErrorsByName:
    """Errors x100 of fits of tasks that have so many samples."""
    if not way.recipe:
        return _errors_of_baselines(way, tasks, count, training)
    planned = Run.from_options(fit_options("brdf", way.name, recipe=way.recipe, data=data, device="cpu", quiet=True))
    return {fit.name: fit.record["error"] for fit in fit_tasks(attach_checkpoint(planned), tasks)}


@torch.no_grad()
def _errors_of_baselines(way: ComparedMethod, tasks: list[Task], count: int, training: TrainingTasks) -> ErrorsByName:
    planned = Run.from_options(fit_options("brdf", "general", recipe="quick", device="cpu", quiet=True))
    baseline = next(each for each in baselines_of(planned.app) if each.name == way.name)
    allowed = cost_limits_of_run(planned)
    baseline.prepare(training, allowed._replace(samples=min(count, allowed.samples)))
    errors = {}
    for task in tasks:
        stacked = stack_tasks(planned.app, [task])
        answer = baseline.fit(stacked, rng_of(planned, task), allowed).answer()
        errors[task.name] = planned.app.error_measure.scale * float(judge_answer(planned.app, answer, stacked)["error"])
    return errors


def format_ratios(found: list[ErrorsByName], others: list[ErrorsByName]) -> list[str]:
    """Mean errors over those of another way, paired over tasks, with their intervals; on how many tasks it is ahead."""
    cells = []
    for one, other in zip(found, others, strict=True):
        told = compare_errors(one, other, {name: name for name in one}, logarithmic=False)
        assert told is not None
        cells.append(f"{told}, {told.ahead}/{told.tasks}")
    return cells


def draw_samples_figure(found: dict[ComparedMethod, list[float]], file: Path) -> None:
    """Errors over samples, both logarithmic, a line a way, its name at the line's end."""
    drawn = Figure(figsize=(7.0, 4.4))
    axis = drawn.subplots()
    for way, errors in found.items():
        axis.loglog(MEASURED_COUNTS, errors, way.dashes, marker="o", markersize=4, color=way.colour)
    axis.xaxis.set_major_locator(FixedLocator(MEASURED_COUNTS))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axis.yaxis.set_major_locator(FixedLocator([0.01 * 2**i for i in range(11)]))
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("samples that a fit sees")
    axis.set_ylabel("error x100")
    _name(axis, {way: errors[-1] for way, errors in found.items()})
    save_figure(drawn, file)


def _name(axis: Axes, last: dict[ComparedMethod, float]) -> None:
    """Put names right of the lines' ends, so far apart that they can be read."""
    low, high = axis.get_ylim()
    places: dict[ComparedMethod, float] = {}
    for way, error in sorted(last.items(), key=lambda item: item[1]):
        place = math.log(error / low) / math.log(high / low)
        places[way] = max(place, *(each + LABEL_DISTANCE_SHARE for each in places.values()), 0.0)
    for way, place in places.items():
        axis.annotate(
            f"{way.title}  {last[way]:.3f}",
            (MEASURED_COUNTS[-1], last[way]),
            (1.05, place),
            textcoords="axes fraction",
            color=way.colour,
            va="center",
            fontsize=8,
            arrowprops={"arrowstyle": "-", "color": way.colour, "linewidth": 0.6, "shrinkB": 3, "relpos": (0, 0.5)},
        )


def main() -> None:
    """Print the table, draw the figure."""
    torch.set_num_threads(1)
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    app = Run.from_options(fit_options("brdf", "general", recipe="quick")).app
    tasks, label = read_test_tasks(app, data, quiet=True)
    training = read_training_tasks(app, training_data_folder(app, data, quiet=True))
    cut = [[simulate_measurement(task, 0.0, samples=count) for task in tasks] for count in MEASURED_COUNTS]
    print(f"{label}: {len(tasks)} test materials, {len(training.tasks)} for components; errors x100\n")
    head = (
        f"| method | {' | '.join(f'{count:,}' for count in MEASURED_COUNTS)} |\n|{'---|' * (len(MEASURED_COUNTS) + 1)}"
    )
    print(head)
    found, means = {}, {}
    for way in COMPARED_METHODS:
        found[way] = [
            errors_of_method(way, few, data, count, training) for few, count in zip(cut, MEASURED_COUNTS, strict=True)
        ]
        means[way] = [statistics.fmean(errors.values()) for errors in found[way]]
        print(f"| {way.title} | {' | '.join(f'{error:.3f}' for error in means[way])} |", flush=True)
    print(f"\nover {BASE_METHOD.title}, 95 % interval, tasks with the lower error of all:\n\n{head}")
    for way in COMPARED_METHODS:
        if way != BASE_METHOD:
            print(f"| {way.title} | {' | '.join(format_ratios(found[way], found[BASE_METHOD]))} |")
    SAMPLES_FIGURE_FILE.parent.mkdir(parents=True, exist_ok=True)
    with rc_context(FIGURE_STYLE):
        draw_samples_figure(means, SAMPLES_FIGURE_FILE)
    print(f"\n{SAMPLES_FIGURE_FILE}: figure")


if __name__ == "__main__":
    sys.exit(run_command(main))
