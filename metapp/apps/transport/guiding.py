"""The prior of guided paths as something to be learned: `metapp.rendering.guide_prior` trained over many rooms.

A task is what one scene's cache knew after so many paths. The loss is the variance of paths that are drawn by what the
network makes of it. It is no application of the command line: `tools/guide_prior.py` trains it by the paradigms.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Generator, Tensor

from metapp.learning.app import App
from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, Recipe
from metapp.learning.task import Batch, Held, Params, Task, Tasks
from metapp.rendering.guide_cache import CELLS, SIDE
from metapp.rendering.guide_prior import FEATURES, NAME, densities, init

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


class Guide(App):
    """What one scene's cache knew after so many paths; every row of a tensor is of one place, N of them.

    `features` are what the network reads; `visible` and `truth`, [N, CELLS], the squares that other paths found, a few
    and many, each row of sum 1.
    """

    name = NAME
    holds = {  # noqa: RUF012  (never written to)
        "features": Held(("N", FEATURES, SIDE, SIDE)),
        "visible": Held(("N", CELLS), low=0.0),
        "truth": Held(("N", CELLS), low=0.0, optional=True),
    }

    def prepare(self, task: Task) -> dict[str, Tensor]:
        return {key: task.data[key] for key in self.holds if key in task.data}

    def init(self, rng: Generator, count: int) -> Params:
        return _spread(init(rng), count)

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` places of each task."""
        places = tasks.data["features"].shape[1]
        drawn = torch.randint(places, (len(tasks), count), generator=rng, device=rng.device)
        return {key: value[tasks.rows[:, None], drawn].float() for key, value in tasks.data.items()}

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Mean over places of the logarithm of the variance of a few paths, [T], to a constant."""
        return _variance(theta, batch["features"], batch["visible"]).mean(1)

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The same of many paths."""
        return _variance(theta, batch["features"], batch["truth"]).mean(1)

    def init_encoder(self, rng: Generator) -> Params:
        """The network itself: it reads all that is known of a scene."""
        return init(rng)

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return {"tasks": tasks.rows}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        return _spread(encoder, len(condition["tasks"]))

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """`error`: the logarithm of the variance, over all places."""
        rows = {key: tasks.data[key][tasks.rows].float() for key in ("features", "truth")}
        return {"error": _variance(theta, rows["features"], rows["truth"]).mean(1)}


def _spread(theta: Params, count: int) -> Params:
    return {key: value.expand(count, *value.shape) for key, value in theta.items()}


def _variance(theta: Params, features: Tensor, squares: Tensor) -> Tensor:
    """Of tasks [T] and places [N]: the logarithm of the mean square of what paths carry over their density."""
    made = torch.stack(
        [densities({key: value[i] for key, value in theta.items()}, features[i]) for i in range(len(features))]
    )
    return (squares / made).sum(2).log()


APP = Guide()
