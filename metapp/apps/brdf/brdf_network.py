"""The base class of networks of BRDFs, and the choice of the network that fitted parameters belong to.

Applications, exports and pages use a network by this class alone, so that an extension may register another one. What
is common to the samples of all networks is here, too.
"""

from __future__ import annotations

import functools
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.geometry import half_difference_and_cosine
from metapp.learning.components import Decoder, Encoder
from metapp.learning.task import Batch, Params, Tasks, add_task_axis
from metapp.registry import registry

# A function of places `where` [T, 7, N] that returns reflectance before the clamp at 0, [T, 3, N], linear RGB in 1/sr
ReflectanceFunction = Callable[[Tensor], Tensor]
# columns of unit length: luminance, and two axes of colour
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
    """One material's network as three plain layers, into which all that materials share is multiplied.

    Attributes:
        layers: weights [out, in] and biases [out] of each of the three layers, float64.
        inputs: the input, and the nonlinearity between layers: "nbrdf", half and difference vector, with ReLU;
            "featured", `feature_network.isotropic_inputs`, and "anisotropic", `anisotropic.anisotropic_inputs`, with
            SiLU.
        axes_azimuth_rad: azimuth of the material's axes in rad; None unless `inputs` is "anisotropic".
        log_floor: if above 0, the last layer yields log(f cos theta_i cos theta_o + log_floor), where the product of
            cosines is at least log_floor; if 0, it yields log(1 + f).
    """

    layers: list[tuple[Tensor, Tensor]]
    inputs: str
    axes_azimuth_rad: float | None = None
    log_floor: float = 0.0


class ReflectanceSamples(NamedTuple):
    """Samples of materials, as networks read them; as they are prepared, without a task axis, samples come first.

    Attributes:
        where: half vector, difference vector and cos theta_i, [T, 7, N].
        target: log(1 + f cos theta_i), [T, 3, N].
    """

    where: Tensor
    target: Tensor


class DistinctSamples(NamedTuple):
    """Samples of materials of which it is known how many are different.

    Attributes:
        where, target: see :class:`ReflectanceSamples`.
        distinct: how many samples of the first half of a task's, which fits see, are different, [T].
    """

    where: Tensor
    target: Tensor
    distinct: Tensor


