"""BRDFs: the NBRDF network of Sztrajman et al. 2021 on half/difference vectors (paper section 4.1.2)."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import torch
from torch import Generator, Tensor
from torch.nn.functional import gelu, layer_norm

from metapp.appearance.geometry import cos_incident, half_difference
from metapp.learning.app import App
from metapp.learning.recipe import Adam, MetaTraining, OuterLoop, Recipe
from metapp.learning.task import Batch, Held, Params, Task, Tasks

WIDTHS = (6, 21, 21, 3)
CONDITION = 1024  # samples that General's encoder reads
ENCODER = 128
KNOTS = 8
AUGMENTED = 8192
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
        "meta-sgd": replace(LEARNED, first=Adam(0.1), rates={"": 3e-3}),
        "meta-adam": LEARNED,
        "meta-curvature": LEARNED,
    },
    rule="meta-curvature",
)

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


def network(theta: Params, inputs: Tensor) -> Tensor:
    """Reflectance before the clamp at 0.

    Args:
        theta: weights w1..w3 [T, out, in] and biases b1..b3 [T, out, 1].
        inputs: half and difference vectors [T, 6, N].

    Returns:
        exp(out) - 1, [T, 3, N], linear RGB in 1/sr, above -1.
    """
    x = inputs
    for layer in (1, 2):
        x = torch.relu(torch.baddbmm(theta[f"b{layer}"], theta[f"w{layer}"], x))
    return torch.expm1(torch.baddbmm(theta["b3"], theta["w3"], x))


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
    recipes = {"paper": PAPER, "quick": QUICK}  # noqa: RUF012  (never written to)

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`where` [N, 7]: half and difference vector, cos theta_i; `target` [N, 3]: log(1 + f cos theta_i)."""
        angles, reflectance = task.data["angles"], task.data["reflectance"]
        cos = cos_incident(angles)[:, None]
        return {
            "where": torch.cat([half_difference(angles), cos], 1).float(),
            "target": torch.log1p(reflectance * cos).float(),
        }

    def init(self, rng: Generator, count: int) -> Params:
        """Kaiming-normal weights and zero biases."""
        theta = {}
        for layer, (inputs, outputs) in enumerate(itertools.pairwise(WIDTHS), 1):
            noise = torch.randn(count, outputs, inputs, generator=rng, device=rng.device)
            theta[f"w{layer}"] = noise * math.sqrt((2 if layer < 3 else 1) / inputs)
            theta[f"b{layer}"] = torch.zeros(count, outputs, 1, device=rng.device)
        return theta

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`where` [T, 7, count] and `target` [T, 3, count] from the first half of the samples."""
        half = tasks.data["where"].shape[1] // 2
        rows = torch.randint(half, (len(tasks), count), generator=rng, device=rng.device)
        picked = (tasks.rows[:, None], rows)
        return {key: tasks.data[key][picked].transpose(1, 2).contiguous() for key in ("where", "target")}

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)|, [T].

        A learned `smoothing` s [T] replaces |d| by sqrt(d^2 + s^2) - s, whose curvature at sign changes autodiff sees;
        learned `weights` [T, 8] are log weights of samples at knots over theta_h.
        """
        where = batch["where"]
        # without the clamp at 0 a network that is too dark still has a gradient; the clamp only ever helps
        d = torch.log1p(network(theta, where[:, :6]) * where[:, 6:7]) - batch["target"]
        if not learned:
            return d.abs().mean((1, 2))
        s = torch.exp(learned["smoothing"])[:, None, None]
        norm = ((d * d + s * s).sqrt() - s).mean(1)
        position = torch.arccos(where[:, 2].clamp(-1, 1)) * ((KNOTS - 1) / (math.pi / 2))
        knots = torch.arange(KNOTS, device=d.device, dtype=d.dtype)
        hat = (1 - (position[:, None] - knots[:, None]).abs()).clamp_min(0)
        weight = torch.exp((learned["weights"][:, None] @ hat)[:, 0])
        return (norm * weight).mean(1)

    def loss_parameters(self, steps: int) -> Params:
        return {"smoothing": torch.full((steps,), math.log(0.05)), "weights": torch.zeros(steps, KNOTS)}

    def init_encoder(self, rng: Generator) -> Params:
        """A set encoder: a network on each sample, the mean over samples, a network to all 675 weights."""
        sizes = {"in": (10, ENCODER), "mid": (ENCODER, ENCODER), "set": (2 * ENCODER, 2 * ENCODER)}
        weights = sum(rows * columns for rows, columns in _shapes().values())
        sizes |= {"deep": (2 * ENCODER, 2 * ENCODER), "out": (2 * ENCODER, weights)}
        encoder = {}
        for name, (inputs, outputs) in sizes.items():
            gain = 0.1 if name == "out" else math.sqrt(2)
            noise = torch.randn(inputs, outputs, generator=rng, device=rng.device)
            encoder[f"{name}.w"] = noise * gain / math.sqrt(inputs)
            encoder[f"{name}.b"] = torch.zeros(outputs, device=rng.device)
        start = self.init(rng, 1)
        encoder["out.b"] = torch.cat([value.flatten() for value in start.values()])
        return encoder

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return self.sample(tasks, rng, CONDITION)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        def dense(name: str, x: Tensor) -> Tensor:
            return x @ encoder[f"{name}.w"] + encoder[f"{name}.b"]

        samples = torch.cat([condition["where"], condition["target"]], 1).transpose(1, 2)
        x = gelu(dense("mid", gelu(dense("in", samples))))
        x = torch.cat([x.mean(1), x.amax(1)], 1)
        x = layer_norm(x, x.shape[-1:])
        x = gelu(dense("set", x))
        x = x + gelu(dense("deep", layer_norm(x, x.shape[-1:])))
        flat = dense("out", x)
        theta, at = {}, 0
        for name, (rows, columns) in _shapes().items():
            theta[name] = flat[:, at : at + rows * columns].reshape(-1, rows, columns)
            at += rows * columns
        return theta

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Mixtures of two of these materials, channels permuted and scaled, at AUGMENTED samples each.

        Mixing needs both materials at the same angles; where a data set has them at its own for each, they are only
        permuted and scaled.
        """
        count, device = len(tasks), rng.device
        where, target = tasks.data["where"], tasks.data["target"]
        columns = torch.randint(where.shape[1], (AUGMENTED,), generator=rng, device=device)
        mine = torch.expm1(target[tasks.rows[:, None], columns])
        if where.stride(0) == 0:
            other = tasks.rows[torch.randint(count, (count, 1), generator=rng, device=device)]
            share = 2 * torch.rand(count, 1, 1, generator=rng, device=device)
            mine = torch.lerp(torch.expm1(target[other, columns]), mine, share.clamp(max=1))
        channels = torch.rand(count, 1, 3, generator=rng, device=device).argsort(-1).expand_as(mine)
        gain = torch.exp(0.3 * torch.randn(count, 1, 3, generator=rng, device=device))
        gain = gain * torch.exp(0.3 * torch.randn(count, 1, 1, generator=rng, device=device))
        data = {"where": where[tasks.rows[:, None], columns], "target": torch.log1p(mine.gather(2, channels) * gain)}
        return tasks.variants(data)

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        half = tasks.data["where"].shape[1] // 2
        where = tasks.data["where"][tasks.rows, half:].transpose(1, 2)
        return self.errors_of(network(theta, where[:, :6]).clamp_min(0), tasks)

    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of reflectance [T, 3, M] at the held-out samples, linear RGB in 1/sr, >= 0."""
        half = tasks.data["where"].shape[1] // 2
        cos = tasks.data["where"][tasks.rows, half:, 6:7].transpose(1, 2)
        target = tasks.data["target"][tasks.rows, half:].transpose(1, 2)
        return {"error": (torch.log1p(answer * cos) - target).abs().mean((1, 2))}

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Evaluate one fitted network.

        Args:
            theta: parameters of one task, no task axis.
            angles: (theta_h, theta_d, phi_d), [..., 3] rad.

        Returns:
            Linear RGB in 1/sr, [..., 3], >= 0.
        """
        inputs = half_difference(angles).reshape(1, -1, 6).transpose(1, 2)
        one = {key: value[None] for key, value in theta.items()}
        return network(one, inputs).clamp_min(0)[0].T.reshape(*angles.shape[:-1], 3)


def _shapes() -> dict[str, tuple[int, int]]:
    """The shape of each parameter of one task."""
    shapes: dict[str, tuple[int, int]] = {}
    for layer, (inputs, outputs) in enumerate(itertools.pairwise(WIDTHS), 1):
        shapes |= {f"w{layer}": (outputs, inputs), f"b{layer}": (outputs, 1)}
    return shapes


APP = Brdf()
