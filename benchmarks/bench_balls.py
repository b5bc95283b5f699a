"""Light from photographs of spheres, judged as DiffusionLight's evaluation does; prints tables as markdown.

`python -m benchmarks.bench_balls MAPS [--balls FOLDER...] [--recipe full]`: MAPS is a folder of HDR maps, each
FOLDER has photographs of one mirror ball named by 1 over their seconds, one of which a fit sees while all are merged
for the truth. General, QuickFT and Meta are by the checkpoints that `metapp ... illumination --observe photo` takes.

Per method: MAE x100 of the second scene; of three spheres under the tone-mapped map si-RMSE and angles in degrees
(`metapp.apps.illumination.spheres`); and of the same spheres under the radiance itself si-RMSE over the root mean
square of the true picture, where lamps and suns count in full. Ratios are those of mean errors, with 95 % intervals by
paired bootstrap over maps. Pictures of all maps and spheres are written to --out.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Generator, Tensor

from benchmarks.ball_tasks import RealBall, glossy_tasks, mirror_tasks, of_middle, real_ball
from data_tools.synthetic.illumination import synthetic_tasks
from metapp.appearance.colour import linear_to_srgb, tone_map
from metapp.appearance.latlong import sphere_normals
from metapp.appearance.metrics import si_rmse
from metapp.apps.illumination.app import READ, Illumination
from metapp.apps.illumination.spheres import SIZE, SPHERES, lit_spheres, toned
from metapp.apps.illumination.variants import of_mean_1
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import Training
from metapp.extensions.baselines.fits import allowed_for
from metapp.learning.app import stack
from metapp.learning.task import Task
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.fits.fitter import fit_tasks
from metapp.runs.outputs.pictures import Column, write_sheet
from metapp.runs.outputs.statistics import Errors, paired
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request
from metapp.runs.surroundings import threads_of
from metapp.runs.torch_state import threads

PARADIGMS = ("general", "quickft", "meta")
OF_MIRRORS = ("unwrap", "gaussian")
CONSTANT = "constant"  # a gray map
TITLES = (
    {"error": "second scene"}
    | {f"{name}_rmse": f"{name} si-RMSE" for name in SPHERES}
    | {f"{name}_angle": f"{name} degrees" for name in SPHERES}
    | {f"{name}_light": f"{name}, radiance" for name in SPHERES}
)
COMPARED = ("error", *(f"{name}_rmse" for name in SPHERES), "diffuse_angle", "diffuse_light")
Answers = dict[str, list[Tensor]]  # maps [1, 3, H, W] of each task, by method
Measured = dict[str, dict[str, Errors]]  # by method, then by measure


class Bench:
    """What fits and judges, at one recipe.

    Attributes:
        plans: of the paradigms, by name.
        app: what judges.
        training: maps that baselines learn from.
    """

    def __init__(self, recipe: str, count: int) -> None:
        requests = (Request("illumination", name, observe="photo", recipe=recipe, quiet=True) for name in PARADIGMS)
        self.plans = {each.paradigm: find_checkpoint(plan(each)) for each in requests}
        app = self.plans["meta"].app
        assert isinstance(app, Illumination)
        self.app = app
        self.training = Training(app, list(synthetic_tasks("train", count, 0)))

    def answers(self, tasks: list[Task], *, mirrors: bool) -> Answers:
        """Maps of all methods."""
        made = {CONSTANT: [torch.ones(1, 3, self.app.field.height, self.app.field.width)] * len(tasks)}
        for name in OF_MIRRORS if mirrors else ():
            made[name] = self._baseline(name, tasks)
        for name, planned in self.plans.items():
            with threads(threads_of(self.app)):
                fits = [fit.theta for fit in fit_tasks(planned, tasks)]
            made[name] = [self._answer(theta, task) for theta, task in zip(fits, tasks, strict=True)]
        return made

    def _answer(self, theta: Mapping[str, Tensor], task: Task) -> Tensor:
        shown = {key: value[None] for key, value in self.app.mirrored(task).items()}
        with torch.no_grad():
            return self.app.answer({key: value[None] for key, value in theta.items()}, shown)

    def _baseline(self, name: str, tasks: list[Task]) -> list[Tensor]:
        baseline = next(each for each in baselines_of(self.app) if each.name == name)
        allowed = allowed_for(self.plans["meta"])
        prepared, rng = baseline.prepare(self.training, allowed), Generator().manual_seed(0)
        answers = [prepared.fit(stack(self.app, [task]), rng, allowed).answer() for task in tasks]
        return [of_mean_1(cast(Tensor, answer)) for answer in answers]

    def errors(self, made: Tensor, task: Task) -> dict[str, float]:
        """Of a map [1, 3, H, W]; those of `Illumination.errors_of`, and of spheres under the radiance itself."""
        stacked = stack(self.app, [task])
        errors = {key: float(value[0]) for key, value in self.app.errors_of(made, stacked).items()}
        errors["error"] *= self.app.traits.scale
        mask = sphere_normals(SIZE)[1]
        for name, pictures in lit_spheres(torch.cat([made, stacked.data["map"]])).items():
            wanted = pictures[1:]
            level = wanted[..., mask].square().sum(1).mean().sqrt()
            errors[f"{name}_light"] = float(si_rmse(pictures[:1], wanted, mask) / level)
        return errors

    def measured(self, answers: Answers, tasks: Sequence[Task]) -> Measured:
        """All errors of all methods."""
        result: Measured = {}
        for method, maps in answers.items():
            by_task = {task.name: self.errors(made, task) for made, task in zip(maps, tasks, strict=True)}
            result[method] = {key: {name: each[key] for name, each in by_task.items()} for key in TITLES}
        return result

    def column(self, answers: Answers, task: Task, number: int) -> Column:
        """The photograph, the true map with its spheres, and those of each method below."""
        photo = task.data["photos"][0].permute(1, 2, 0).numpy().repeat(4, 0).repeat(4, 1) / 255
        truth = stack(self.app, [task]).data["map"]
        pictures = {"photo": photo, "truth": picture(truth)}
        pictures |= {method: picture(maps[number]) for method, maps in answers.items()}
        return Column(pictures, task.name)


def picture(maps: Tensor) -> np.ndarray:
    """Display values of a map [1, 3, H, W], below it its spheres as they are judged, and under its radiance."""
    rows = [tone_map(torch.nn.functional.interpolate(maps, (128, 256), mode="area"))[0]]
    spheres = [linear_to_srgb(lit_spheres(toned(maps))[name][0].clamp(0, 1)) for name in SPHERES]
    rows.append(_beside(spheres))
    rows.append(_beside([tone_map(each[0]) for each in lit_spheres(maps).values()]))
    return torch.cat(rows, 1).permute(1, 2, 0).numpy()


def _beside(pictures: list[Tensor]) -> Tensor:
    return torch.cat([*pictures, torch.zeros(3, SIZE, 256 - SIZE * len(pictures))], 2)


def means(measured: Measured) -> str:
    """A table of mean errors, a row a method."""
    lines = [row("method", *TITLES.values()), row(*["---"] * (1 + len(TITLES)))]
    for method, errors in measured.items():
        values = [statistics.fmean(errors[key].values()) for key in TITLES]
        lines.append(row(method, *(f"{value:.1f}" if value >= 10 else f"{value:.3f}" for value in values)))
    return "\n".join(lines)


def ratios(measured: Measured, pairs: Sequence[tuple[str, str]]) -> str:
    """A table of ratios of mean errors with their intervals, and how often each method is ahead."""
    lines = [row("ratio", *(TITLES[key] for key in COMPARED)), row(*["---"] * (1 + len(COMPARED)))]
    for one, other in pairs:
        found = []
        for key in COMPARED:
            errors = measured[one][key], measured[other][key]
            pair = paired([errors[0]], [errors[1]], {name: name for name in errors[0]}, logarithmic=False)
            found.append(f"{pair}, {pair.ahead}/{pair.tasks}" if pair else "-")
        lines.append(row(f"{one} over {other}", *found))
    return "\n".join(lines)


def row(*cells: str) -> str:
    """A line of a table."""
    return "| " + " | ".join(cells) + " |"


def shown(bench: Bench, name: str, tasks: list[Task], out: Path, *, mirrors: bool) -> Measured:
    """Fit, judge and draw one set of photographs, and print its means."""
    answers = bench.answers(tasks, mirrors=mirrors)
    measured = bench.measured(answers, tasks)
    print(f"\n{name}, {len(tasks)} photographs:\n\n{means(measured)}", flush=True)
    columns = [bench.column(answers, task, number) for number, task in enumerate(tasks)]
    write_sheet(columns, name, out / f"{name.replace(' ', '-')}.png")
    return measured


def exposures_of(measured: Measured, balls: Sequence[RealBall]) -> str:
    """How the three spheres are off by the exposure that fits see, darkest last; means over balls."""
    keys = ("mirror_rmse", "diffuse_rmse", "diffuse_light")
    lines = [row("exposure", *(f"{method}: {', '.join(TITLES[key] for key in keys)}" for method in measured))]
    lines.append(row(*["---"] * (1 + len(measured))))
    for tasks in zip(*(ball.tasks for ball in balls), strict=True):
        names = [task.name for task in tasks]
        cells = []
        for errors in measured.values():
            values = (statistics.fmean(errors[key][name] for name in names) for key in keys)
            cells.append(", ".join(f"{value:.3f}" for value in values))
        lines.append(row(" and ".join(name.split()[-1] for name in names), *cells))
    return "\n".join(lines)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", type=Path, help="a folder of HDR maps")
    parser.add_argument("--balls", type=Path, nargs="*", default=[], help="folders of photographs of a mirror ball")
    parser.add_argument("--recipe", default="full", help="quick or full")
    parser.add_argument("--training", type=int, default=112, help="maps that the Gaussian's light is learned from")
    parser.add_argument("--out", type=Path, default=Path("runs/balls"))
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    bench = Bench(options.recipe, options.training)
    rows = max(READ, bench.app.field.height)
    measured = shown(bench, "maps as mirrors", mirror_tasks(options.maps, rows), options.out, mirrors=True)
    others = [(name, "unwrap") for name in measured if name not in (CONSTANT, "unwrap")]
    print("\n" + ratios(measured, [*others, ("meta", "quickft"), ("meta", "gaussian")]), flush=True)
    measured = shown(bench, "maps as glossy spheres", glossy_tasks(options.maps, rows), options.out, mirrors=False)
    others = [("general", CONSTANT), ("quickft", "general"), ("meta", "general"), ("meta", "quickft")]
    print("\n" + ratios(measured, others), flush=True)
    if not options.balls:
        return
    balls = [real_ball(folder, rows) for folder in options.balls]
    for ball in balls:
        seen = f"{ball.certain:.1%} seen, {ball.clipped:.2%} white in all"
        print(f"\n{ball.name}: {seen}, the rest filled; curve {ball.curve}", flush=True)
    shown(bench, "real balls by the middle exposure", of_middle(balls), options.out, mirrors=True)
    every = [task for ball in balls for task in ball.tasks]
    measured = shown(bench, "real balls by each exposure", every, options.out, mirrors=True)
    print("\n" + exposures_of(measured, balls))


if __name__ == "__main__":
    main()