class BrdfNetwork(Decoder[ReflectanceFunction, Any]):
    """A network of BRDFs, the decoder of reflectance; an instance holds its size.

    `where` [T, 7, N] is half vector, difference vector and cos theta_i; `target` [T, 3, N] is log(1 + f cos theta_i).
    `reflectance`, `evaluate` and `fold` read sizes off the parameters, so that any instance can evaluate fits of any
    size.
    """

    @property
    def unshared_parameters(self) -> tuple[str, ...]:
        """The names of the parameters that materials do not share after General's encoder; () if they share none."""
        return ()

    @property
    def anisotropic(self) -> bool:
        """True if the network reads phi_h."""
        return False

    @property
    def can_conserve_energy(self) -> bool:
        """True if `conserve_energy` can limit fits to reflecting no more light than they receive."""
        return False

    @override
    def __call__(self, theta: Params, seen: Any = None) -> ReflectanceFunction:
        """Return the function of places `where` [T, 7, N] that is reflectance, see :meth:`reflectance`."""
        return functools.partial(self.reflectance, theta)

    def init_encoder(self, rng: Generator) -> Params:
        """Draw random parameters of General's encoder; {} if there is none."""
        return {}

    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Predict parameters [T, ...] from samples by one forward pass of General's encoder.

        Args:
            encoder: parameters of the encoder.
            encoder_input: the samples, `where` [T, 7, N] and `target` [T, 3, N].
        """
        raise NotImplementedError

    @abstractmethod
    def reflectance(self, theta: Params, where: Tensor) -> Tensor:
        """Return reflectance before the clamp at 0, [T, 3, N], linear RGB in 1/sr.

        Args:
            theta: parameters of T materials.
            where: half vector, difference vector and cos theta_i, [T, 7, N].
        """

    def evaluate(self, theta: Params, angles: Tensor) -> Tensor:
        """Evaluate one fitted material.

        Args:
            theta: parameters of one task, without a task axis.
            angles: theta_h, theta_d, phi_d, and phi_h, in rad, [..., 3 or 4]. An isotropic network does not read phi_h;
                for an anisotropic one it is 0 if it is left out.

        Returns:
            Linear RGB in 1/sr, [..., 3], >= 0.
        """
        batched = add_task_axis(theta)
        rows = angles.reshape(-1, angles.shape[-1])
        where = half_difference_and_cosine(rows if self.anisotropic else rows[:, :3])
        return self.reflectance(batched, where.T[None]).clamp_min(0)[0].T.reshape(*angles.shape[:-1], 3)

    def linear_features(self, theta: Params, where: Tensor) -> Tensor:
        """Return the features [T, F, N] that `linear_parameter` multiplies, at `where` [T, 7, N]."""
        raise NotImplementedError

    def conserve_energy(self, theta: Params) -> Params:
        """Return parameters [T, ...] with last layers by which materials reflect no more light than they receive.

        Only networks with `can_conserve_energy` have it.
        """
        raise NotImplementedError

    def hold_highlight(self, theta: Params, seen: Any) -> Params:
        """Keep fits [T, ...] from rising, towards mirror directions, above what samples carry. The default keeps fits.

        Args:
            theta: the fits.
            seen: the samples that the fits saw, a :class:`ReflectanceSamples`.
        """
        return theta

    @abstractmethod
    def fold(self, theta: Params) -> PlainLayers:
        """Return one material as plain layers.

        Args:
            theta: parameters of one task, without a task axis.
        """

    def augment(self, data: Params, rng: Generator) -> Params:
        """Change the samples of training materials at random, `where` [T, N, 7] and `target` [T, N, 3]."""
        return data


def put_distinct_first(samples: ReflectanceSamples) -> DistinctSamples:
    """Put different samples first among those that a fit sees, the first half, and count them.

    Args:
        samples: `where` [N, 7] and `target` [N, 3] of one material.

    >>> where = torch.tensor([[0.0], [0.0], [1.0], [2.0], [3.0], [4.0]]).expand(-1, 7)
    >>> samples = put_distinct_first(ReflectanceSamples(where, where[:, :3]))
    >>> samples.where[:2, 0].tolist(), float(samples.distinct)
    ([0.0, 1.0], 2.0)
    """
    where, half = samples.where, len(samples.where) // 2
    # one number for each pair of directions: a sum whose weights, roots of 1 to 7, are hardly ever in a simple ratio
    pair_numbers = where[:half].double() @ torch.arange(1.0, 1 + where.shape[1]).double().sqrt()
    _, pairs = torch.unique(pair_numbers, return_inverse=True)
    first_rows = torch.full((int(pairs.max()) + 1,), half).scatter_reduce(0, pairs, torch.arange(half), "amin")
    distinct = torch.tensor(float(len(first_rows)))
    if len(first_rows) == half:
        return DistinctSamples(*samples, distinct)
    order = torch.arange(len(where))
    order[: len(first_rows)] = first_rows.sort().values
    return DistinctSamples(where[order], samples.target[order], distinct)


@dataclass(frozen=True)
class SampleEncoder(Encoder[Any]):
    """The encoder of samples that a network brings."""

    samples = 1024

    @override
    def init(self, rng: Generator, decoder: BrdfNetwork) -> Params:
        return decoder.init_encoder(rng)

    @override
    def select_input(self, seen: Any) -> Batch:
        batch: Batch = seen._asdict()
        return batch

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: BrdfNetwork) -> Params:
        return decoder.encode(encoder, encoder_input)


def gather_samples(tasks: Tasks, rows: Tensor) -> ReflectanceSamples:
    """Return each task's samples at given indices.

    Args:
        tasks: T tasks.
        rows: indices of samples, [T, count].
    """
    task_rows = (tasks.rows[:, None], rows)
    return ReflectanceSamples(*(tasks.data[key][task_rows].transpose(1, 2).contiguous() for key in ("where", "target")))


@functools.cache
def parameter_shapes(network: BrdfNetwork) -> dict[str, tuple[int, ...]]:
    """Return the shape of each parameter of one task by name; the names tell a network's parameters from another's."""
    return {name: tuple(value.shape[1:]) for name, value in network.init(Generator().manual_seed(0), 1).items()}


def find_network(theta: Params) -> BrdfNetwork:
    """Return the network that parameters belong to, by their names.

    Raises:
        ValueError: no registered network has parameters of these names.
    """
    for network in registry().load_all("networks of brdf").values():
        if parameter_shapes(network).keys() == theta.keys():
            result: BrdfNetwork = network
            return result
    names = ", ".join(sorted(theta)) or "none"
    raise ValueError(f"parameters {names[:80]}, expected the parameters of a BRDF fit.")
