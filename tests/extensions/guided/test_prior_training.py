"""The prior of guide caches as a learning problem, and its tasks, made of random rooms."""

from __future__ import annotations

import math

import pytest
import torch

from metapp.extensions.guided.histogram import BINS
from metapp.extensions.guided.prior_training import APP
from metapp.learning.app import stack
from metapp.learning.task import Task, problems_of
from tests.needs_mitsuba import needs_mitsuba


@needs_mitsuba
def test_tasks_of_guide_priors_hold_what_they_must(monkeypatch: pytest.MonkeyPatch) -> None:
    from metapp.extensions.guided.prior_tasks import NAMES, guide_tasks

    monkeypatch.setattr("metapp.extensions.guided.prior_tasks.PARTS", ((4,), (4,), (4,), (8,), (8,)))
    tasks = guide_tasks("board", 1)
    assert [task.name for task in tasks] == [f"board-1-{name}" for name in NAMES]
    assert not [problem for task in tasks for problem in problems_of(task, APP.holds)]
    for task in tasks:
        for key in ("visible", "truth"):
            torch.testing.assert_close(task.data[key].sum(1), torch.ones(len(task.data[key])))


def test_even_densities_have_the_loss_of_chance() -> None:
    """Whatever paths found: the mean of squares over an even density is their sum times the number of bins."""
    squares = torch.rand(6, BINS)
    squares /= squares.sum(1, keepdim=True)
    task = Task("a", {"features": torch.randn(6, 8, 16, 16), "visible": squares, "truth": squares.flip(0)})
    tasks = stack(APP, [task, task])
    rng = torch.Generator().manual_seed(0)
    theta = {key: torch.zeros_like(value) for key, value in APP.init(rng, 2).items()}
    batch = APP.sample(tasks, rng, 4)
    even = torch.full((2,), math.log(BINS))
    torch.testing.assert_close(APP.loss(theta, batch, {}), even)
    torch.testing.assert_close(APP.outer_loss(theta, batch, {}), even)
    torch.testing.assert_close(APP.errors(theta, tasks)["error"], even)
