"""BRDFs on half and difference vectors (paper section 4.1.2): the NBRDF network, or one of learned features."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import half_difference
from metapp.apps.brdf import nbrdf, nbrdf_in_c
from metapp.apps.brdf.featured import OWN, Featured, features_of, folded, reflectance_of
from metapp.apps.brdf.variants import measured, mixed
from metapp.engine import register
from metapp.learning.app import App
from metapp.learning.recipe import Adam, Guard, MetaTraining, OuterLoop, Recipe
from metapp.learning.task import Batch, Held, Linear, Params, Task, Tasks

CONDITION = 1024  # samples that General's encoder reads
KNOTS = 8
# Each task's gradient is scaled to about the same norm before the mean is taken: meta-gradients are heavy-tailed, and a
# clip of 0.004 gave two thirds of the error that a clip of 1 gave on validation materials.
LEARNED = MetaTraining(
    steps=20_000,
    tasks=4,
    rates={"": 1e-3, "alpha.": 1e-2, "alpha.left": 1e-3, "alpha.right": 1e-3},
    warmup=200,
    final=0.01,
    order=2,
    clip=4e-3,
)
# with another network: features for all materials, of which each is a linear combination
RIDGE = MetaTraining(
    steps=10_000,
    tasks=4,
    rates={"": 2e-3, "alpha.": 1e-2},
    warmup=200,
    final=0.01,
    order=2,
    clip=1e-2,
    validate_every=500,
    start="untrained",
    setup=Featured(),
)
# doubtful: what ends at twice the share of its initialisation's loss that any validation material does
GUARD = Guard(Adam(1e-2, beta1=0.5, beta2=0.9, final=0.1), fall=0.13)

QUICK = Recipe(
    steps=10,
    batch=512,
    overfit_steps=20_000,
    overfit=Adam(1e-2, final=0.0),
    finetune_steps=2_000,
    finetune=Adam(4e-3, final=0.0),
    quickft=Adam(5e-3, final=0.1),
    general=OuterLoop(steps=12_000, tasks=8, rates={"": 1e-3}, warmup=200, final=0.0, validate_every=500),
    meta={
        # from one initialisation for all materials ten signed gradients have too far to go
        "meta-sgd": replace(
            LEARNED,
            steps=10_000,
            first=Adam(0.1),
            rates={"": 3e-3, "encoder.": 3e-4},
            start="encoder",
            augment=False,
        ),
        "meta-adam": replace(LEARNED, guard=replace(GUARD, fall=0.25)),
        "meta-curvature": replace(LEARNED, guard=GUARD),
        "ridge": RIDGE,
    },
    rule="meta-curvature",
)

# where paradigms need not fit the same network, the rule that is best on validation tasks
FULL = replace(QUICK, rule="ridge")
# for samples that are noisy, or that lack grazing angles, as those of a gonioreflectometer
MEASURED = replace(FULL, meta={"ridge": replace(RIDGE, setup=Featured(measured=True))})

# Fischer & Ritschel 2022, section 4.1.2 and supplement: 10 inner steps of 512 samples, MAML with Meta-SGD from
# alpha = 1e-3, outer Adam at 1e-4 with weight decay 1e-6, a random start
PAPER = replace(
    QUICK,
    quickft=Adam(5e-3),
    meta={
        "meta-sgd": MetaTraining(
            steps=100_000,
            tasks=1,
            rates={"": 1e-4},
            first=Adam(1e-3),
            decay=1e-6,
            order=2,
            clip=10.0,
            augment=False,
            start="random",
        )
    },
    rule="meta-sgd",
)


class Brdf(App):
    """One measured or modelled isotropic material a task."""

    name = "brdf"
    holds = {  # noqa: RUF012  (never written to)
        "angles": Held(("N", 3), low=0.0, high=2 * math.pi),
        "reflectance": Held(("N", 3), low=0.0),
        "render": Held(("H", "W", 4)),
        "environment": Held(("h", "w", 4), optional=True),
    }
    scale = 100.0
    single_threaded = True
    compiles = True
    cheap_fits = True
    recipes = {  # noqa: RUF012  (never written to)
        "paper": PAPER,
        "quick": QUICK,
        "full": FULL,
        "measured": MEASURED,
    }

    def __init__(self, setup: Featured | None = None) -> None:
        self.setup = setup
        if setup:
            self.solves, self.own = "last", OWN

    def at(self, recipe: Recipe, protocol: str = "") -> Brdf:
        """The application with a recipe's network: a `Featured` one, or None for the NBRDF network."""
        return self if recipe.setup == self.setup else Brdf(recipe.setup)

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`where` [N, 7]: half and difference vector, cos theta_i; `target` [N, 3]: log(1 + f cos theta_i)."""
        where = _where(task.data["angles"])
        return {"where": where.float(), "target": torch.log1p(task.data["reflectance"] * where[:, 6:]).float()}

    def init(self, rng: Generator, count: int) -> Params:
        return self.setup.init(rng, count) if self.setup else nbrdf.init(rng, count)

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`where` [T, 7, count] and `target` [T, 3, count] from the first half of the samples."""
        return self._drawn(tasks, rng, count, 0)

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """From the half that fits do not see, which is without noise and complete."""
        return self._drawn(tasks, rng, count, tasks.data["where"].shape[1] // 2)

    def _drawn(self, tasks: Tasks, rng: Generator, count: int, first: int) -> Batch:
        half = tasks.data["where"].shape[1] // 2
        rows = first + torch.randint(half, (len(tasks), count), generator=rng, device=rng.device)
        picked = (tasks.rows[:, None], rows)
        return {key: tasks.data[key][picked].transpose(1, 2).contiguous() for key in ("where", "target")}

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)|, [T].

        A learned `smoothing` s [T] replaces |d| by sqrt(d^2 + s^2) - s, whose curvature at sign changes autodiff sees;
        learned `weights` [T, 8] are log weights of samples at knots over theta_h.
        """
        where = batch["where"]
        # without the clamp at 0 a network that is too dark still has a gradient; the clamp only ever helps
        d = torch.log1p(network(theta, where) * where[:, 6:7]) - batch["target"]
        if not learned:
            return d.abs().mean((1, 2))
        s = torch.exp(learned["smoothing"])[:, None, None]
        norm = ((d * d + s * s).sqrt() - s).mean(1)
        return (norm * _weights(where, learned) if "weights" in learned else norm).mean(1)

    def linear(self, theta: Params, batch: Batch, learned: Params) -> Linear:
        """Least squares in log(1 + f), weighted so that it follows the loss (iteratively reweighted least squares)."""
        where, target = batch["where"], batch["target"]
        cos = where[:, 6:7]
        features = features_of(theta, where)
        residual = torch.log1p(torch.expm1(target) / cos.clamp_min(1e-4)) - torch.bmm(theta["last"], features)
        # the derivative of log(1 + f cos theta_i) in log(1 + f)
        slope = 1 - (1 - cos) * torch.exp(-target)
        d = slope * residual
        s = torch.exp(learned["smoothing"])[:, None]
        weights = slope.square().mean(1) / (d.square().mean(1) + s * s).sqrt()
        return Linear("last", features, residual, weights, d.abs().mean((1, 2)))

    def loss_parameters(self, steps: int) -> Params:
        """Smoothing, and for the NBRDF network weights of samples."""
        weights = {} if self.setup else {"weights": torch.zeros(steps, KNOTS)}
        return {"smoothing": torch.full((steps,), math.log(0.05))} | weights

    def init_encoder(self, rng: Generator) -> Params:
        return self.setup.init_encoder(rng) if self.setup else nbrdf.init_encoder(rng)

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return self.sample(tasks, rng, CONDITION)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        return self.setup.encode(encoder, condition) if self.setup else nbrdf.encode(encoder, condition)

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Mixtures of these materials, as measurements have them where the network learns from such."""
        data = mixed(tasks, rng)
        return tasks.variants(measured(data, rng) if self.setup and self.setup.measured else data)

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        half = tasks.data["where"].shape[1] // 2
        where = tasks.data["where"][tasks.rows, half:].transpose(1, 2)
        return self.errors_of(network(theta, where).clamp_min(0), tasks)

    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of reflectance [T, 3, M] at the held-out samples, linear RGB in 1/sr, >= 0."""
        half = tasks.data["where"].shape[1] // 2
        cos = tasks.data["where"][tasks.rows, half:, 6:7].transpose(1, 2)
        target = tasks.data["target"][tasks.rows, half:].transpose(1, 2)
        return {"error": (torch.log1p(answer * cos) - target).abs().mean((1, 2))}

    def evaluated(self, theta: Params, task: Task) -> Task:
        """The fit's own reflectance at the task's angles."""
        return task._replace(data=task.data | {"reflectance": self.reflectance(theta, task.data["angles"])})

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Evaluate one fitted network.

        Args:
            theta: parameters of one task, no task axis.
            angles: (theta_h, theta_d, phi_d), [..., 3] rad.

        Returns:
            Linear RGB in 1/sr, [..., 3], >= 0.
        """
        one = {key: value[None] for key, value in theta.items()}
        return network(one, _where(angles.reshape(-1, 3)).T[None]).clamp_min(0)[0].T.reshape(*angles.shape[:-1], 3)


