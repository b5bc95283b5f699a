"""Time and memory of a fit against its size; `make bench-size` runs it.

Ten steps of Adam from a random initialisation run in one thread, each size in a process of its own. Measured are CPU
seconds of the steps, and by how much input, features and steps raise the process's peak memory. Exponents are slopes of
least-squares lines through logarithms: 1 is linear in texels.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from matplotlib import rc_context
from matplotlib.figure import Figure
from torch import Generator

from benchmarks.bench_growth import growth_exponent
from metapp.evaluation.style import FIGURE_STYLE, save_figure
from metapp.learning.app import App, stack_tasks
from metapp.learning.learn import learn, task_loss
from metapp.learning.recipe import Adam
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Task
from metapp.registry import registry

TIMED_STEPS = 10  # gradient steps
SIZE_FIGURE_FILE = Path("runs/bench/size.png")
SIDES_BY_APP = {  # texels along the shorter side
    "texture": (128, 256, 512),
    "svbrdf_stationary": (128, 256, 512),
    "svbrdf_nonstationary": (64, 128, 256, 512),
    "illumination": (32, 64, 128, 256),
}


def app_at_size(name: str, side: int) -> App:
    """Return an application of recipe full with its pictures or maps at another size."""
    app: Any = registry().applications[name].recipes_observing()["full"].load().app
    if name == "illumination":
        field = app.decoder.network._replace(height=side, width=2 * side, rows=side // 4, columns=side // 2)
        app = replace(app, decoder=replace(app.decoder, network=field))
    elif name == "svbrdf_nonstationary":
        field = app.decoder.network._replace(height=side, width=side, rows=side, columns=side)
        app = replace(app, decoder=replace(app.decoder, network=field))
    else:
        # all octaves take part from the first step on, as in the last steps of a fit
        octaves = replace(app.decoder.octaves, height=side, width=side, shares=())
        statistics = replace(app.judge, octaves=octaves)
        decoder, sight = replace(app.decoder, octaves=octaves), replace(app.sight, statistics=statistics)
        app = replace(app, decoder=decoder, sight=sight, judge=statistics)
    result: App = app
    return result


def noise_task(name: str, side: int) -> Task:
    """Make an input of this size from noise: what it shows does not change the cost."""
    rng = Generator().manual_seed(0)

    def uniform(*shape: int) -> Any:
        return torch.rand(*shape, generator=rng)

    photo = (255 * uniform(3, side, side)).to(torch.uint8)
    if name == "illumination":
        photos = (255 * uniform(4, 3, 64, 64)).to(torch.uint8)
        return Task("noise", {"map": uniform(3, side, 2 * side), "photos": photos})
    if name == "svbrdf_nonstationary":
        maps = uniform(10, side, side)
        maps[:3] = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
        return Task("noise", {"photo": photo, "maps": maps})
    return Task("noise", {"image": photo})


def measure_size(name: str, side: int) -> dict[str, float]:
    """Return the CPU seconds of a step and the megabytes of a fit of one size, measured in this process."""
    torch.set_num_threads(1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    app, rng = app_at_size(name, side), Generator().manual_seed(0)
    tasks, loss = stack_tasks(app, [noise_task(name, side)]), task_loss(app, 1)
    theta = app.init(rng, 1)
    app.loss(theta, app.sample(tasks, rng, 1), {})  # computes what is kept for a size, which is not timed
    begin = time.process_time()
    learn(theta, fixed_adam(Adam(1e-3), theta, TIMED_STEPS), tasks, loss, steps=TIMED_STEPS, rng=rng)
    seconds = (time.process_time() - begin) / TIMED_STEPS
    return {"seconds": seconds, "megabytes": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024}


def draw_size_figure(costs_by_app: dict[str, list[dict[str, float]]], file: Path) -> None:
    """Draw time of a step and memory over texels, both logarithmic, with a line per application and a linear one."""
    figure = Figure(figsize=(9, 3.4))
    panels = figure.subplots(1, 2)
    for panel, (key, label) in zip(panels, (("seconds", "seconds a step"), ("megabytes", "MB")), strict=True):
        for name, costs in costs_by_app.items():
            panel.loglog(
                [count_texels(name, side) for side in SIDES_BY_APP[name]],
                [cost[key] for cost in costs],
                "o-",
                label=name,
            )
        counts = [count_texels("texture", side) for side in SIDES_BY_APP["texture"]]
        least = 0.5 * costs_by_app["texture"][0][key]
        panel.loglog(counts, [least * count / counts[0] for count in counts], "k:", label="linear")
        panel.set_xlabel("texels")
        panel.set_ylabel(label)
    panels[0].legend()
    save_figure(figure, file)


def count_texels(name: str, side: int) -> int:
    """Return the number of texels; maps of light are twice as wide as high."""
    return side * side * (2 if name == "illumination" else 1)


def main() -> None:
    """Print the table and draw the figure."""
    costs_by_app = {}
    print("| application | side | ms a step | MB | exponents of time and memory |\n|---|---|---|---|---|")
    for name, sides in SIDES_BY_APP.items():
        costs = []
        for side in sides:
            words = [sys.executable, "-m", "benchmarks.bench_size", name, str(side)]
            run = subprocess.run(words, check=True, capture_output=True, text=True)
            costs.append(json.loads(run.stdout.splitlines()[-1]))
        costs_by_app[name] = costs
        counts = [count_texels(name, side) for side in sides]
        powers = [growth_exponent(counts, [cost[key] for cost in costs]) for key in ("seconds", "megabytes")]
        for side, cost in zip(sides, costs, strict=True):
            exponents = " and ".join(f"{power:.2f}" for power in powers) if side == sides[-1] else ""
            print(
                f"| {name} | {side} | {1e3 * cost['seconds']:.0f} | {cost['megabytes']:.0f} | {exponents} |", flush=True
            )
    SIZE_FIGURE_FILE.parent.mkdir(parents=True, exist_ok=True)
    with rc_context(FIGURE_STYLE):
        draw_size_figure(costs_by_app, SIZE_FIGURE_FILE)
    print(f"{SIZE_FIGURE_FILE}: figure")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(measure_size(sys.argv[1], int(sys.argv[2]))))
    else:
        main()
