"""Figures of a subject's records, and the report, which has them below its tables."""

from __future__ import annotations

import functools
import re
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from metapp.appearance.colour import to_srgb
from metapp.evaluation.rows import errors_of
from metapp.evaluation.style import COLOURS, INK, MUTED, STYLE, Drawn, new, save
from metapp.evaluation.subject import Subject
from metapp.evaluation.table import Table, text_of
from metapp.evaluation.tables.convergence import CURVES, PARTS, parts_of, trace_records
from metapp.learning.task import Params
from metapp.registry import registry
from metapp.rules import rule_of
from metapp.storage.files import write_atomically

MARKERS = {"general": "o", "overfit": "s", "finetune": "D", "quickft": "^", "meta": "*"}
TITLES = {"general": "General", "overfit": "Overfit", "finetune": "Finetune", "quickft": "QuickFT", "meta": "Meta"}
BESIDE = "x"  # marker of other methods
OFFSETS = {"meta": (8, 8), "quickft": (6, -13)}  # points; the two often lie close
PATHS, STRIPS = 3, 4  # tasks
BINS = 48


def _panel(subject: Subject, height: float, x_label: str) -> tuple[Figure, Axes]:
    """A figure of one panel, errors upward."""
    figure, axes = new(4.0, height)
    axis: Axes = axes[0, 0]
    axis.set_title(subject.title)
    axis.set_xlabel(x_label)
    axis.set_ylabel(f"error{subject.app.factor}")
    return figure, axis


def _legend(figure: Figure) -> None:
    """Name the lines of a figure's first axes below it, where the names cover none of them."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), columnspacing=1.0, handletextpad=0.4)


def _lines(subject: Subject, lines: Mapping[str, Mapping[int, float]], x_label: str) -> Figure:
    """Errors of paradigms as lines, on a logarithmic scale if all are positive."""
    figure, axis = _panel(subject, 3.2, x_label)
    for name, line in lines.items():
        size, x, y = 7 if name == "meta" else 4, list(line), list(line.values())
        axis.plot(x, y, color=COLOURS[name], marker=MARKERS[name], markersize=size, label=TITLES[name])
    if min(min(line.values()) for line in lines.values()) > 0:
        axis.set_yscale("log")
    _legend(figure)
    return figure


def plane(subject: Subject) -> Drawn | None:
    """Mean error with its 95 % interval over median seconds; crosses are other methods, best is top right."""
    rows = {row["paradigm"]: row for row in subject.table("results").rows if row["paradigm"] in COLOURS}
    rows = {name: row for name, row in rows.items() if None not in (row["error"], row["seconds"])}
    if not rows:
        return None
    figure, axis = _panel(subject, 3.0, "seconds of inference (faster to the right)")
    axis.set_ylabel(f"{axis.get_ylabel()} (better above)")
    for name, row in rows.items():
        reach = [[row["error"] - row["low"]], [row["high"] - row["error"]]]
        size, place = 12 if name == "meta" else 7, (row["seconds"], row["error"])
        axis.errorbar(*place, yerr=reach, capsize=2, fmt=MARKERS[name], color=COLOURS[name], markersize=size)
        axis.annotate(TITLES[name], place, OFFSETS.get(name, (6, 6)), textcoords="offset points", fontsize=8)
    baselines = [row for name in registry().tables for row in subject.table(name).rows if row.get("baseline")]
    others = [row for row in baselines if None not in (row["error"], row["seconds"])]
    turned: Any = {"rotation": 40, "rotation_mode": "anchor"}  # so that names of neighbours part
    for row in others:
        place = row["seconds"], row["error"]
        axis.plot(*place, BESIDE, color=MUTED, markersize=5)
        axis.annotate(row["paradigm"], place, (2, 3), textcoords="offset points", fontsize=6, color=MUTED, **turned)
    axis.set_xscale("log")
    axis.invert_xaxis()
    axis.invert_yaxis()
    axis.margins(x=0.18, y=0.12)
    named = [*((TITLES[name], row) for name, row in rows.items()), *((row["paradigm"], row) for row in others)]
    figures = ", ".join(f"{name} {row['error']:.3f} in {row['seconds']:.3g} s" for name, row in named)
    return Drawn(figure, f"{subject.title}: mean error over seconds of inference. {figures}.")


def ranks(subject: Subject) -> Drawn | None:
    """Errors of the test tasks, each paradigm's sorted by itself."""
    by_name = {name: sorted(errors_of(subject.records(name)).values()) for name in COLOURS}
    lines = {name: dict(enumerate(errors, 1)) for name, errors in by_name.items() if errors}
    if not lines:
        return None
    figure = _lines(subject, lines, "test task, each paradigm's in order of error")
    figure.axes[0].locator_params("x", integer=True)
    worst = ", ".join(f"{TITLES[name]} {by_name[name][-1]:.3f}" for name in lines)
    return Drawn(figure, f"{subject.title}: errors of all test tasks, sorted. Worst: {worst}.")


def curves(subject: Subject) -> Drawn | None:
    """Mean error over the traced tasks along the steps of each paradigm."""
    records = trace_records(subject)
    if not records or records[0]["curves"]["meta"][0][1] is None:
        return None
    lines = {}
    for name in CURVES:
        along = zip(*(record["curves"][name] for record in records), strict=True)
        lines[name] = {pairs[0][0]: statistics.fmean(error for _, error in pairs) for pairs in along}
    figure = _lines(subject, lines, "gradient steps")
    figure.axes[0].set_xscale("symlog", linthresh=1)
    figure.axes[0].xaxis.set_minor_locator(NullLocator())
    ends = ", ".join(f"{TITLES[name]} {list(line.values())[-1]:.3f}" for name, line in lines.items())
    caption = f"{subject.title}: error along the steps, mean over {len(records)} tasks. In the end: {ends}."
    return Drawn(figure, caption)


