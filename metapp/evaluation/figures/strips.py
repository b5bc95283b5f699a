"""Convergence strips: pictures of a fit at its initialisation, along its steps and at the end, beside the target."""

from __future__ import annotations

from metapp.evaluation.figures import Drawn
from metapp.evaluation.figures.style import new
from metapp.evaluation.subject import Subject
from metapp.evaluation.trace import PARTS, parts_of, trace_cell
from metapp.runs.pictures import to_srgb

SHOWN = 4  # tasks


def strips(subject: Subject) -> Drawn | None:
    """A strip a task: initialisation, 25, 50, 75, 100 % of Meta's steps, target."""
    cell = trace_cell(subject)
    finished = {record["name"] for record in cell.records()}
    tasks = [task for task in cell.tasks if task.name in finished][:SHOWN]
    if not tasks:
        return None
    pictures = []
    for task in tasks:
        made = [subject.presentation.outputs(theta, task) for theta in parts_of(cell, task).values()]
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
