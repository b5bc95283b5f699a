"""Figures: functions of a subject that draw one, None where nothing was measured yet that it could show; written."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator
from torch import Tensor

from metapp.appearance.colour import to_srgb
from metapp.evaluation.rows import values_of
from metapp.evaluation.style import COLOURS, INK, MUTED, STYLE, Drawn, new, save
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables import load_table, table_names
from metapp.evaluation.tables.convergence import CURVES, PARTS, parts_of, trace_cell
from metapp.evaluation.tables.results import result_row
from metapp.learning.task import Params
from metapp.rules import rule_of
from metapp.runs.naming import factor_of, name_of

MARKERS = {"general": "o", "overfit": "s", "finetune": "D", "quickft": "^", "meta": "*"}
TITLES = {"general": "General", "overfit": "Overfit", "finetune": "Finetune", "quickft": "QuickFT", "meta": "Meta"}
BESIDE = "x"  # marker of other methods
OFFSETS = {"meta": (8, 8), "quickft": (6, -13)}  # points; the two often lie close
PATHS, STRIPS = 3, 4  # tasks
BINS = 48


def _one_panel(subject: Subject, width: float, height: float) -> tuple[Figure, Axes]:
    figure, axes = new(width, height)
    axes[0, 0].set_title(subject.title)
    return figure, axes[0, 0]


def plane(subject: Subject) -> Drawn | None:
    """Mean error with its 95 % interval over median seconds; crosses are other methods, best is top right."""
    rows = {name: result_row(subject, name) for name in COLOURS}
    rows = {name: row for name, row in rows.items() if None not in (row["error"], row["seconds"])}
    if not rows:
        return None
    figure, axis = _one_panel(subject, 4.0, 3.0)
    for name, row in rows.items():
        reach = [[row["error"] - row["low"]], [row["high"] - row["error"]]]
        size, place = 12 if name == "meta" else 7, (row["seconds"], row["error"])
        axis.errorbar(*place, yerr=reach, capsize=2, fmt=MARKERS[name], color=COLOURS[name], markersize=size)
        axis.annotate(TITLES[name], place, OFFSETS.get(name, (6, 6)), textcoords="offset points", fontsize=8)
    beside = [row for name in table_names() for row in load_table(name).plane(subject)]
    others = [row for row in beside if None not in (row["error"], row["seconds"])]
    for row in others:
        axis.plot(row["seconds"], row["error"], BESIDE, color=MUTED, markersize=5)
        # turned, so that names of neighbours part
        axis.annotate(
            row["paradigm"],
            (row["seconds"], row["error"]),
            (2, 3),
            textcoords="offset points",
            fontsize=6,
            color=MUTED,
            rotation=40,
            rotation_mode="anchor",
        )
    axis.set_xscale("log")
    axis.invert_xaxis()
    axis.invert_yaxis()
    axis.margins(x=0.18, y=0.12)
    axis.set_xlabel("seconds of inference (faster to the right)")
    axis.set_ylabel(f"error{factor_of(subject.app)} (better above)")
    named = [*((TITLES[name], row) for name, row in rows.items()), *((row["paradigm"], row) for row in others)]
    figures = ", ".join(f"{name} {row['error']:.3f} in {row['seconds']:.3g} s" for name, row in named)
    return Drawn(figure, f"{subject.title}: mean error over seconds of inference. {figures}.")


def ranks(subject: Subject) -> Drawn | None:
    """Errors of the test tasks, each paradigm's sorted by itself."""
    by_name = {name: sorted(values_of(subject.cell(name)).values()) for name in COLOURS}
    by_name = {name: errors for name, errors in by_name.items() if errors}
    if not by_name:
        return None
    figure, axis = _one_panel(subject, 4.0, 3.2)
    for name, errors in by_name.items():
        draw_line(axis, range(1, len(errors) + 1), errors, name)
    if min(min(errors) for errors in by_name.values()) > 0:
        axis.set_yscale("log")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel("test task, each paradigm's in order of error")
    axis.set_ylabel(f"error{factor_of(subject.app)}")
    legend(figure)
    worst = ", ".join(f"{TITLES[name]} {errors[-1]:.3f}" for name, errors in by_name.items())
    return Drawn(figure, f"{subject.title}: errors of all test tasks, sorted. Worst: {worst}.")


