"""BRDFs on half and difference vectors (paper section 4.1.2): the NBRDF network, or one of learned features."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import half_difference_incident
from metapp.appearance.noise import factors, standing_in
from metapp.apps.brdf import anisotropic, design, featured, few, nbrdf, nbrdf_in_c
from metapp.apps.brdf.featured import TURN, Featured, outgoing_cosine
from metapp.apps.brdf.few import MOST, Few
from metapp.engine import register
from metapp.learning.app import App, Traits
from metapp.learning.task import Batch, Held, Linear, Params, Task, Tasks

CONDITION = 1024  # samples that General's encoder reads
KNOTS = 8
SAMPLES = 8192
# shares of the materials that are noisy and that lack grazing samples; the most noise and outliers, as of
# `appearance.noise.factors`; the least and greatest angle that is measured
NOISY, CUT = 1 / 2, 1 / 3
NOISE, OUTLIERS, MEASURED_RAD = 0.25, 0.02, (math.radians(60), math.radians(85))
FEWEST, FEW_NOISE, POLAR = 4, 0.1, 3  # few samples: at least, their noise, and the power that crowds theta_h around 0
SEEN = 256  # at most, in training


class Brdf(App):
    """One measured or modelled material a task; of an anisotropic one a network without phi_h fits what it can."""

    name = "brdf"
    holds: ClassVar = {
        "angles": Held(("N", 3), low=0.0, high=2 * math.pi),
        "phi_h": Held(("N",), low=0.0, high=2 * math.pi, optional=True),
        "reflectance": Held(("N", 3), low=0.0),
        "render": Held(("H", "W", 4)),
        "environment": Held(("h", "w", 4), optional=True),
    }

    setup: Featured | Few | None

    @property
    def traits(self) -> Traits:
        own = self.setup.own if self.setup else ()
        return Traits(scale=100.0, single_threaded=True, compiles=True, cheap_fits=True, own=own)

    @property
    def solves(self) -> str:
        """The last layer, but of the NBRDF network."""
        return "last" if self.setup else ""

    @property
    def anisotropic(self) -> bool:
        """Whether its network reads phi_h."""
        return isinstance(self.setup, Featured) and self.setup.anisotropic

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`where` [N, 7]: half and difference vector, cos theta_i; `target` [N, 3]: log(1 + f cos theta_i)."""
        angles = task.data["angles"]
        if self.anisotropic:
            phi_h = task.data.get("phi_h", anisotropic.random_azimuths(len(angles)).to(angles))
            angles = torch.cat([angles, phi_h[:, None]], 1)
        where = half_difference_incident(angles)
        data = {"where": where.float(), "target": torch.log1p(task.data["reflectance"] * where[:, 6:]).float()}
        return few.condensed(data) if isinstance(self.setup, Few) else data

    def init(self, rng: Generator, count: int) -> Params:
        return self.setup.init(rng, count) if self.setup else nbrdf.init(rng, count)

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`where` [T, 7, count] and `target` [T, 3, count] from the first half of the samples.

        Where there are few, these, again and again, and how many, `count` [T].
        """
        if "count" not in tasks.data:
            return self._drawn(tasks, rng, count, 0)
        seen = tasks.data["count"][tasks.rows]
        rows = torch.arange(count, device=rng.device) % seen[:, None].long()
        return self._picked(tasks, rows) | {"count": seen}

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """From the half that fits do not see, which is without noise and complete."""
        return self._drawn(tasks, rng, count, tasks.data["where"].shape[1] // 2)

    def _drawn(self, tasks: Tasks, rng: Generator, count: int, first: int) -> Batch:
        half = tasks.data["where"].shape[1] // 2
        return self._picked(tasks, first + torch.randint(half, (len(tasks), count), generator=rng, device=rng.device))

    def _picked(self, tasks: Tasks, rows: Tensor) -> Batch:
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
        """Least squares near the loss, of the network that the parameters are of."""
        return few.linear(theta, batch) if isinstance(self.setup, Few) else featured.linear(theta, batch, learned)

    def loss_parameters(self, steps: int) -> Params:
        """Smoothing, and for the NBRDF network weights of samples."""
        weights = {} if self.setup else {"weights": torch.zeros(steps, KNOTS)}
        return {"smoothing": torch.full((steps,), math.log(0.05))} | weights

    def init_encoder(self, rng: Generator) -> Params:
        return self.setup.init_encoder(rng) if isinstance(self.setup, Featured) else nbrdf.init_encoder(rng)

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return self.sample(tasks, rng, CONDITION)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        if isinstance(self.setup, Featured):
            return self.setup.encode(encoder, condition)
        return nbrdf.encode(encoder, condition)

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Mixtures of these materials, as measurements have them where the network learns from such."""
        data = mixed(tasks, rng)
        if self.anisotropic:
            turn = 2 * math.pi * torch.rand(len(tasks), 1, generator=rng, device=rng.device)
            data["where"] = anisotropic.turned(data["where"], turn)
        if isinstance(self.setup, Few):
            data = fewer(data, rng)
        elif self.setup and self.setup.measured:
            data = measured(data, rng)
        return tasks.variants(data)

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        half = tasks.data["where"].shape[1] // 2
        where = tasks.data["where"][tasks.rows, half:].transpose(1, 2)
        found = self.errors_of(network(theta, where).clamp_min(0), tasks)
        return found | (self._expected(theta, tasks) if isinstance(self.setup, Few) else {})

    def _expected(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """The error x100 that samples leave: `expected` over all directions, in highlights, at grazing angles."""
        batch = self.sample(tasks, Generator(), MOST)
        each = []
        for i, count in enumerate(batch["count"].tolist()):
            one = {key: value[i : i + 1] for key, value in theta.items()}
            where, target = (batch[key][i : i + 1, :, : int(count)] for key in ("where", "target"))
            slope = few.slope_of(target.expm1() / where[:, 6:].clamp_min(1e-4), where)
            each.append(design.expected_errors(design.belief(one, where, slope)))
        return {name: self.traits.scale * torch.tensor([one[name] for one in each]) for name in each[0]}

    def remarks(self, task: Task, theta: Params) -> dict[str, Any]:
        """That no sample was held out, where a measurement has few; that phi_h counts for nothing."""
        notes, half = [], len(task.data["angles"]) // 2
        if torch.equal(task.data["angles"][:half], task.data["angles"][half:]):
            notes.append(f"all {half} samples are fitted, none is held out: the error is of these")
        if "phi_h" in task.data and not self.anisotropic:
            notes.append("anisotropic, fitted as isotropic: phi_h is left out; take metapp meta --recipe anisotropic")
        return {"note": "; ".join(notes)} if notes else {}

    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of reflectance [T, 3, M] at the held-out samples, linear RGB in 1/sr, >= 0."""
        half = tasks.data["where"].shape[1] // 2
        cos = tasks.data["where"][tasks.rows, half:, 6:7].transpose(1, 2)
        target = tasks.data["target"][tasks.rows, half:].transpose(1, 2)
        return {"error": (torch.log1p(answer * cos) - target).abs().mean((1, 2))}

    def evaluated(self, theta: Params, task: Task) -> Task:
        """The fit's own reflectance at the task's angles, all over the hemisphere where it has few.

        Raises:
            ValueError: the fit is anisotropic.
        """
        self.require_isotropic(task.name, "the NBRDF network")
        angles = task.data["angles"]
        if len(angles) <= 2 * MOST:
            angles = design.spread_angles(SAMPLES)
        return task._replace(data=task.data | {"angles": angles, "reflectance": self.reflectance(theta, angles)})

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Evaluate one fitted network.

        Args:
            theta: parameters of one task, no task axis.
            angles: (theta_h, theta_d, phi_d), and phi_h, which is 0 without, [..., 3 or 4] rad.

        Returns:
            Linear RGB in 1/sr, [..., 3], >= 0; of an isotropic network whatever phi_h is.
        """
        one = {key: value[None] for key, value in theta.items()}
        flat = angles.reshape(-1, angles.shape[-1])
        where = half_difference_incident(flat if TURN in theta else flat[:, :3])
        return network(one, where.T[None]).clamp_min(0)[0].T.reshape(*angles.shape[:-1], 3)

    def require_isotropic(self, subject: str | Path, form: str) -> None:
        """Refuse to write a fit in a form that has no phi_h.

        Raises:
            ValueError: the fit is anisotropic.
        """
        if self.anisotropic:
            raise ValueError(
                f"{subject}: an anisotropic fit, expected an isotropic one: {form} has no phi_h; export bsdf or "
                "mitsuba, or fit by --recipe full."
            )


def network(theta: Params, where: Tensor) -> Tensor:
    """Reflectance before the clamp at 0, by the network that the parameters are of.

    Args:
        theta: parameters [T, ...].
        where: half vector, difference vector and cos theta_i, [T, 7, N].

    Returns:
        [T, 3, N], linear RGB in 1/sr, above -1.
    """
    if "deviation" in theta:
        return few.reflectance_of(theta, where)
    return featured.reflectance_of(theta, where) if "last" in theta else nbrdf.network(theta, where[:, :6])


def layers_of(theta: Params) -> list[tuple[Tensor, Tensor]]:
    """One material's network, any of them, as plain layers: weights [out, in] and biases [out], float64.

    Args:
        theta: parameters of one task, without a task axis.

    Returns:
        Of NBRDF with ReLU between them, on half and difference vector; of the others with SiLU, on
        `metapp.apps.brdf.featured.inputs_of`. They end at log(1 + f), that of `few` as its `reflectance_of` says.
    """
    if "deviation" in theta:
        return few.folded(theta)
    if "last" in theta:
        return featured.folded(theta)
    pairs = ((theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2, 3))
    return [(weights.detach().double(), bias.detach().double()) for weights, bias in pairs]


def _weights(where: Tensor, learned: Params) -> Tensor:
    """Learned weights of samples, [T, N], between knots over theta_h."""
    position = torch.arccos(where[:, 2].clamp(-1, 1)) * ((KNOTS - 1) / (math.pi / 2))
    knots = torch.arange(KNOTS, device=where.device, dtype=where.dtype)
    hat = (1 - (position[:, None] - knots[:, None]).abs()).clamp_min(0)
    return torch.exp((learned["weights"][:, None] @ hat)[:, 0])


# Data augmentation


def mixed(tasks: Tasks, rng: Generator) -> Params:
    """Mixtures of two of these materials, channels permuted and scaled: `where`, `target` at SAMPLES samples each.

    Mixing needs both materials at the same angles; where a data set has them at its own for each, they are only
    permuted and scaled.
    """
    count, device = len(tasks), rng.device
    where, target = tasks.data["where"], tasks.data["target"]
    columns = torch.randint(where.shape[1], (SAMPLES,), generator=rng, device=device)
    mine = torch.expm1(target[tasks.rows[:, None], columns])
    if where.stride(0) == 0:
        other = tasks.rows[torch.randint(count, (count, 1), generator=rng, device=device)]
        share = 2 * torch.rand(count, 1, 1, generator=rng, device=device)
        mine = torch.lerp(torch.expm1(target[other, columns]), mine, share.clamp(max=1))
    channels = torch.rand(count, 1, 3, generator=rng, device=device).argsort(-1).expand_as(mine)
    gain = torch.exp(0.3 * torch.randn(count, 1, 3, generator=rng, device=device))
    gain = gain * torch.exp(0.3 * torch.randn(count, 1, 1, generator=rng, device=device))
    return {"where": where[tasks.rows[:, None], columns], "target": torch.log1p(mine.gather(2, channels) * gain)}


def measured(data: Params, rng: Generator) -> Params:
    """Materials [T, N, ...] of which the first half of the samples, which fits see, is as measurements are."""
    where, target = data["where"], data["target"]
    count, half = len(where), where.shape[1] // 2

    def uniform() -> Tensor:
        return torch.rand(count, 1, 1, generator=rng, device=rng.device)

    level = torch.where(uniform() < NOISY, uniform(), 0.0)
    factor = factors(rng, (count, half), NOISE * level, OUTLIERS * level)
    rows = standing_in(rng, within_reach(where[:, :half], rng))[..., None]
    visible = {"where": where[:, :half], "target": torch.log1p(torch.expm1(target[:, :half]) * factor)}
    kept = {key: value.gather(1, rows.expand_as(value)) for key, value in visible.items()}
    return {key: torch.cat([value, data[key][:, half:]], 1) for key, value in kept.items()}


def within_reach(where: Tensor, rng: Generator) -> Tensor:
    """Which samples [T, N, 7] an instrument sees, bool [T, N]: of a share of materials none beyond an angle."""

    def uniform() -> Tensor:
        return torch.rand(len(where), 1, generator=rng, device=rng.device)

    low, high = MEASURED_RAD
    limit = torch.where(uniform() < CUT, torch.cos(low + (high - low) * uniform()), 0.0)
    return torch.minimum(where[..., 6], outgoing_cosine(where.transpose(1, 2))) >= limit


def fewer(data: Params, rng: Generator) -> Params:
    """Materials [T, N, ...] of which a fit sees few samples, `count` [T], among the first MOST.

    In half of them with noise; in a third none beyond an angle; in half of them crowded around theta_h = 0, as planned
    ones are.
    """
    where, target = data["where"].clone(), data["target"].clone()
    count, half = len(where), where.shape[1] // 2

    def uniform() -> Tensor:
        return torch.rand(count, 1, generator=rng, device=rng.device)

    seen = within_reach(where[:, :half], rng)
    # the density of theta_h where it is the power of what is uniform
    crowded = where[:, :half, 2].clamp(-1, 1).arccos().clamp_min(1e-2) ** (1 / POLAR - 1)
    wanted = torch.where(uniform() < 0.5, crowded, 1.0) * seen + 1e-9
    chosen = torch.multinomial(wanted, MOST, generator=rng)[..., None]
    level = torch.where(uniform() < NOISY, uniform(), 0.0)[..., None]
    factor = factors(rng, (count, MOST), FEW_NOISE * level, 0.0)
    where[:, :MOST] = where.gather(1, chosen.expand(-1, -1, 7))
    target[:, :MOST] = torch.log1p(torch.expm1(target.gather(1, chosen.expand(-1, -1, 3))) * factor)
    return {"where": where, "target": target, "count": (FEWEST * (SEEN / FEWEST) ** uniform()[:, 0]).round()}


register(Brdf.loss, nbrdf_in_c.loss)
