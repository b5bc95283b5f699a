"""Measured BRDFs that are damaged, or in another unit, are warned of; sharp, bright and dark ones are not."""

import math
import warnings
from collections.abc import Callable

import numpy as np
import pytest
from torch import Tensor

from data_tools.readers.brdf_task import make_measured_task
from data_tools.readers.nbrdf_files import NBRDF_ARRAY_SHAPES, evaluate_nbrdf
from metapp.appearance.geometry import angle_cosines

SAMPLES = 4096
Evaluate = Callable[[Tensor], Tensor]


def microfacets(alpha: float, f0: float = 0.9, diffuse: float = 0.0, *, shadowed: bool = True) -> Evaluate:
    """GGX with Smith's shadowing and Schlick's Fresnel term; without shadowing it has no limit at the horizon."""

    def evaluate(angles: Tensor) -> Tensor:
        incident, outgoing, half, difference = (cos.clamp_min(1e-6) for cos in angle_cosines(angles.double()))
        ndf = alpha**2 / (math.pi * (half**2 * (alpha**2 - 1) + 1) ** 2)
        fresnel = f0 + (1 - f0) * (1 - difference) ** 5
        smith = [cos + (alpha**2 + (1 - alpha**2) * cos**2).sqrt() for cos in (incident, outgoing)]
        visible = 1 / (smith[0] * smith[1]) if shadowed else 1 / (4 * incident * outgoing)
        return (diffuse / math.pi + fresnel * ndf * visible).float()[..., None].expand(*angles.shape[:-1], 3)

    return evaluate


def velvet(gain: float) -> Evaluate:
    """A dark material that is bright at grazing angles alone."""
    return lambda angles: (gain / (1e-3 + angle_cosines(angles).outgoing.clamp_min(0)))[..., None].expand(
        *angles.shape[:-1], 3
    )


def network(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {part: rng.normal(0, 0.3, shape).astype(np.float32) for part, shape in NBRDF_ARRAY_SHAPES.items()}


def byte_swapped_network(seed: int) -> Evaluate:
    """A network whose bytes were read in the other order."""
    weights = network(np.random.default_rng(seed))
    return lambda angles: evaluate_nbrdf({part: array.byteswap() for part, array in weights.items()}, angles)


def noise(seed: int) -> Evaluate:
    """A network of random bytes."""
    rng = np.random.default_rng(seed)
    weights = {
        part: rng.integers(2**32, size=shape, dtype=np.uint32).view("f4") for part, shape in NBRDF_ARRAY_SHAPES.items()
    }
    return lambda angles: evaluate_nbrdf(weights, angles)


def shifted_network(seed: int) -> Evaluate:
    """A network whose numbers stand one place further, in files that begin with a value in the thousands."""
    weights = network(np.random.default_rng(seed))
    first = {part: np.concatenate([[3000.0], array.flatten()[:-1]]) for part, array in weights.items()}
    moved = {part: first[part].reshape(shape).astype(np.float32) for part, shape in NBRDF_ARRAY_SHAPES.items()}
    return lambda angles: evaluate_nbrdf(moved, angles)


def times(factor: float, evaluate: Evaluate) -> Evaluate:
    return lambda angles: factor * evaluate(angles)


SOUND = {
    **{f"metal {alpha}": microfacets(alpha) for alpha in (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 0.6, 1.0)},
    **{f"varnish {alpha}": microfacets(alpha, 0.04, 0.5) for alpha in (0.001, 0.01, 0.1, 0.5)},
    **{f"unshadowed {alpha}": microfacets(alpha, 0.1, shadowed=False) for alpha in (0.001, 0.01, 0.1)},
    "chalk": microfacets(1.0, 0.0, 0.99),
    "black": microfacets(0.5, 0.02, 0.001),
    "velvet": velvet(0.01),
    "darker velvet": velvet(1e-4),
    "a random network": lambda angles: evaluate_nbrdf(network(np.random.default_rng(3)), angles).clamp_max(0.6),
}
DAMAGED = {
    **{f"byte order {seed}": byte_swapped_network(seed) for seed in range(4)},
    **{f"random bytes {seed}": noise(seed) for seed in range(4)},
    **{f"shifted {seed}": shifted_network(seed) for seed in range(4)},
    **{f"unscaled {alpha}": times(1500, microfacets(alpha, 0.04, 0.3)) for alpha in (0.05, 0.2, 0.8)},
    **{f"percent {alpha}": times(100, microfacets(alpha)) for alpha in (0.01, 0.1, 0.5)},
    "bytes of 8 bits": times(255, microfacets(0.3, 0.04, 0.3)),
    "nothing": times(0, microfacets(0.3)),
}


def message_about(evaluate: Evaluate) -> list[str]:
    """Return what is said of a material: warnings, or the error that refuses it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            make_measured_task("x", evaluate, SAMPLES, "x")
        except ValueError as error:
            return [str(error)]
    return [str(warning.message) for warning in caught if issubclass(warning.category, UserWarning)]


@pytest.mark.parametrize("name", SOUND)
def test_sound_materials_are_not_warned_of(name: str) -> None:
    assert message_about(SOUND[name]) == []


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_materials_cause_a_warning_in_one_line(name: str) -> None:
    (line,) = message_about(DAMAGED[name])
    assert line.startswith("x: ")
    assert "is it damaged, or in another unit?" in line or "NaN or infinite" in line
