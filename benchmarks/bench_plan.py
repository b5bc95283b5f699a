"""Errors of BRDF fits against the number of samples, random ones and planned ones; `make bench-plan DATA=fits` runs it.

Every way gets the directions that it asks for: fits by `few` those of `metapp plan`, components those of the least
condition number (Nielsen et al. 2015), and of the least expected error as well. A second argument is the noise, such as
0.05. A third one is the folder of NBRDF networks that the data set was made of: then planned directions are measured
exactly; else at the nearest samples of the table, as components must. Test materials, held-out samples and penalties
are those of `bench_samples`.
"""

from __future__ import annotations

import functools
import hashlib
import math
import statistics
import sys
from pathlib import Path
from typing import NamedTuple

import torch
from matplotlib import rc_context
from torch import Generator, Tensor

from benchmarks import bench_samples
from benchmarks.bench_samples import Errors, Way, errors_of, figure, ratios
from benchmarks.measured import as_measured
from data_tools.readers.nbrdf import read_nbrdf
from metapp.appearance.geometry import directions_to_full_circle, outgoing_cosine
from metapp.apps.brdf.app import Brdf
from metapp.cli.console import run
from metapp.evaluation.style import COLOURS, MUTED, STYLE
from metapp.extensions.baselines.baseline import Training
from metapp.extensions.baselines.brdf import Space, _space
from metapp.extensions.baselines.components import EPSILON
from metapp.extensions.baselines.fits import training_of
from metapp.extensions.few.design import Limits, places_of
from metapp.extensions.few.noise import factors
from metapp.extensions.few.planning import plan_brdf
from metapp.learning.task import Task
from metapp.runs.inputs.sources import data_folder, tasks_of_data
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request

COUNTS = (4, 8, 16, 32, 64)
CANDIDATES = 2048
FIGURE = Path("runs/bench/plan.png")
LIMITS = Limits()


class Line(NamedTuple):
    """A way to fit, and the directions that it gets: "random", "plan", "condition" or "expected"."""

    way: Way
    directions: str


def _lines() -> list[Line]:
    few, pca = COLOURS["meta"], COLOURS["finetune"]
    lines = [
        Line(Way("few, planned", "meta", "few", few), "plan"),
        Line(Way("few, random", "meta", "few", few, ":"), "random"),
        Line(Way("ridge, random", "meta", "full", COLOURS["quickft"], ":"), "random"),
        Line(Way("General's encoder, random", "general", "quick", COLOURS["general"], ":"), "random"),
        Line(Way("two GGX lobes, random", "ggx_2", "", MUTED, ":"), "random"),
    ]
    for name, colour in (("pca_20", "#99c7e0"), ("pca_66", pca), ("pca_150", COLOURS["overfit"])):
        for directions, dashes in (("random", ":"), ("condition", "--"), ("expected", "-")):
            lines.append(Line(Way(f"{name}, {directions}", name, "", colour, dashes), directions))
    return lines


def allowed_rows(where: Tensor) -> Tensor:
    """Rows of the visible half of places [N, 7] that an instrument can measure, CANDIDATES of them at random."""
    half = len(where) // 2
    cosines = torch.minimum(where[:half, 6], outgoing_cosine(where[None, :half].transpose(1, 2))[0])
    apart = torch.acos(where[:half, 5].clamp(-1, 1)) * 2 >= LIMITS.apart_rad
    rows = ((cosines >= math.cos(LIMITS.grazing_rad)) & apart).nonzero()[:, 0]
    return rows[torch.randperm(len(rows), generator=Generator().manual_seed(0))[:CANDIDATES]]


def least_condition(space: Space, kept: int, count: int) -> Tensor:
    """Rows, one after the other, whose matrix of components, scaled by deviation, has the least condition number."""
    rows = allowed_rows(space.where)
    used = space.components.first(kept)
    matrix = (used.axes[rows] * used.deviation).double()
    chosen: list[int] = []
    for number in range(count):
        columns = min(number + 1, matrix.shape[1])
        tried = torch.stack([torch.cat([matrix[chosen], row[None]]) for row in matrix])[..., :columns]
        values = torch.linalg.svdvals(tried)
        chosen.append(int((values[:, 0] / values[:, -1].clamp_min(1e-300)).argmin()))
    return rows[chosen]


