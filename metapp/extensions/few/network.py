"""The network of fits of few samples: the linear Gaussian models of `metapp.extensions.few.gaussian`, one a kind."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from metapp.apps.brdf.augmentation import within_reach
from metapp.apps.brdf.featured import INPUTS
from metapp.apps.brdf.network import BrdfNetwork, Folded, samples_at
from metapp.extensions.few import gaussian
from metapp.extensions.few.design import Posterior, expected_errors
from metapp.extensions.few.gaussian import DARKEST, opponent, slope_of
from metapp.learning.draws import normal, uniform
from metapp.learning.task import Batch, Linear, Params, Tasks
from metapp.networks.coded import encoder_of, reader_of, with_decoder

MOST = 1024  # samples of which a material has few at most
SHORT = 512  # samples of shorter batches
TABLE = 32  # samples of a table, which has more, that a fit sees: the first ones
FEWEST, SEEN = 4, 256  # samples in training, at least and at most
NOISY, MOST_NOISE = 1 / 2, 0.1  # share of the materials whose samples are noisy, and their most noise
DECADES = (0.5, 1.0)  # by which outliers are off, up or down
POLAR = 3  # the power that crowds theta_h around 0
LUMINANCE, COLOUR = 0.6, 0.1  # standard deviations of features' weights before training
NOISE = (3.4, -3.0, 0.5)  # before training: see `gaussian.precision`
OF_KINDS = ("w3", "b3", "last", "deviation", "noise")


@dataclass(frozen=True)
class Few(BrdfNetwork):
    """The network's size.

    Attributes:
        width: of the two hidden layers.
        features: learned ones; a constant is one more.
        kinds: of materials; each has a mean, deviations and features in which its materials vary independently.
    """

    width: int = 128
    features: int = 100
    kinds: int = 3

    @property
    def task_parameters(self) -> tuple[str, ...]:
        return OF_KINDS

    @property
    def linear_parameter(self) -> str:
        return "last"

    def init(self, rng: Generator, count: int) -> Params:
        """Random weights, the same for all.

        `last` [3, F], on opponent axes, begins as the mean of all materials; `deviation` [3, F], logarithms, is how far
        materials are from it; `noise` [3] is that of samples.
        """
        sizes = {"w1": (self.width, INPUTS), "w2": (self.width, self.width), "w3": (self.features, self.width)}
        theta = {}
        for name, (rows, columns) in sizes.items():
            noise = torch.randn(rows, columns, generator=rng, device=rng.device)
            theta[name] = noise * math.sqrt((2 if name != "w3" else 1) / columns)
            theta[name.replace("w", "b")] = torch.zeros(rows, 1, device=rng.device)
        theta["last"] = torch.zeros(3, self.features + 1, device=rng.device)
        deviations = torch.tensor([LUMINANCE, COLOUR, COLOUR], device=rng.device).log()
        theta["deviation"] = deviations[:, None].expand_as(theta["last"]).contiguous()
        theta["noise"] = torch.tensor(NOISE, device=rng.device)
        return {key: value.expand(count, *value.shape) for key, value in theta.items()}

    def init_encoder(self, rng: Generator) -> Params:
        """What all materials share, and OF_KINDS for each kind, [kinds, ...]."""
        theta = self.init(rng, self.kinds)
        return encoder_of({key: theta[key] for key in OF_KINDS}, theta, OF_KINDS)

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Parameters of the kind that is likeliest to have made the samples, as `sample` gives them."""
        kinds = reader_of(encoder)
        count = len(condition["where"])
        every = [self.of_kinds(encoder, torch.full((count,), kind)) for kind in range(len(kinds["last"]))]
        with torch.no_grad():
            likeliest = torch.stack([gaussian.evidence(theta, condition) for theta in every]).argmax(0)
        return self.of_kinds(encoder, likeliest)

    def of_kinds(self, encoder: Params, which: Tensor) -> Params:
        """Parameters [T, ...] of materials of these kinds, int [T]."""
        which = which.to(encoder["encoder.last"].device)
        return with_decoder({key: value[which] for key, value in reader_of(encoder).items()}, encoder)

    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        return gaussian.reflectance_of(theta, where)

    def least_squares(self, theta: Params, batch: Batch, learned: Params) -> Linear:
        """The ridge regression of all samples in logarithms."""
        return gaussian.linear(theta, batch)

    def folded(self, theta: Params) -> Folded:
        theta = {key: value.detach().double() for key, value in theta.items()}
        last = opponent(theta) @ theta["last"]
        layers = [(theta[f"w{layer}"], theta[f"b{layer}"].flatten()) for layer in (1, 2)]
        layers.append((last[:, :-1] @ theta["w3"], (last[:, :-1] @ theta["b3"]).flatten() + last[:, -1]))
        return Folded(layers, "featured", darkest=DARKEST)

    def prepare(self, data: Params) -> Params:
        """Put the samples that a fit sees in front, none twice, and say their `count`.

        Of a table, which has more than MOST samples, a fit sees the first TABLE of them.
        """
        half = len(data["where"]) // 2
        _, which = torch.unique(data["where"][:half], dim=0, return_inverse=True)
        first = torch.full((int(which.max()) + 1,), half).scatter_reduce(0, which, torch.arange(half), "amin")
        if len(first) > MOST:
            return data | {"count": torch.tensor(float(TABLE))}
        order = torch.arange(len(data["where"]))
        order[: len(first)] = first.sort().values
        return {key: value[order] for key, value in data.items()} | {"count": torch.tensor(float(len(first)))}

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """The samples that a fit sees, again and again, and how many different ones, `count` [T].

        Where all materials have SHORT or fewer, a batch has no more: the solve takes half the time.
        """
        seen = tasks.data["count"][tasks.rows]
        count = min(count, SHORT) if bool((seen <= SHORT).all()) else count
        rows = torch.arange(count, device=rng.device) % seen[:, None].long()
        return samples_at(tasks, rows) | {"count": seen}

    def augment(self, data: Params, rng: Generator) -> Params:
        """Few samples, `count` [T], among the first SEEN.

        In half of the materials with noise; in a third none beyond an angle; in half of them crowded around
        theta_h = 0, as planned ones are.
        """
        where, target = data["where"].clone(), data["target"].clone()
        count, half = len(where), where.shape[1] // 2

        seen = within_reach(where[:, :half], rng)
        # the density of theta_h where it is the power of what is uniform
        crowded = where[:, :half, 2].clamp(-1, 1).arccos().clamp_min(1e-2) ** (1 / POLAR - 1)
        wanted = torch.where(uniform(rng, count, 1) < 0.5, crowded, 1.0) * seen + 1e-9
        chosen = torch.multinomial(wanted, SEEN, generator=rng)[..., None]
        level = torch.where(uniform(rng, count, 1) < NOISY, uniform(rng, count, 1), 0.0)[..., None]
        factor = factors(rng, (count, SEEN), MOST_NOISE * level, 0.0)
        where[:, :SEEN] = where.gather(1, chosen.expand(-1, -1, 7))
        target[:, :SEEN] = torch.log1p(torch.expm1(target.gather(1, chosen.expand(-1, -1, 3))) * factor)
        return {
            "where": where,
            "target": target,
            "count": (FEWEST * (SEEN / FEWEST) ** uniform(rng, count, 1)[:, 0]).round(),
        }

    def expected_errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """The error that samples leave: `expected` over all directions, in highlights, at grazing angles."""
        batch = self.sample(tasks, Generator(), MOST)
        errors = []
        for i, count in enumerate(batch["count"].tolist()):
            one = {key: value[i : i + 1] for key, value in theta.items()}
            where, target = (batch[key][i : i + 1, :, : int(count)] for key in ("where", "target"))
            slope = slope_of(target.expm1() / where[:, 6:].clamp_min(1e-4), where)
            errors.append(expected_errors(Posterior.of(one, where, slope)))
        return {name: torch.tensor([one[name] for one in errors]) for name in errors[0]}


NETWORK = Few()


def factors(rng: Generator, shape: tuple[int, ...], noise: Tensor | float, outliers: Tensor | float) -> Tensor:
    """Factors [*shape, 3] by which measured reflectance is off.

    Args:
        rng: of all draws.
        shape: of the samples.
        noise: standard deviation of the logarithm of a channel's factor, such as 0.05 for about 5 %; broadcasts.
        outliers: share of samples that are off by DECADES, all channels alike; broadcasts.
    """
    factor = torch.exp(noise * normal(rng, *shape, 3))
    low, high = DECADES
    decades = low + (high - low) * uniform(rng, *shape, 1)
    decades = decades * (2 * torch.randint(2, (*shape, 1), generator=rng, device=rng.device) - 1)
    return factor * torch.where(uniform(rng, *shape, 1) < outliers, 10**decades, 1.0)
