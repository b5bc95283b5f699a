"""Errors of BRDF fits against the number of samples that they see; `make bench-samples` runs it.

The test materials of a data set (the embedded one, or the folder that is named) are cut down to N samples at random
angles; their held-out samples stay. Checkpoints are the shipped ones. Principal components come from the data set's own
training materials with all their samples, and their penalties are chosen for N.
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
from metapp.cli.command_process import run_command
from metapp.evaluation.error_statistics import compare_errors
from metapp.evaluation.style import FIGURE_STYLE, MUTED_COLOUR, PARADIGM_COLOURS, save_figure
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import TrainingTasks
from metapp.extensions.baselines.baseline_fits import cost_limits_of, read_training_tasks
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from metapp.runs.data_sets.embedded import make_embedded_test_set
from metapp.runs.fitting import Fitter, fit_tasks_of, rng_of
from metapp.runs.inputs.finding import data_label, find_in_data_set, training_data_folder
from metapp.runs.resolve import app_of, complete
from metapp.runs.spec import Spec

MEASURED_COUNTS: tuple[int, ...] = (64, 256, 1024, 5120)  # samples that a fit sees
SAMPLES_FIGURE_FILE = Path("runs/bench/samples.png")
LABEL_DISTANCE_SHARE = 0.04  # distance of labels beside the figure, as a share of its height


class ComparedMethod(NamedTuple):
    """A method of fitting, and how its line looks.

    Attributes:
        title: the name in the table and the figure.
        name: a paradigm, or a baseline if there is no recipe.
        recipe: the paradigm's recipe; "" for a baseline.
        colour: the colour of the line.
        dashes: the line style of matplotlib.
    """

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
ErrorsByName = dict[str, float]  # errors x100 by the task's name


def errors_of_method(method: ComparedMethod, tasks: list[Task], count: int, training: TrainingTasks) -> ErrorsByName:
    """Return errors x100 of a method's fits of tasks that have `count` samples."""
    if not method.recipe:
        return _errors_of_baselines(method, tasks, count, training)
    fitter = Fitter.of(complete(Spec(app="brdf", paradigm=method.name, recipe=method.recipe, device="cpu")))
    return {task.name: fit_tasks_of(fitter, [task])[0].errors["error"] for task in tasks}


@torch.no_grad()
def _errors_of_baselines(
    method: ComparedMethod, tasks: list[Task], count: int, training: TrainingTasks
) -> ErrorsByName:
    """Return errors x100 of a baseline's fits of tasks that have `count` samples."""
    spec = complete(Spec(app="brdf", paradigm="general", recipe="quick", device="cpu"))
    app = app_of(spec)
    baseline = next(candidate for candidate in baselines_of(spec.application, app) if candidate.name == method.name)
    cost_limits = cost_limits_of(spec)
    baseline.prepare(training, cost_limits._replace(samples=min(count, cost_limits.samples)))
    errors = {}
    for task in tasks:
        stacked = stack_tasks(app, [task])
        prediction = baseline.fit(stacked, rng_of(spec, task), cost_limits).prediction()
        errors[task.name] = app.error_measure.scale * float(app.errors_of(prediction, stacked)["error"])
    return errors


def format_ratios(errors_by_count: list[ErrorsByName], base_errors_by_count: list[ErrorsByName]) -> list[str]:
    """Format a method's mean errors over the base method's, a cell for each number of samples.

    A cell has the ratio, paired over tasks, its interval, and on how many tasks the method has the lower error.
    """
    cells = []
    for errors, base_errors in zip(errors_by_count, base_errors_by_count, strict=True):
        comparison = compare_errors(errors, base_errors, {name: name for name in errors}, logarithmic=False)
        assert comparison is not None
        cells.append(f"{comparison}, {comparison.ahead}/{comparison.tasks}")
    return cells


