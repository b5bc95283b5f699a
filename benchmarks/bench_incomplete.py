"""Errors of fits of few, noisy samples, with grazing angles and without: bench_incomplete.py DATA.

DATA is a set of BRDFs with many samples (`metapp data nbrdf networks/ --out fits`); its test tasks are fitted by the
recipes few and full, and judged on the half of their samples that fits never see. Mean errors x100.
"""

import math
import sys
from pathlib import Path

import torch
from torch import Generator

import metapp
from metapp.appearance.geometry import cosines, rusinkiewicz_to_directions
from metapp.learning.task import Task
from metapp.storage.shards import read_shard

NOISE, STEEPEST = 0.05, 75  # standard deviation of the logarithm; degrees


def error(task: Task, recipe: str, count: int, reach: float) -> float:
    """Of a fit of so many samples within an angle of the normal, in degrees."""
    angles, values = task.data["angles"], task.data["reflectance"]
    half, rng = len(angles) // 2, Generator().manual_seed(count)
    at = cosines(angles)
    within = torch.minimum(at.incident, at.outgoing)[:half] > math.cos(math.radians(reach))
    some = within.nonzero()[:, 0][torch.randperm(int(within.sum()), generator=rng)[:count]]
    noisy = values[some] * torch.exp(NOISE * torch.randn(len(some), 3, generator=rng))
    wi, wo = rusinkiewicz_to_directions(angles)
    fit = metapp.fit("brdf", (wi[some].numpy(), wo[some].numpy(), noisy.numpy()), recipe=recipe)
    predicted = torch.as_tensor(fit(wi[half:].numpy(), wo[half:].numpy()))
    cosine = at.incident[half:, None]
    return 100 * float((torch.log1p(predicted * cosine) - torch.log1p(values[half:] * cosine)).abs().mean())


if __name__ == "__main__":
    tasks = read_shard(Path(sys.argv[1]), "test")
    for reach in (90, STEEPEST):
        for recipe in ("few", "full"):
            means = [sum(error(task, recipe, n, reach) for task in tasks) / len(tasks) for n in (64, 256, 1000)]
            print(f"{reach} degrees, {recipe}:", *(f"{mean:.3f}" for mean in means))
