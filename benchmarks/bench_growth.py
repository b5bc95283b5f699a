"""How time and memory grow with steps, tasks and samples; `make bench-growth` runs it, on Linux.

The BRDF network is fitted by the default rule, meta-curvature, in one thread: 8 tasks in 10 steps of 512 samples. An
outer step of second-order training takes 4 tasks. One of these numbers is changed at a time. Each size is measured in a
forked process of its own: CPU milliseconds, the least of three, and by how much the peak of memory rises, with samples
drawn beforehand. Exponents are slopes of least-squares lines through logarithms: 1 is linear growth. How cost grows
with the size of pictures is measured in `bench_size`.
"""

from __future__ import annotations

import functools
import multiprocessing
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.extensions.native.step_choice import choose_steps
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import DrawnBatch, Loss
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, learn, task_loss
from metapp.learning.task import Batch

GROWTH_APP = Brdf()
GROWTH_RULE = rule_of("meta-curvature")
FIRST_ORDER_STEPS = RECIPES["quick"].meta["meta-curvature"].initial_adam
GROWTH_ROUNDS = 3  # measurements of a cost, of which the least counts


class ProblemSize(NamedTuple):
    """The size of a problem: gradient steps, tasks, and samples of a task a step."""

    steps: int = 10
    tasks: int = 8
    samples: int = 512


STEP_COUNTS, TASK_COUNTS, SAMPLE_COUNTS = (4, 8, 16, 32, 64), (1, 4, 16, 64, 256, 1024), (128, 512, 2048, 8192)
FIT_SIZE, TRAINING_SIZE = ProblemSize(), ProblemSize(tasks=4)
SIZES_BY_ROW: dict[str, list[ProblemSize]] = {
    "fit: steps": [FIT_SIZE._replace(steps=count) for count in STEP_COUNTS],
    "fit: tasks": [FIT_SIZE._replace(tasks=count) for count in TASK_COUNTS],
    "fit: samples": [FIT_SIZE._replace(samples=count) for count in SAMPLE_COUNTS],
    "training: steps": [TRAINING_SIZE._replace(steps=count) for count in STEP_COUNTS],
    "training: tasks": [TRAINING_SIZE._replace(tasks=count) for count in TASK_COUNTS[:5]],
    "training: samples": [TRAINING_SIZE._replace(samples=count) for count in SAMPLE_COUNTS],
}


def draw_batch(size: ProblemSize, rng: Generator) -> Batch:
    """Draw samples of random materials: unit vectors, cosines in (0, 1), targets of another random network."""
    vectors = torch.randn(size.tasks, 2, 3, size.samples, generator=rng)
    where = (vectors / vectors.norm(dim=2, keepdim=True)).flatten(1, 2)
    cosine = torch.rand(size.tasks, 1, size.samples, generator=rng)
    target_theta = GROWTH_APP.init(Generator().manual_seed(1), size.tasks)
    reflectance = GROWTH_APP.network.reflectance(target_theta, where).clamp_min(0)
    return {"where": torch.cat([where, cosine], 1), "target": torch.log1p(reflectance * cosine)}


def make_loss(size: ProblemSize) -> Loss:
    """Make the application's loss on samples that are drawn here, once for all steps."""
    batch = DrawnBatch(tuple(map(str, range(size.tasks))), draw_batch(size, Generator().manual_seed(0)))
    return replace(task_loss(GROWTH_APP, size.samples), draw=lambda data, rng, done: batch)


def adapt(size: ProblemSize, meta_parameters: MetaParameters, loss: Loss) -> None:
    """Fit all tasks from an initialisation by the rule."""
    theta, rng = expand_tasks(meta_parameters.theta, size.tasks, 0), Generator().manual_seed(0)
    learn(
        theta,
        GROWTH_RULE.update_rule(expand_tasks(meta_parameters.alpha, size.tasks, 1)),
        None,
        loss,
        steps=size.steps,
        rng=rng,
        make_steps=choose_steps,
    )


def differentiate_adaptation(size: ProblemSize, meta_parameters: MetaParameters, loss: Loss) -> None:
    """Compute the second-order gradient of an outer training step."""
    phi = {key: value.requires_grad_() for key, value in meta_parameters.flatten().items()}
    outer_loss = after_learning(
        loss, GROWTH_RULE.update_rule, steps=size.steps, order=2, clip=0.1, make_steps=choose_steps
    )
    drawn = outer_loss.draw(None, Generator().manual_seed(0), 1.0)
    torch.autograd.grad(outer_loss.value(phi, drawn.batch, {}).sum(), list(phi.values()), allow_unused=True)


def measure_cost(run: Callable[[ProblemSize, MetaParameters, Loss], None], size: ProblemSize) -> tuple[float, float]:
    """Return the CPU milliseconds and the megabytes that a job of one size takes in this process."""
    meta_parameters, loss = random_meta_parameters(size), make_loss(size)
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak to the memory in use now
    before, seconds = peak_memory_mb(), []
    for _ in range(GROWTH_ROUNDS):
        begin = time.process_time()
        run(size, meta_parameters, loss)
        seconds.append(time.process_time() - begin)
    return 1e3 * min(seconds), peak_memory_mb() - before


def random_meta_parameters(size: ProblemSize) -> MetaParameters:
    """Return a random initialisation and the rule's hyperparameters before any training."""
    theta = {key: value[0] for key, value in GROWTH_APP.init(Generator().manual_seed(0), 1).items()}
    return MetaParameters(theta, GROWTH_RULE.initial_alpha(GROWTH_APP, theta, size.steps, FIRST_ORDER_STEPS))


def peak_memory_mb() -> float:
    """Return the peak of this process's memory, in MB."""
    peak_line = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert peak_line
    return int(peak_line[1]) / 1024


def growth_exponent(sizes: Sequence[int], values: Sequence[float]) -> float:
    """Return the exponent of the power of sizes that values grow with."""
    x, y = (
        torch.tensor(numbers, dtype=torch.float64).log()
        for numbers in (list(sizes), [max(value, 1e-3) for value in values])
    )
    slope: Tensor = ((x - x.mean()) * (y - y.mean())).sum() / (x - x.mean()).square().sum()
    return float(slope)


def format_digits(value: float) -> str:
    """Format a number with two digits or more."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def main() -> None:
    """Print the table as Markdown, row by row."""
    torch.set_num_threads(1)
    adapt(FIT_SIZE, random_meta_parameters(FIT_SIZE), make_loss(FIT_SIZE))  # compiles the steps, once
    print("| what grows | values | ms | MB | exponents of time and memory |\n|---|---|---|---|---|")
    with multiprocessing.get_context("fork").Pool(1, maxtasksperchild=1) as pool:
        for name, sizes in SIZES_BY_ROW.items():
            job, _, growing = name.partition(": ")
            measure = functools.partial(measure_cost, adapt if job == "fit" else differentiate_adaptation)
            costs = [pool.apply(measure, (size,)) for size in sizes]
            numbers = [getattr(size, growing) for size in sizes]
            powers = [growth_exponent(numbers, values) for values in zip(*costs, strict=True)]
            cells = [
                ", ".join(map(str, numbers)),
                *(", ".join(map(format_digits, values)) for values in zip(*costs, strict=True)),
            ]
            print(f"| {name} | {' | '.join(cells)} | {powers[0]:.2f} and {powers[1]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