def draw_samples_figure(means_by_method: dict[ComparedMethod, list[float]], file: Path) -> None:
    """Draw mean errors over samples, both logarithmic, with a labelled line for each method."""
    figure = Figure(figsize=(7.0, 4.4))
    axis = figure.subplots()
    for method, errors in means_by_method.items():
        axis.loglog(MEASURED_COUNTS, errors, method.dashes, marker="o", markersize=4, color=method.colour)
    axis.xaxis.set_major_locator(FixedLocator(MEASURED_COUNTS))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axis.yaxis.set_major_locator(FixedLocator([0.01 * 2**i for i in range(11)]))
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("samples that a fit sees")
    axis.set_ylabel("error x100")
    _place_labels(axis, {method: errors[-1] for method, errors in means_by_method.items()})
    save_figure(figure, file)


def _place_labels(axis: Axes, last_errors: dict[ComparedMethod, float]) -> None:
    """Write labels right of the lines' ends, far enough apart to be read."""
    low, high = axis.get_ylim()
    heights: dict[ComparedMethod, float] = {}
    for method, error in sorted(last_errors.items(), key=lambda item: item[1]):
        height = math.log(error / low) / math.log(high / low)
        heights[method] = max(
            height, *(placed_height + LABEL_DISTANCE_SHARE for placed_height in heights.values()), 0.0
        )
    for method, height in heights.items():
        axis.annotate(
            f"{method.title}  {last_errors[method]:.3f}",
            (MEASURED_COUNTS[-1], last_errors[method]),
            (1.05, height),
            textcoords="axes fraction",
            color=method.colour,
            va="center",
            fontsize=8,
            arrowprops={"arrowstyle": "-", "color": method.colour, "linewidth": 0.6, "shrinkB": 3, "relpos": (0, 0.5)},
        )


def main() -> None:
    """Print the tables and draw the figure."""
    torch.set_num_threads(1)
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    spec = complete(Spec(app="brdf", paradigm="general", recipe="quick"))
    application, app = spec.application, app_of(spec)
    folder = data or make_embedded_test_set(application, quiet=True)
    tasks, label = [one.read_task(spec, app) for one in find_in_data_set(spec, folder)], data_label(folder)
    training = read_training_tasks(app, training_data_folder(application, data, quiet=True))
    measured_tasks = [[simulate_measurement(task, 0.0, samples=count) for task in tasks] for count in MEASURED_COUNTS]
    print(f"{label}: {len(tasks)} test materials, {len(training.tasks)} for components; errors x100\n")
    header = (
        f"| method | {' | '.join(f'{count:,}' for count in MEASURED_COUNTS)} |\n|{'---|' * (len(MEASURED_COUNTS) + 1)}"
    )
    print(header)
    errors_by_method, means_by_method = {}, {}
    for method in COMPARED_METHODS:
        errors_by_method[method] = [
            errors_of_method(method, tasks_of_count, count, training)
            for tasks_of_count, count in zip(measured_tasks, MEASURED_COUNTS, strict=True)
        ]
        means_by_method[method] = [statistics.fmean(errors.values()) for errors in errors_by_method[method]]
        print(f"| {method.title} | {' | '.join(f'{error:.3f}' for error in means_by_method[method])} |", flush=True)
    print(f"\nover {BASE_METHOD.title}, 95 % interval, tasks with the lower error of all:\n\n{header}")
    for method in COMPARED_METHODS:
        if method != BASE_METHOD:
            ratios = format_ratios(errors_by_method[method], errors_by_method[BASE_METHOD])
            print(f"| {method.title} | {' | '.join(ratios)} |")
    SAMPLES_FIGURE_FILE.parent.mkdir(parents=True, exist_ok=True)
    with rc_context(FIGURE_STYLE):
        draw_samples_figure(means_by_method, SAMPLES_FIGURE_FILE)
    print(f"\n{SAMPLES_FIGURE_FILE}: figure")


if __name__ == "__main__":
    sys.exit(run_command(main))
