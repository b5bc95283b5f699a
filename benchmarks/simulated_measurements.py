"""BRDF tasks as a gonioreflectometer would have measured them: with few samples, or noisy ones.

The half of a task's samples that errors are computed on stays as it is.
"""

from __future__ import annotations

import hashlib

import torch
from torch import Generator

from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Task


def simulate_measurement(task: Task, noise: float, samples: int | None = None) -> Task:
    """Return a material whose visible half of samples is as a gonioreflectometer would have measured it.

    The held-out half stays as it is, so that errors are errors of the material, not of the noise. Samples that were not
    measured are replaced by others of the visible half, drawn at random. The draws depend on the task's name alone.

    Args:
        task: a task with angles [N, 3] in rad and reflectance [N, 3] in 1/sr.
        noise: the standard deviation of the logarithm of a channel's factor, such as 0.05 for about 5 %.
        samples: how many samples are measured, at random, at least 1; None for all.
    """
    visible_count = len(task.data["angles"]) // 2
    data = {key: task.data[key].clone() for key in ("angles", "phi_h", "reflectance") if key in task.data}
    rng = Generator().manual_seed(int.from_bytes(hashlib.sha256(task.name.encode(errors="replace")).digest()[:6]))
    data["reflectance"][:visible_count] *= torch.exp(noise * draw_normal(rng, visible_count, 3))
    if samples is not None:
        measured_rows = torch.randperm(visible_count, generator=rng)[:samples]
        missing = torch.ones(visible_count, dtype=torch.bool)
        missing[measured_rows] = False
        replacements = measured_rows[torch.randint(len(measured_rows), (int(missing.sum()),), generator=rng)]
        for column in data.values():
            column[:visible_count][missing] = column[replacements]
    return task._replace(data=task.data | data)
