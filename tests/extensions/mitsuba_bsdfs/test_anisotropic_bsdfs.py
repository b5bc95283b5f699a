"""The plugin of anisotropic fits in Mitsuba: values and draws agree at any azimuth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.torch import save_file

from metapp.appearance.geometry import directions_to_four_angles, rusinkiewicz_to_directions
from tests import anisotropic
from tests.anisotropic import APP, VIEWERS, directions, viewer_at
from tests.bsdfs import assert_sampled_as_densely_as_it_says, seen_from
from tests.needs_mitsuba import needs_mitsuba

pytestmark = [needs_mitsuba, pytest.mark.long]


@pytest.fixture
def bsdf(mi: Any, tmp_path: Path) -> Any:
    save_file(anisotropic.fitted(), tmp_path / "fit.safetensors")
    return mi.load_dict({"type": "neural_brdf", "filename": str(tmp_path / "fit.safetensors")})


def test_the_plugin_evaluates_the_fit(mi: Any, bsdf: Any) -> None:
    wi, wo = (directions(5000, seed, 0.2) for seed in (3, 4))
    interaction = seen_from(mi, wo.T.float().numpy(), len(wi))
    found = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(wi.T.float().numpy())))
    theta = {key: value.double() for key, value in anisotropic.fitted().items()}
    expected = (APP.reflectance(theta, directions_to_four_angles(wi, wo)) * wi[:, 2:]).numpy().T
    assert (abs(found - expected) / (1 + abs(expected))).max() < 1e-4
    assert np.abs(expected).max() > 0.5
    other, _ = rusinkiewicz_to_directions(directions_to_four_angles(wo, wi))
    np.testing.assert_allclose(other.numpy(), wo.numpy(), atol=1e-6)
    bsdf.parameters_changed([])  # from memory
    again = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(wi.T.float().numpy())))
    np.testing.assert_allclose(again, found, 1e-3, 1e-5)


@pytest.mark.parametrize("degrees", VIEWERS[1:])
def test_the_plugin_samples_as_densely_as_it_says(
    mi: Any, bsdf: Any, degrees: tuple[float, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And with less noise than a diffuse lobe would have."""
    monkeypatch.chdir(tmp_path)
    viewer = viewer_at(degrees)
    assert_sampled_as_densely_as_it_says(mi, bsdf, viewer, samples=300_000, rings=16)
    numbers = np.random.default_rng(5).random((3, 40_000)).astype(np.float32)
    interaction = seen_from(mi, viewer, 40_000)
    _, weight = bsdf.sample(mi.BSDFContext(), interaction, mi.Float(numbers[0]), mi.Point2f(numbers[1:]))
    weight = np.array(weight)
    assert weight.std() < 1.5 * weight.mean()
    assert weight.mean() <= 1