def _where(angles: Tensor) -> Tensor:
    """Half vector, difference vector and cos theta_i, [N, 7], of angles [N, 3] in rad."""
    where = angles.new_empty(len(angles), 7)
    where[:, :6] = half_difference(angles)
    half_x, _, half_z, x, _, z, cosine = where.unbind(1)
    cosine[:] = z * half_z - x * half_x
    return where


def network(theta: Params, where: Tensor) -> Tensor:
    """Reflectance before the clamp at 0, by the network that the parameters are of.

    Args:
        theta: parameters [T, ...].
        where: half vector, difference vector and cos theta_i, [T, 7, N].

    Returns:
        [T, 3, N], linear RGB in 1/sr, above -1.
    """
    return reflectance_of(theta, where) if "last" in theta else nbrdf.network(theta, where[:, :6])


def layers_of(theta: Params) -> list[tuple[Tensor, Tensor]]:
    """One material's network, either one, as plain layers: weights [out, in] and biases [out], float64.

    Args:
        theta: parameters of one task, without a task axis.

    Returns:
        Of NBRDF with ReLU between them, on half and difference vector; of a featured network with SiLU, on
        `metapp.apps.brdf.featured.inputs_of`. They end at log(1 + f).
    """
    if "last" in theta:
        return folded(theta)
    pairs = ((theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2, 3))
    return [(weights.detach().double(), bias.detach().double()) for weights, bias in pairs]


def _weights(where: Tensor, learned: Params) -> Tensor:
    """Learned weights of samples, [T, N], between knots over theta_h."""
    position = torch.arccos(where[:, 2].clamp(-1, 1)) * ((KNOTS - 1) / (math.pi / 2))
    knots = torch.arange(KNOTS, device=where.device, dtype=where.dtype)
    hat = (1 - (position[:, None] - knots[:, None]).abs()).clamp_min(0)
    return torch.exp((learned["weights"][:, None] @ hat)[:, 0])


register(Brdf.loss, nbrdf_in_c.loss)
APP = Brdf()
