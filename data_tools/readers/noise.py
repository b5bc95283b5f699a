"""What measurements have and neural fits of them have not: noise, outliers, few samples, and none at grazing angles."""

from __future__ import annotations

import hashlib
import math

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import cosines
from metapp.appearance.noise import factors
from metapp.learning.task import Task


def as_measured(
    task: Task, noise: float, outliers: float = 0.0, grazing_rad: float = math.pi / 2, samples: int | None = None
) -> Task:
    """A material of which the half that fits may see is as a gonioreflectometer would have it.

    The held-out half stays as it is, so that errors are those of the material, not of the noise. Samples that are
    missing are replaced by others of the visible half, drawn at random. The draws depend on the task's name alone.

    Args:
        task: angles [N, 3] rad and reflectance [N, 3].
        noise: standard deviation of the logarithm of a channel's factor, such as 0.05 for about 5 %.
        outliers: share of samples that are off by half a decade to one, all channels alike.
        grazing_rad: samples are missing whose light or view is further from the normal, in (0, pi / 2].
        samples: how many are measured, at random, at least 1; None: all.

    Raises:
        ValueError: no sample of the visible half is left.
    """
    half = len(task.data["angles"]) // 2
    angles, reflectance = (task.data[key].clone() for key in ("angles", "reflectance"))
    rng = Generator().manual_seed(int.from_bytes(hashlib.sha256(task.name.encode(errors="replace")).digest()[:6]))
    reflectance[:half] *= factors(rng, (half,), noise, outliers)
    rows = _seen(angles[:half], grazing_rad)
    if not len(rows):
        raise ValueError(
            f"{task.name}: no sample within {math.degrees(grazing_rad):g} degrees of the normal, expected some; raise "
            "--grazing."
        )
    if samples is not None:
        rows = rows[torch.randperm(len(rows), generator=rng)[:samples]]
    missing = torch.ones(half, dtype=torch.bool)
    missing[rows] = False
    others = rows[torch.randint(len(rows), (int(missing.sum()),), generator=rng)]
    for data in (angles, reflectance):
        data[:half][missing] = data[others]
    return task._replace(data=task.data | {"angles": angles, "reflectance": reflectance})


def _seen(angles: Tensor, grazing_rad: float) -> Tensor:
    """Rows of angles [N, 3] whose light and view are both within this angle of the normal."""
    found = cosines(angles.double())
    return (torch.minimum(found.incident, found.outgoing) >= math.cos(grazing_rad) - 1e-12).nonzero()[:, 0]
