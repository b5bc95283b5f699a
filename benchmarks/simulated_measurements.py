"""BRDF tasks as a gonioreflectometer would have measured them: few samples, and noisy ones."""

from __future__ import annotations

import hashlib

import torch
from torch import Generator

from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Task


def simulate_measurement(task: Task, noise: float, samples: int | None = None) -> Task:
    """A material of which the half that fits may see is as a gonioreflectometer would have it.

    The held-out half stays as it is, so that errors are those of the material, not of the noise. Samples that are
    missing are replaced by others of the visible half, drawn at random. The draws depend on the task's name alone.

    Args:
        task: angles [N, 3] rad and reflectance [N, 3].
        noise: standard deviation of the logarithm of a channel's factor, such as 0.05 for about 5 %.
        samples: how many are measured, at random, at least 1; None: all.
    """
    half = len(task.data["angles"]) // 2
    data = {key: task.data[key].clone() for key in ("angles", "phi_h", "reflectance") if key in task.data}
    rng = Generator().manual_seed(int.from_bytes(hashlib.sha256(task.name.encode(errors="replace")).digest()[:6]))
    data["reflectance"][:half] *= torch.exp(noise * draw_normal(rng, half, 3))
    if samples is not None:
        rows = torch.randperm(half, generator=rng)[:samples]
        missing = torch.ones(half, dtype=torch.bool)
        missing[rows] = False
        others = rows[torch.randint(len(rows), (int(missing.sum()),), generator=rng)]
        for column in data.values():
            column[:half][missing] = column[others]
    return task._replace(data=task.data | data)
