"""Networks of BRDFs: their base class, and which of them parameters belong to."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import half_difference_and_cosine
from metapp.learning.task import Batch, Params, Tasks
from metapp.registry import registry

COUNT_KEY = "count"  # tensor of tasks and batches, [T]: how many different samples, the first ones, a fit sees
# columns: luminance, and two axes of colour, of unit length
_OPPONENT_AXES = ((3**-0.5, 2**-0.5, 6**-0.5), (3**-0.5, 0.0, -2 * 6**-0.5), (3**-0.5, -(2**-0.5), 6**-0.5))


def opponent_axes(like: Tensor) -> Tensor:
    """Return the matrix [3, 3] from luminance and two axes of colour to linear RGB; its transpose is its inverse.

    Reflectance varies more from material to material in luminance than in colour.

    Args:
        like: a tensor of the dtype and device that the matrix gets.

    >>> axes = opponent_axes(torch.zeros(1, dtype=torch.float64))
    >>> bool(torch.allclose(axes.T @ axes, torch.eye(3, dtype=torch.float64)))
    True
    """
    return like.new_tensor(_OPPONENT_AXES)


class PlainLayers(NamedTuple):
    """One material's network as plain layers, all that materials share multiplied in.

    Attributes:
        layers: weights [out, in] and biases [out] of each of the three, float64.
        inputs: "nbrdf": half and difference vector, with ReLU between the layers; "featured": `featured.inputs_of`,
            "anisotropic": `anisotropic.inputs_of`, both with SiLU.
        turn: azimuth of the material's axes in rad, of "anisotropic" alone.
        darkest: the last layer ends at log(f cos theta_i cos theta_o + darkest), with that product at least this; 0: at
            log(1 + f).
    """

    layers: list[tuple[Tensor, Tensor]]
    inputs: str
    turn: float | None = None
    darkest: float = 0.0


class BrdfNetwork(ABC):
    """A network of BRDFs; an instance holds its size.

    `where` [T, 7, N] is half vector, difference vector and cos theta_i; `target` [T, 3, N] is log(1 + f cos theta_i).
    `reflectance`, `evaluate` and `folded` go by the sizes of the parameters: any instance will do.
    """

    @property
    def unshared_parameters(self) -> tuple[str, ...]:
        """The parameters that a material does not share with others after General's encoder; () for all."""
        return ()

    @property
    def linear_parameter(self) -> str:
        """The parameter that it is linear in; "" for none."""
        return ""

    @property
    def anisotropic(self) -> bool:
        """True if it reads phi_h."""
        return False

    @property
    def can_conserve(self) -> bool:
        """True if its fits can be brought to reflect no more than they receive."""
        return False

    @abstractmethod
    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of `count` materials, [count, ...]."""

    def init_encoder(self, rng: Generator) -> Params:
        """Random parameters of General's encoder; {} if there is none."""
        return {}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Parameters [T, ...] from samples, one forward pass."""
        raise NotImplementedError

    @abstractmethod
    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        """Reflectance before the clamp at 0, [T, 3, N], linear RGB in 1/sr, of places [T, 7, N]."""

    def evaluate(self, theta: Params, angles: Tensor) -> Tensor:
        """Evaluate one fitted material.

        Args:
            theta: parameters of one task, no task axis.
            angles: (theta_h, theta_d, phi_d), and phi_h, which is 0 without, [..., 3 or 4] rad.

        Returns:
            Linear RGB in 1/sr, [..., 3], >= 0; of an isotropic network whatever phi_h is.
        """
        one = {key: value[None] for key, value in theta.items()}
        flat = angles.reshape(-1, angles.shape[-1])
        where = half_difference_and_cosine(flat if self.anisotropic else flat[:, :3])
        return self.reflectance(one, where.T[None]).clamp_min(0)[0].T.reshape(*angles.shape[:-1], 3)

    def features_of(self, theta: Params, where: Tensor) -> Tensor:
        """The factors of `linear_parameter`, [T, F, N], of places [T, 7, N]."""
        raise NotImplementedError

    def conserved(self, theta: Params) -> Params:
        """Materials whose last layer is such that they reflect no more than all, if `can_conserve`."""
        raise NotImplementedError

    @abstractmethod
    def folded(self, theta: Params) -> PlainLayers:
        """One material as plain layers, of parameters without a task axis."""

    def augment(self, data: Params, rng: Generator) -> Params:
        """Change the samples `where` [T, N, 7] and `target` [T, N, 3] of materials for training."""
        return data


def put_distinct_first(data: Params) -> Params:
    """Put different samples first among those that a fit sees, the first half, and add how many there are.

    Args:
        data: `where` [N, 7], and others [N, ...].

    Returns:
        The tensors in the new order, and COUNT, a scalar.

    >>> where = torch.tensor([[0.0], [0.0], [1.0], [2.0], [3.0], [4.0]]).expand(-1, 7)
    >>> data = put_distinct_first({"where": where})
    >>> data["where"][:2, 0].tolist(), float(data[COUNT])
    ([0.0, 1.0], 2.0)
    """
    where, half = data["where"], len(data["where"]) // 2
    key = (
        where[:half].double() @ torch.arange(1.0, 1 + where.shape[1]).double().sqrt()
    )  # tells pairs of directions apart
    _, which = torch.unique(key, return_inverse=True)
    first = torch.full((int(which.max()) + 1,), half).scatter_reduce(0, which, torch.arange(half), "amin")
    if len(first) < half:
        order = torch.arange(len(where))
        order[: len(first)] = first.sort().values
        data = {name: value[order] for name, value in data.items()}
    return data | {COUNT_KEY: torch.tensor(float(len(first)))}


def gather_samples(tasks: Tasks, rows: Tensor) -> Batch:
    """`where` [T, 7, count] and `target` [T, 3, count] of each task's samples of these indices, [T, count]."""
    picked = (tasks.rows[:, None], rows)
    return {key: tasks.data[key][picked].transpose(1, 2).contiguous() for key in ("where", "target")}


@functools.cache
def parameter_shapes(network: BrdfNetwork) -> dict[str, tuple[int, ...]]:
    """The shape of each parameter of one task; their names tell its parameters from another network's."""
    return {name: tuple(value.shape[1:]) for name, value in network.init(Generator().manual_seed(0), 1).items()}


def find_network(theta: Params) -> BrdfNetwork:
    """The network that parameters belong to, by their names.

    Raises:
        ValueError: they are of none.
    """
    for network in registry().load_table("networks", "brdf").values():
        if parameter_shapes(network).keys() == theta.keys():
            result: BrdfNetwork = network
            return result
    names = ", ".join(sorted(theta)) or "none"
    raise ValueError(f"parameters {names[:80]}, expected those of a BRDF fit.")
