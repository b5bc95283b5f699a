"""The plugin of Mitsuba on a fit by the model of few samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors.torch import save_file
from torch import Generator

from metapp.appearance.geometry import directions_to_full_circle
from metapp.extensions.few.network import NETWORK
from tests.needs_mitsuba import needs_mitsuba


def directions(count: int, seed: int) -> NDArray[np.float32]:
    """Unit vectors above the surface, [3, count]."""
    vectors = np.random.default_rng(seed).standard_normal((3, count))
    vectors[2] = abs(vectors[2])
    return (vectors / np.linalg.norm(vectors, axis=0)).astype(np.float32)


@needs_mitsuba
@pytest.mark.long
def test_a_fit_is_evaluated_as_it_is_without_mitsuba(mi: Any, tmp_path: Path) -> None:
    import drjit as dr

    theta = {key: value[0].clone() for key, value in NETWORK.init(Generator().manual_seed(0), 1).items()}
    theta["last"][0] = 0.3 * torch.randn(theta["last"].shape[1], generator=Generator().manual_seed(1))
    save_file(theta, tmp_path / "few.safetensors")
    bsdf = mi.load_dict({"type": "neural_brdf", "filename": str(tmp_path / "few.safetensors")})
    light, viewer, other = (directions(20_000, seed) for seed in (1, 2, 3))
    near = viewer * [[-1], [-1], [1]] + 0.01 * other  # beside the mirror direction
    light[:, ::2] = (near / np.linalg.norm(near, axis=0)).astype(np.float32)[:, ::2]
    interaction = dr.zeros(mi.SurfaceInteraction3f, light.shape[1])
    interaction.wi = mi.Vector3f(viewer)
    value = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(light)))
    angles = directions_to_full_circle(*(torch.from_numpy(each.T).double() for each in (light, viewer)))
    expected = NETWORK.evaluate({key: each.double() for key, each in theta.items()}, angles).numpy().T * light[2]
    error = np.max(np.abs(value - expected) / (1 + np.abs(expected)), axis=0)
    # in the last degree before the horizon directions of single precision say no more about their angles
    assert error[np.minimum(light[2], viewer[2]) > 0.02].max() < 1e-5
    assert error.max() < 5e-4  # it divides by both cosines
    assert expected.max() > 1
