"""The reference sphere: its lights, its sky, its shading, and its scenes in the cache."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.interfaces import rough_reflectance
from metapp.appearance.geometry import above_horizon, cosines
from metapp.appearance.reflection import MicrofacetKind, fresnel_schlick, microfacet_lobe
from metapp.appearance.sphere import SphereScene, environment, environment_scene, shade_sphere, sphere_scene
from metapp.storage import cache as cache_files

KINDS: tuple[MicrofacetKind, ...] = ("ggx", "beckmann")
ALPHAS = (0.03, 0.1, 0.3, 0.6)


@pytest.fixture(scope="module")
def scene() -> SphereScene:
    return sphere_scene(48)


def test_only_light_above_the_horizon_counts(scene: SphereScene) -> None:
    lit = scene.weights.amax(-1) > 0
    assert (scene.weights >= 0).all()
    assert above_horizon(scene.angles[lit]).all()
    assert scene.angles.shape[1] == 103
    assert scene.angles.isfinite().all()


def test_shading_is_the_weighted_sum_in_chunks_of_any_size(scene: SphereScene) -> None:
    def glossy(angles: Tensor) -> Tensor:
        return microfacet_lobe(cosines(angles), 0.2, lambda cos: fresnel_schlick(cos, cos.new_tensor([0.9, 0.6, 0.3])))

    image = shade_sphere(scene, glossy, chunk=1001)
    direct = (scene.weights * glossy(scene.angles)).sum(1) * scene.coverage[scene.mask][:, None]
    torch.testing.assert_close(image[scene.mask][:, :3], direct)


def test_the_sky_integrates_lobes_of_any_width() -> None:
    # At the centre of the sphere the sky's gradient cancels: a lobe sees its albedo times one and the same level.
    scene = sphere_scene(49)
    centre = len(scene.angles) // 2
    angles, weights = scene.angles[centre, -42:], scene.weights[centre, -42:]
    levels = []
    for kind, alpha in [(kind, alpha) for kind in KINDS for alpha in ALPHAS]:
        lobe = microfacet_lobe(cosines(angles), alpha, torch.ones_like, kind)
        albedo = rough_reflectance(torch.ones(1, dtype=torch.float64), alpha, torch.ones_like, kind)
        levels.append((weights * lobe).sum() / albedo.sum())
    assert max(levels) < 1.1 * min(levels)


def test_the_environment_lights_a_white_sphere_as_a_fine_sum_over_directions_does() -> None:
    # irradiance of a diffuse surface: the rings of half vectors against a lat-long grid of the same map
    theta, phi = torch.meshgrid(
        (torch.arange(90, dtype=torch.float64) + 0.5) * math.pi / 90,
        (torch.arange(180, dtype=torch.float64) + 0.5) * math.tau / 180,
        indexing="ij",
    )
    grid = torch.stack([theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos()], -1).reshape(-1, 3)
    light = environment(grid) * (theta.sin() * (math.pi / 90) * (math.tau / 180)).reshape(-1, 1)
    scene = environment_scene()
    y, x = scene.mask.nonzero().T.double() + 0.5
    normal = torch.stack([x / 24 - 1, 1 - y / 24], -1) / 0.96
    inside = normal.square().sum(-1) < 0.8
    normal = torch.cat([normal, (1 - normal.square().sum(-1, keepdim=True)).clamp_min(0).sqrt()], -1)[inside]
    expected = (normal @ grid.T).clamp_min(0) @ light
    found = scene.weights.double().sum(1)[inside]
    ratio = found / expected
    ratio = ratio / ratio.median()
    assert (ratio - 1).abs().mean() < 0.05
    assert ratio.amin() > 0.8
    assert ratio.amax() < 1.2


@pytest.mark.parametrize("end", [0, 200, -1])
def test_what_is_kept_is_made_once_and_anew_where_its_file_is_damaged_or_of_other_code(
    end: int, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And every time where the cache cannot be written to."""
    calls: list[None] = []

    def make() -> dict[str, Tensor]:
        calls.append(None)
        return {"mask": torch.ones(3, dtype=torch.bool), "angles": torch.arange(6.0).reshape(2, 3).T}

    def same() -> None:
        found = cache_files.cached_tensors("some", [__file__], make)
        assert all(torch.equal(value, found[key]) and value.dtype == found[key].dtype for key, value in made.items())

    with monkeypatch.context() as patch:
        patch.setattr(cache_files, "_maker", lambda sources: "of another version")
        made = cache_files.cached_tensors("some", [__file__], make)
    for expected in (2, 3):
        for _ in range(2):
            same()
        assert len(calls) == expected
        path = cache / "some.safetensors"
        path.write_bytes(path.read_bytes()[:end])
    monkeypatch.setenv("METAPP_CACHE", str(path / "below"))
    for _ in range(2):
        same()
    assert len(calls) == 5
