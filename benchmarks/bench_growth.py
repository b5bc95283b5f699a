"""How time and memory grow with steps, tasks and samples; `make bench-growth` runs it, on Linux.

The BRDF network by the default rule, meta-curvature, one thread: a fit of 8 tasks in 10 steps of 512 samples, and an
outer step of second-order training on 4, each with one of these numbers changed. Each is measured in a process of its
own, forked: CPU milliseconds, the least of three, and by how much the peak of memory rises, samples drawn beforehand.
Exponents are the slopes of least squares on logarithms: 1 is linear. How cost grows with the size of pictures is in
`bench_size`.
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
from metapp.extensions.native.step_choice import choose_steps as fastest
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import DrawnBatch, Loss
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, learn, task_loss
from metapp.learning.task import Batch

GROWTH_APP = Brdf()

GROWTH_RULE = rule_of("meta-curvature")
FIRST_ORDER_STEPS = RECIPES["quick"].meta["meta-curvature"].first
GROWTH_ROUNDS = 3


class ProblemSize(NamedTuple):
    """What is measured at."""

    steps: int = 10
    tasks: int = 8
    samples: int = 512


STEP_COUNTS, TASK_COUNTS, SAMPLE_COUNTS = (4, 8, 16, 32, 64), (1, 4, 16, 64, 256, 1024), (128, 512, 2048, 8192)
FIT_SIZE, TRAINING_SIZE = ProblemSize(), ProblemSize(tasks=4)
SIZES_BY_ROW: dict[str, list[ProblemSize]] = {
    "fit: steps": [FIT_SIZE._replace(steps=each) for each in STEP_COUNTS],
    "fit: tasks": [FIT_SIZE._replace(tasks=each) for each in TASK_COUNTS],
    "fit: samples": [FIT_SIZE._replace(samples=each) for each in SAMPLE_COUNTS],
    "training: steps": [TRAINING_SIZE._replace(steps=each) for each in STEP_COUNTS],
    "training: tasks": [TRAINING_SIZE._replace(tasks=each) for each in TASK_COUNTS[:5]],
    "training: samples": [TRAINING_SIZE._replace(samples=each) for each in SAMPLE_COUNTS],
}


def draw_batch(size: ProblemSize, rng: Generator) -> Batch:
    """Samples of random materials: unit vectors, cosines in (0, 1), targets of another random network."""
    vectors = torch.randn(size.tasks, 2, 3, size.samples, generator=rng)
    where = (vectors / vectors.norm(dim=2, keepdim=True)).flatten(1, 2)
    cosine = torch.rand(size.tasks, 1, size.samples, generator=rng)
    other = GROWTH_APP.init(Generator().manual_seed(1), size.tasks)
    reflectance = GROWTH_APP.network.reflectance(other, where).clamp_min(0)
    return {"where": torch.cat([where, cosine], 1), "target": torch.log1p(reflectance * cosine)}


def make_loss(size: ProblemSize) -> Loss:
    """The application's loss on samples that are drawn now, the same at each step."""
    drawn = DrawnBatch(tuple(map(str, range(size.tasks))), draw_batch(size, Generator().manual_seed(0)))
    return replace(task_loss(GROWTH_APP, size.samples), draw=lambda data, rng, done: drawn)


def adapt(size: ProblemSize, start: MetaParameters, loss: Loss) -> None:
    """Descend by the rule."""
    theta, rng = expand_tasks(start.theta, size.tasks, 0), Generator().manual_seed(0)
    learn(
        theta,
        GROWTH_RULE.update_rule(expand_tasks(start.alpha, size.tasks, 1)),
        None,
        loss,
        steps=size.steps,
        rng=rng,
        steps_of=fastest,
    )


def differentiate_adaptation(size: ProblemSize, start: MetaParameters, loss: Loss) -> None:
    """Take the second-order gradient of an outer step."""
    phi = {key: value.requires_grad_() for key, value in start.flatten().items()}
    outer = after_learning(loss, GROWTH_RULE.update_rule, steps=size.steps, order=2, clip=0.1, steps_of=fastest)
    seen = outer.draw(None, Generator().manual_seed(0), 1.0)
    torch.autograd.grad(outer.value(phi, seen.batch, {}).sum(), list(phi.values()), allow_unused=True)


def measure_cost(what: Callable[[ProblemSize, MetaParameters, Loss], None], size: ProblemSize) -> tuple[float, float]:
    """CPU milliseconds and megabytes of one size, in this process."""
    start, loss = random_meta_parameters(size), make_loss(size)
    Path("/proc/self/clear_refs").write_text("5")  # the peak is what is there now
    before, times = peak_memory_mb(), []
    for _ in range(GROWTH_ROUNDS):
        begin = time.process_time()
        what(size, start, loss)
        times.append(time.process_time() - begin)
    return 1e3 * min(times), peak_memory_mb() - before


def random_meta_parameters(size: ProblemSize) -> MetaParameters:
    """A random initialisation and the rule before any training."""
    theta = {key: value[0] for key, value in GROWTH_APP.init(Generator().manual_seed(0), 1).items()}
    return MetaParameters(theta, GROWTH_RULE.initial_alpha(GROWTH_APP, theta, size.steps, FIRST_ORDER_STEPS))


def peak_memory_mb() -> float:
    """The peak of this process's memory, MB."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found
    return int(found[1]) / 1024


def growth_exponent(sizes: Sequence[int], values: Sequence[float]) -> float:
    """Of the power of sizes that values grow with."""
    x, y = (torch.tensor(each, dtype=torch.float64).log() for each in (list(sizes), [max(v, 1e-3) for v in values]))
    slope: Tensor = ((x - x.mean()) * (y - y.mean())).sum() / (x - x.mean()).square().sum()
    return float(slope)


def format_digits(value: float) -> str:
    """Two digits or more."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    adapt(FIT_SIZE, random_meta_parameters(FIT_SIZE), make_loss(FIT_SIZE))  # compiles the steps, once
    print("| what grows | values | ms | MB | exponents of time and memory |\n|---|---|---|---|---|")
    with multiprocessing.get_context("fork").Pool(1, maxtasksperchild=1) as pool:
        for name, sizes in SIZES_BY_ROW.items():
            what, _, grows = name.partition(": ")
            each = functools.partial(measure_cost, adapt if what == "fit" else differentiate_adaptation)
            found = [pool.apply(each, (size,)) for size in sizes]
            numbers = [getattr(size, grows) for size in sizes]
            powers = [growth_exponent(numbers, values) for values in zip(*found, strict=True)]
            shown = [
                ", ".join(map(str, numbers)),
                *(", ".join(map(format_digits, each)) for each in zip(*found, strict=True)),
            ]
            print(f"| {name} | {' | '.join(shown)} | {powers[0]:.2f} and {powers[1]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