def curves(subject: Subject) -> Drawn | None:
    """Mean error over the traced tasks along the steps of each paradigm."""
    records = trace_cell(subject).records()
    if not records or records[0]["curves"]["meta"][0][1] is None:
        return None
    figure, axis = _one_panel(subject, 4.0, 3.2)
    last = {}
    for name in CURVES:
        steps = [step for step, _ in records[0]["curves"][name]]
        errors = [statistics.fmean(r["curves"][name][i][1] for r in records) for i in range(len(steps))]
        draw_line(axis, steps, errors, name)
        last[name] = errors[-1]
    axis.set_xscale("symlog", linthresh=1)
    if min(value for record in records for name in CURVES for _, value in record["curves"][name]) > 0:
        axis.set_yscale("log")
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("gradient steps")
    axis.set_ylabel(f"error{factor_of(subject.app)}")
    legend(figure)
    errors_said = ", ".join(f"{TITLES[name]} {error:.3f}" for name, error in last.items())
    caption = f"{subject.title}: error along the steps, mean over {len(records)} tasks. In the end: {errors_said}."
    return Drawn(figure, caption)


def trajectories(subject: Subject) -> Drawn | None:
    """Meta's and Overfit's paths in the plane of most variance of their parameters, a few tasks.

    None where their networks differ, as they do where a rule solves for the last layer.
    """
    records = [record for record in trace_cell(subject).records() if record["paths"]["meta"]][:PATHS]
    if not records:
        return None
    figure, axes = new(2.6 * len(records) + 0.4, 2.9, 1, len(records))
    for axis, record in zip(axes[0], records, strict=True):
        for name in ("overfit", "meta"):
            x, y = zip(*record["paths"][name], strict=True)
            axis.plot(x, y, color=COLOURS[name], marker=".", markersize=3, linewidth=1.2, label=TITLES[name])
            axis.plot(x[0], y[0], "o", color="white", markeredgecolor=COLOURS[name], markersize=7)
            axis.plot(x[-1], y[-1], "*", color=COLOURS[name], markeredgecolor=INK, markeredgewidth=0.5, markersize=11)
        axis.set_xticklabels([])
        axis.set_yticklabels([])
        name = record["name"] if len(record["name"]) < 26 else record["name"][:24] + "…"
        axis.set_title(f"{name}\n{record['explained']:.0%} of the variance", fontsize=8, parse_math=False)
    legend(figure)
    figure.suptitle(f"{subject.title}: from the initialisation (ring) to the result (star)", fontsize=10)
    tasks = ", ".join(record["name"] for record in records)
    return Drawn(
        figure, f"{subject.title}: paths of Meta and Overfit through parameter space, in two principal axes: {tasks}."
    )


def step_sizes(rule: str, alpha: Params) -> dict[str, np.ndarray]:
    """Step sizes of each parameter tensor, over its entries and all steps; of any sign where the rule is SGD."""
    sizes = {}
    for name, value in alpha.items():
        part, _, key = name.partition(".")
        if part == "rate" and value.numel() > 1:
            pace = alpha.get(f"pace.{key}")
            rate = value if pace is None else value + pace.reshape(-1, *[1] * (value.ndim - 1))
            sizes[key] = (rate if rule_of(rule).has("sgd") else rate.exp()).flatten().double().cpu().numpy()
    return sizes


def _weight_rates(alpha: Params) -> list[Tensor]:
    return [value for name, value in alpha.items() if name.startswith("rate.") and value.numel() > 1 and value.ndim > 1]