def trajectories(subject: Subject) -> Drawn | None:
    """Meta's and Overfit's paths in the plane of most variance of their parameters, a few tasks.

    None if their networks differ, as they do if a rule solves for the last layer.
    """
    records = [record for record in trace_records(subject) if record["paths"]["meta"]][:PATHS]
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
    _legend(figure)
    figure.suptitle(f"{subject.title}: from the initialisation (ring) to the result (star)", fontsize=10)
    tasks = ", ".join(record["name"] for record in records)
    return Drawn(
        figure, f"{subject.title}: paths of Meta and Overfit through parameter space, in two principal axes: {tasks}."
    )


def step_sizes(rule: str, alpha: Params) -> dict[str, np.ndarray]:
    """Step sizes of each parameter tensor, over its entries and all steps; of any sign if the rule is SGD."""
    sizes = {}
    for name, value in alpha.items():
        part, _, key = name.partition(".")
        if part == "rate" and value.numel() > 1:
            pace = alpha.get(f"pace.{key}")
            rate = value if pace is None else value + pace.reshape(-1, *[1] * (value.ndim - 1))
            sizes[key] = (rate if rule_of(rule).has("sgd") else rate.exp()).flatten().double().cpu().numpy()
    return sizes


def rates(subject: Subject) -> Drawn | None:
    """Magnitudes of learned step sizes, layer above layer."""
    fit = subject.runs["meta"]
    alpha, rule = fit.phi.alpha if fit.checkpoint else {}, fit.paradigm.rule_name
    sizes = step_sizes(rule, alpha)
    logs = {key: np.log10(np.abs(values[values != 0])) for key, values in sizes.items() if values.any()}
    if not logs:
        return None
    low, high = (f(f(values) for values in logs.values()) for f in (min, max))
    edges = np.linspace(low - 0.1, high + 0.1, BINS + 1)
    figure, axis = _panel(subject, 0.24 * len(logs) + 1.2, "learned step size, power of ten")
    for i, values in enumerate(logs.values()):
        counts, _ = np.histogram(values, edges)
        heights = -i + 0.9 * counts / counts.max()
        axis.fill_between(edges[:-1], -i, heights, step="post", color=COLOURS["meta"], alpha=0.55, linewidth=0)
        axis.step(edges[:-1], heights, where="post", color=INK, linewidth=0.5)
    axis.set_yticks([-i for i in range(len(logs))], list(logs), fontsize=7)
    axis.set_ylabel("")
    axis.set_title(f"{subject.title}: {rule}")
    negative = np.mean([float((values < 0).mean()) for values in sizes.values()])
    caption = f"{subject.title}: step sizes that {rule} has learned, a row a layer; "
    caption += f"median {10 ** np.median(np.concatenate(list(logs.values()))):.1e}"
    caption += f"; negative: {negative:.0%}" if negative else ""
    weights = [alpha[f"rate.{key}"] for key in sizes if alpha[f"rate.{key}"].ndim > 1]
    if all(len(np.unique(value.flatten(1)[0].numpy())) == 1 for value in weights):
        caption += "; the same for all weights, as its Adam was searched"
    return Drawn(figure, f"{caption}.")


def strips(subject: Subject) -> Drawn | None:
    """A strip a task: initialisation, 25, 50, 75, 100 % of Meta's steps, target."""
    records = {record["name"]: record for record in trace_records(subject)}
    tasks = [task for task in subject.tasks if task.name in records][:STRIPS]
    if not tasks:
        return None
    pictures = []
    for task in tasks:
        shown = [subject.app.preview(theta, task) for theta in parts_of(records[task.name]).values()]
        last = [shown[-1]["reference"]] if "reference" in shown[-1] else []
        pictures.append([to_srgb(picture) for picture in [*(outputs["fit"] for outputs in shown), *last]])
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


FIGURES = {drawing.__name__: drawing for drawing in (plane, ranks, curves, trajectories, rates, strips)}


def draw(name: str, subject: Subject) -> Drawn | None:
    """The figure of that name; None if there is no record for it yet."""
    with rc_context(STYLE):
        return FIGURES[name](subject)


def write_figures(subjects: Sequence[Subject], folder: Path) -> dict[Path, str]:
    """Write the figures as <app>-<name>.png and .pdf.

    Returns:
        The caption of each PNG file.
    """
    captions = {}
    for subject in subjects:
        for name in FIGURES:
            if drawn := draw(name, subject):
                stem = f"{subject.app.full_name} {name}".replace(" ", "-")
                save(drawn.figure, folder / f"{stem}.pdf")
                captions[save(drawn.figure, folder / f"{stem}.png")] = drawn.caption
    return captions


def write_report(subjects: Sequence[Subject], folder: Path, tables: Mapping[str, Sequence[Table]]) -> Path:
    """Write `index.md`: tables of the subjects, by the table's name, then the figures, which lie beside it."""
    parts = ["# Tables and figures"]
    for name, of_subjects in tables.items():
        filled = [table for table in of_subjects if table.rows]
        heading = of_subjects[0].heading if of_subjects else name
        parts += [f"## {heading}", text_of(filled, "markdown") if filled else "Not measured yet."]
    for file, caption in write_figures(subjects, folder).items():
        text = re.sub(r"[\\`*_{}\[\]<>&!#|~$]", r"\\\g<0>", caption)  # names of tasks are no markup
        parts += [f"## {file.stem}", f"![{text}]({file.name})", text]
    content = "\n\n".join(parts) + "\n"
    write = functools.partial(Path.write_text, data=content, encoding="utf-8", errors="backslashreplace")
    write_atomically(folder / "index.md", write)
    return folder / "index.md"
