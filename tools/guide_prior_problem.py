"""The prior of guide caches as a learning problem: one network over the caches of many rooms.

A task is the state of one scene's cache after so many paths. The loss is the variance of paths that are sampled by the
network's densities. It is no application of the command line: `tools/guide_prior.py` trains it by the paradigms.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Generator, Tensor

from metapp.extensions.guided.histogram import BINS, SIDE
from metapp.extensions.guided.prior import FEATURES, NAME, densities, init
from metapp.learning.app import App
from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, Recipe
from metapp.learning.task import Batch, Held, Params, Task, Tasks

LEARNED = MetaTraining(
    steps=600,
    tasks=8,
    rates={"": 3e-4, "alpha.": 1e-2},
    first=Adam(1e-4, beta1=0.7, beta2=0.9),
    warmup=20,
    final=0.05,
    order=1,
    clip=1.0,
    validate_every=100,
    initialisation="encoder",
)
RECIPE = Recipe(
    steps=8,
    batch=48,
    overfit_steps=1000,
    overfit=Adam(3e-3, final=0.0),
    finetune_steps=80,
    finetune=Adam(1e-4, final=0.0),
    quickft=Adam(1e-4, beta1=0.7, beta2=0.9),
    general=OuterLoop(steps=3000, tasks=8, rates={"": 3e-3}, warmup=150, final=0.0, decay=1e-4, validate_every=300),
    meta={"meta-sgd": replace(LEARNED, first=Adam(1e-3)), "meta-encoder": LEARNED},
    rule="meta-encoder",
)


class PriorProblem(App):
    """The state of one scene's cache after so many paths; every row of a tensor is of one entry, N of them.

    `features` are what the network reads; `visible` and `truth`, [N, BINS], the sums of squares of other paths, of a
    few and of many, each row of sum 1.
    """

    name = NAME
    holds = {  # noqa: RUF012  (never written to)
        "features": Held(("N", FEATURES, SIDE, SIDE)),
        "visible": Held(("N", BINS), low=0.0),
        "truth": Held(("N", BINS), low=0.0, optional=True),
    }

    def prepare(self, task: Task) -> dict[str, Tensor]:
        return {key: task.data[key] for key in self.holds if key in task.data}

    def init(self, rng: Generator, count: int) -> Params:
        return _spread(init(rng), count)

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` entries of each task."""
        entries = tasks.data["features"].shape[1]
        drawn = torch.randint(entries, (len(tasks), count), generator=rng, device=rng.device)
        return {key: value[tasks.rows[:, None], drawn].float() for key, value in tasks.data.items()}

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Mean over entries of the logarithm of the variance of a few paths, [T], to a constant."""
        return _variance(theta, batch["features"], batch["visible"]).mean(1)

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The same of many paths."""
        return _variance(theta, batch["features"], batch["truth"]).mean(1)

    def init_encoder(self, rng: Generator) -> Params:
        """The network itself, which all scenes share: its condition is in the features."""
        return init(rng)

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"tasks": tasks.rows}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        return _spread(encoder, len(condition["tasks"]))

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """`error`: the logarithm of the variance, over all entries."""
        rows = {key: tasks.data[key][tasks.rows].float() for key in ("features", "truth")}
        return {"error": _variance(theta, rows["features"], rows["truth"]).mean(1)}


def _spread(theta: Params, count: int) -> Params:
    return {key: value.expand(count, *value.shape) for key, value in theta.items()}


def _variance(theta: Params, features: Tensor, squares: Tensor) -> Tensor:
    """Of tasks [T] and entries [N]: the logarithm of the mean square of what paths carry over their density."""
    sampled = [densities({key: value[i] for key, value in theta.items()}, one) for i, one in enumerate(features)]
    return (squares / torch.stack(sampled)).sum(2).log()


APP = PriorProblem()
