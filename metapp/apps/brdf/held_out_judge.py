"""The judge of BRDFs: samples that are held out, the second half of each task's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.brdf.brdf_network import BrdfNetwork, ReflectanceFunction, ReflectanceSamples, gather_samples
from metapp.learning.components import Judge
from metapp.learning.task import Task, Tasks


@dataclass(frozen=True)
class HeldOutJudge(Judge[ReflectanceFunction, Any, ReflectanceSamples]):
    """The judge of reflectance at held-out samples."""

    truth_type = sampled_type = ReflectanceSamples
    trains_by_sight = True

    @override
    def prepare(self, task: Task, decoder: BrdfNetwork) -> ReflectanceSamples | None:
        """Return None: the sight prepares the samples of both halves, which augmentation changes together."""
        return None

    @override
    def gather(self, tasks: Tasks) -> ReflectanceSamples:
        """Return the held-out samples, all of them."""
        half = tasks.data["where"].shape[1] // 2
        return ReflectanceSamples(
            *(tasks.data[name][tasks.rows, half:].transpose(1, 2) for name in ReflectanceSamples._fields)
        )

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> ReflectanceSamples:
        """Draw random held-out samples, of which augmentation leaves out no angle."""
        half = tasks.data["where"].shape[1] // 2
        rows = half + torch.randint(half, (len(tasks), count), generator=rng, device=rng.device)
        return gather_samples(tasks, rows)

    @override
    def query(self, answer: ReflectanceFunction, truth: ReflectanceSamples) -> Tensor:
        """Return reflectance [T, 3, M] at the held-out samples, linear RGB in 1/sr, >= 0."""
        return answer(truth.where).clamp_min(0)

    @override
    def errors(self, prediction: Tensor, seen: Any, truth: ReflectanceSamples) -> dict[str, Tensor]:
        """Return `error` [T], the mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)|, of reflectance [T, 3, M]."""
        return {"error": (torch.log1p(prediction * truth.where[:, 6:7]) - truth.target).abs().mean((1, 2))}