def least_error(space: Space, kept: int, count: int, noise: float = 1e-2) -> Tensor:
    """Rows after which the expected error is least, one after the other, as `metapp plan` begins."""
    rows = allowed_rows(space.where)
    used, relative = space.components.first(kept), space.relative
    axes = (used.axes * used.deviation).double()
    cos = space.where[:, 6:].double()
    slope = cos * (relative.reference + EPSILON / relative.weight) / (1 + relative.reference * cos)
    goal = (axes * slope)[len(axes) // 2 :: 8]
    covariance, total = torch.eye(axes.shape[1]).double(), goal.T @ goal
    chosen: list[int] = []
    for _ in range(count):
        mapped = axes[rows] @ covariance
        spread = noise + (mapped * axes[rows]).sum(1)
        chosen.append(int((((mapped @ total) * mapped).sum(1) / spread).argmax()))
        column = mapped[chosen[-1]]
        covariance = covariance - torch.outer(column, column) / spread[chosen[-1]]
    return rows[chosen]


@functools.cache
def planned(count: int) -> Tensor:
    """The angles [count, 3] in rad of `metapp plan brdf`."""
    found = plan_brdf(count, LIMITS)
    return directions_to_full_circle(found.wi, found.wo).float()


def planned_rows(where: Tensor, count: int) -> Tensor:
    """Rows of the visible half of places [N, 7] next to the directions of `metapp plan brdf`."""
    wanted = places_of(planned(count))[0].T
    return torch.cdist(wanted[:, :6], where[: len(where) // 2, :6]).argmin(1)


def measured(task: Task, folder: Path, count: int, noise: float) -> Task:
    """A material of which fits see what its NBRDF network has at the directions of `metapp plan brdf`."""
    angles = planned(count)
    parts = {part: torch.from_numpy(array) for part, array in read_nbrdf(folder / task.name).items()}
    theta = {f"w{layer}": parts[f"fc{layer}"].T for layer in (1, 2, 3)}
    theta |= {f"b{layer}": parts[f"b{layer}"][:, None] for layer in (1, 2, 3)}
    rng = Generator().manual_seed(int.from_bytes(hashlib.sha256(task.name.encode()).digest()[:6]))
    reflectance = Brdf().reflectance(theta, angles) * factors(rng, (count,), noise, 0.0)
    half = len(task.data["angles"]) // 2
    stand = torch.arange(half) % count
    data = {"angles": torch.cat([angles[stand], task.data["angles"][half:]])}
    data["reflectance"] = torch.cat([reflectance[stand], task.data["reflectance"][half:]])
    return task._replace(data=task.data | data)


def cut(task: Task, rows: Tensor, noise: float) -> Task:
    """A material of which fits see these samples alone, with noise."""
    noisy = as_measured(task, noise).data
    half = len(noisy["angles"]) // 2
    stand = rows[torch.arange(half) % len(rows)]
    data = {key: torch.cat([noisy[key][stand], noisy[key][half:]]) for key in ("angles", "reflectance")}
    return task._replace(data=task.data | data)


def main() -> None:
    """Print the table, draw the figure."""
    torch.set_num_threads(1)
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    noise = float(sys.argv[2]) if len(sys.argv) > 2 else 0.0
    networks = Path(sys.argv[3]) if len(sys.argv) > 3 else None
    app = plan(Request("brdf", "general", recipe="quick")).app
    tasks, label = tasks_of_data(app, data, quiet=True)
    training = training_of(app, data_folder(app, data, quiet=True))
    where = Brdf().prepare(tasks[0])["where"]
    print(f"{label}: {len(tasks)} test materials, {len(training.tasks)} for components, noise {noise:g}; errors x100\n")
    head = f"| method | {' | '.join(f'{count:,}' for count in COUNTS)} |\n|{'---|' * (len(COUNTS) + 1)}"
    print(head)
    found: dict[Line, list[Errors]] = {}
    for line in _lines():
        found[line] = []
        for count in COUNTS:
            if line.directions == "plan" and networks:
                few = [measured(task, networks, count, noise) for task in tasks]
            else:
                few = [cut_for(line, task, where, count, noise, training) for task in tasks]
            found[line].append(finite(line, few, data, count, training))
        means = [statistics.fmean(errors.values()) for errors in found[line]]
        print(f"| {line.way.title} | {' | '.join(f'{error:.3f}' for error in means)} |", flush=True)
    first = next(iter(found))
    print(f"\n{first.way.title} over others, 95 % interval, tasks with the lower error of all:\n\n{head}")
    for line in found:
        if line != first:
            print(f"| {line.way.title} | {' | '.join(ratios(found[first], found[line]))} |")
    drawn = {line.way: [statistics.fmean(e.values()) for e in errors] for line, errors in found.items()}
    bench_samples.COUNTS = COUNTS
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    with rc_context(STYLE):
        figure({way: errors for way, errors in drawn.items() if all(map(math.isfinite, errors))}, FIGURE)
    print(f"\n{FIGURE}: figure")


def finite(line: Line, few: list[Task], data: Path | None, count: int, training: Training) -> Errors:
    """Errors, infinite where a fit overflows, as encoders do of samples such as they never saw."""
    try:
        return errors_of(line.way, few, data, count, training)
    except FloatingPointError:
        return {task.name: math.inf for task in few}


def cut_for(line: Line, task: Task, where: Tensor, count: int, noise: float, training: Training) -> Task:
    """A material cut down to the directions that a way asks for."""
    if line.directions == "random":
        return as_measured(task, noise, samples=count)
    return cut(task, rows_for(line, where, count, training), noise)


def rows_for(line: Line, where: Tensor, count: int, training: Training) -> Tensor:
    """Which rows a way asks for."""
    key = (line.directions, line.way.name, count)
    if key not in _ROWS:
        kept = int(line.way.name.removeprefix("pca_").rstrip("w")) if line.way.name.startswith("pca") else 0
        if line.directions == "plan":
            _ROWS[key] = planned_rows(where, count)
        else:
            choose = least_condition if line.directions == "condition" else least_error
            _ROWS[key] = choose(_space(training, whole=True), kept, count)
    return _ROWS[key]


_ROWS: dict[tuple[str, str, int], Tensor] = {}


if __name__ == "__main__":
    sys.exit(run(main))