def rates(subject: Subject) -> Drawn | None:
    """Magnitudes of learned step sizes, layer above layer."""
    fit = subject.fits["meta"]
    alpha = fit.phi.alpha if fit.checkpoint else {}
    sizes = step_sizes(fit.paradigm.rule_name, alpha)
    if not sizes:
        return None
    logs = {key: np.log10(np.abs(values[values != 0])) for key, values in sizes.items()}
    logs = {key: values for key, values in logs.items() if len(values)}
    low, high = (f(f(values) for values in logs.values()) for f in (min, max))
    edges = np.linspace(low - 0.1, high + 0.1, BINS + 1)
    figure, axis = _one_panel(subject, 4.0, 0.24 * len(logs) + 1.2)
    for i, values in enumerate(logs.values()):
        counts, _ = np.histogram(values, edges)
        heights = -i + 0.9 * counts / counts.max()
        axis.fill_between(edges[:-1], -i, heights, step="post", color=COLOURS["meta"], alpha=0.55, linewidth=0)
        axis.step(edges[:-1], heights, where="post", color=INK, linewidth=0.5)
    axis.set_yticks([-i for i in range(len(logs))], list(logs), fontsize=7)
    axis.set_xlabel("learned step size, power of ten")
    axis.set_title(f"{subject.title}: {fit.paradigm.rule_name}")
    negative = {key: float((values < 0).mean()) for key, values in sizes.items()}
    more = f"; negative: {np.mean(list(negative.values())):.0%}" if any(negative.values()) else ""
    middle = np.median(np.concatenate(list(logs.values())))
    if all(len(np.unique(value.flatten(1)[0].numpy())) == 1 for value in _weight_rates(alpha)):
        more += "; the same for all weights, as its Adam was searched"
    what = f"step sizes that {fit.paradigm.rule_name} has learned, a row a layer; median {10**middle:.1e}{more}"
    return Drawn(figure, f"{subject.title}: {what}.")


def strips(subject: Subject) -> Drawn | None:
    """A strip a task: initialisation, 25, 50, 75, 100 % of Meta's steps, target."""
    cell = trace_cell(subject)
    finished = {record["name"] for record in cell.records()}
    tasks = [task for task in cell.tasks if task.name in finished][:STRIPS]
    if not tasks:
        return None
    pictures = []
    for task in tasks:
        made = [subject.app.preview(theta, task) for theta in parts_of(cell, task).values()]
        last = [made[-1]["reference"]] if "reference" in made[-1] else []
        pictures.append([to_srgb(picture) for picture in [*(outputs["fit"] for outputs in made), *last]])
    height, width = pictures[0][0].shape[:2]
    figure, axes = new(1.25 * 6 + 0.2, (1.25 * height / width + 0.06) * len(tasks) + 0.55, len(tasks), len(PARTS) + 1)
    titles = ["initialisation", *(f"{part:.0%}" for part in PARTS[1:]), "target"]
    for axis in axes.flat:
        axis.set_axis_off()
    for row, strip in zip(axes, pictures, strict=True):
        for axis, picture in zip(row, strip, strict=False):
            axis.imshow(picture)
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=8)
    figure.suptitle(f"{subject.title}: along Meta's steps", fontsize=10)
    names = ", ".join(task.name for task in tasks)
    return Drawn(
        figure, f"{subject.title}: pictures after 0, 25, 50, 75 and 100 % of Meta's steps, and targets: {names}."
    )


def draw_line(axis: Axes, x: Sequence[float], y: Sequence[float], name: str) -> None:
    """Draw a paradigm's line."""
    size = 7 if name == "meta" else 4
    axis.plot(x, y, color=COLOURS[name], marker=MARKERS[name], markersize=size, label=TITLES[name])


def legend(figure: Figure) -> None:
    """Name the lines of a figure's first axes below it, where the names cover none of them."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), columnspacing=1.0, handletextpad=0.4)


FIGURES = {drawing.__name__: drawing for drawing in (plane, ranks, curves, trajectories, rates, strips)}


def draw(name: str, subject: Subject) -> Drawn | None:
    """The figure of that name; None where nothing was measured yet that it could show."""
    with rc_context(STYLE):
        return FIGURES[name](subject)


def write_figures(subjects: Sequence[Subject], folder: Path) -> dict[Path, str]:
    """Write the figures as <app>-<name>.png and .pdf.

    Returns:
        What each PNG file shows, in words.
    """
    captions = {}
    for subject in subjects:
        for name in FIGURES:
            if drawn := draw(name, subject):
                stem = f"{name_of(subject.app)} {name}".replace(" ", "-")
                save(drawn.figure, folder / f"{stem}.pdf")
                captions[save(drawn.figure, folder / f"{stem}.png")] = drawn.caption
    return captions
