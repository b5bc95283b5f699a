"""How sure fits of photographs of light are, against how far they are off; prints a table as markdown.

`python -m benchmarks.bench_confidence [MAPS] [--recipe quick]`: of drawn maps that nothing was trained on, and of
MAPS, a folder of HDR maps, photographed as diffuse to glossy spheres and as mirrors, by General, QuickFT and Meta.

Shares of the sphere that are off by less than the 50 and 90 % quantiles, means over fits, with 95 % intervals by
bootstrap over maps; and the factors that records state of front, rim and back.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Generator, Tensor

from benchmarks.ball_tasks import glossy_tasks, mirror_tasks
from benchmarks.bench_balls import PARADIGMS, row
from data_tools.synthetic.illumination import synthetic_tasks
from metapp.appearance.photograph import photograph
from metapp.apps.illumination.app import READ, Illumination
from metapp.apps.illumination.confidence import covered, deviations, off_by
from metapp.apps.illumination.mirror import photographed
from metapp.learning.app import stack
from metapp.learning.task import Task
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.fits.fitter import fit_tasks
from metapp.runs.requests.plan import Plan, plan
from metapp.runs.requests.request import Request

SHARES = (0.5, 0.9)
PARTS = ("front", "rim", "back")
SEED, BOOTSTRAPS = 71, 5000


def as_spheres(tasks: Sequence[Task], many: int) -> list[Task]:
    """Each map in so many photographs of spheres of other materials, which are one group."""
    rng, made = Generator().manual_seed(SEED), []
    for task in tasks:
        photos = photograph(task.data["map"].expand(many, -1, -1, -1), rng)
        for number, photo in enumerate((photos * 255).round().to(torch.uint8)):
            made.append(Task(f"{task.name} {number}", {"map": task.data["map"], "photos": photo[None]}, task.name))
    return made


def as_mirrors(tasks: Sequence[Task]) -> list[Task]:
    """Each map in a photograph of a mirror by a camera of a curve of its own, which is read by sRGB's."""
    maps = torch.stack([task.data["map"] for task in tasks])
    photos, shown = photographed(maps, Generator().manual_seed(SEED), 64)
    photos, made = (photos * 255).round().to(torch.uint8), []
    for number, task in enumerate(tasks):
        held = {"map": task.data["map"], "photos": photos[number : number + 1]}
        made.append(Task(task.name, held | {key: value[number] for key, value in shown.items()}))
    return made


def judged(planned: Plan, tasks: Sequence[Task]) -> tuple[Tensor, list[dict[str, float]]]:
    """Of fits of tasks the shares that are covered, [N, len(SHARES)], and the factors that records state."""
    app = planned.app
    assert isinstance(app, Illumination)
    shares, stated = [], []
    for task, fit in zip(tasks, fit_tasks(planned, tasks), strict=True):
        data, theta = stack(app, [task]).data, {key: value[None] for key, value in fit.theta.items()}
        with torch.no_grad():
            spread = app.spread(theta, data)
            off = off_by(app.answer(theta, data), data["map"])
        shares.append(torch.cat([covered(spread, off, share) for share in SHARES]))
        stated += deviations(spread, data)
    return torch.stack(shares), stated


def interval(shares: Tensor, tasks: Sequence[Task]) -> list[str]:
    """Means of [N, K] with intervals, percent; photographs of one map are drawn together."""
    groups = [task.group or task.name for task in tasks]
    means = torch.stack([shares[[each == name for each in groups]].mean(0) for name in dict.fromkeys(groups)])
    drawn = torch.randint(len(means), (BOOTSTRAPS, len(means)), generator=Generator().manual_seed(0))
    low, high = means[drawn].mean(1).quantile(torch.tensor([0.025, 0.975]), 0)
    return [f"{100 * m:.0f} [{100 * a:.0f}, {100 * b:.0f}]" for m, a, b in zip(means.mean(0), low, high, strict=True)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", type=Path, nargs="?", help="a folder of HDR maps")
    parser.add_argument("--recipe", default="quick", help="quick or full")
    parser.add_argument("--drawn", type=int, default=48, help="drawn maps")
    parser.add_argument("--photos", type=int, default=4, help="of each real map as a sphere")
    options = parser.parse_args()
    torch.set_num_threads(1)
    requests = (Request("illumination", each, observe="photo", recipe=options.recipe, quiet=True) for each in PARADIGMS)
    plans = [find_checkpoint(plan(each)) for each in requests]
    app = plans[0].app
    assert isinstance(app, Illumination)
    rows = max(READ, app.field.height)
    drawn = list(synthetic_tasks("test", options.drawn, SEED, rows))
    sets = {"drawn, spheres": drawn, "drawn, mirrors": as_mirrors(drawn)}
    if options.maps:
        sets["real, spheres"] = as_spheres(glossy_tasks(options.maps, rows), options.photos)
        sets["real, mirrors"] = mirror_tasks(options.maps, rows)
    print(row("photographs", "fits", "50 %", "90 %", *PARTS))
    print(row(*["---"] * (4 + len(PARTS))))
    for name, tasks in sets.items():
        for planned in plans:
            shares, stated = judged(planned, tasks)
            factors = [f"{statistics.median(each[part] for each in stated):.2f}x" for part in PARTS]
            print(row(name, planned.paradigm.name, *interval(shares, tasks), *factors), flush=True)


if __name__ == "__main__":
    main()
