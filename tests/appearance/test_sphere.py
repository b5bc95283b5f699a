"""The reference sphere: its lights, its sky, its shading, and its scenes in the cache."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.interfaces import rough_reflectance
from metapp.appearance.geometry import (
    angle_cosines,
    directions_to_rusinkiewicz,
    half_difference_vectors,
    is_above_horizon,
    rusinkiewicz_to_directions,
)
from metapp.appearance.reflection import MicrofacetKind, fresnel_schlick, microfacet_lobe
from metapp.appearance.sphere import SphereScene, environment_radiance, environment_scene, reference_scene, shade_sphere
from metapp.storage import tensor_cache as cache_files

KINDS: tuple[MicrofacetKind, ...] = ("ggx", "beckmann")
ALPHAS = (0.03, 0.1, 0.3, 0.6)


@pytest.fixture(scope="module")
def scene() -> SphereScene:
    return reference_scene(48)


def test_only_light_above_the_horizon_counts(scene: SphereScene) -> None:
    lit = scene.weights.amax(-1) > 0
    assert (scene.weights >= 0).all()
    assert is_above_horizon(scene.angles[lit]).all()
    assert scene.angles.shape[1] == 103
    assert scene.angles.isfinite().all()


def test_shading_is_the_weighted_sum_in_chunks_of_any_size(scene: SphereScene) -> None:
    def glossy(angles: Tensor) -> Tensor:
        return microfacet_lobe(
            angle_cosines(angles), 0.2, lambda cos: fresnel_schlick(cos, cos.new_tensor([0.9, 0.6, 0.3]))
        )

    image = shade_sphere(scene, glossy, chunk=1001)
    direct = (scene.weights * glossy(scene.angles)).sum(1) * scene.coverage[scene.mask][:, None]
    torch.testing.assert_close(image[scene.mask][:, :3], direct)


def test_the_sky_integrates_lobes_of_any_width() -> None:
    # At the centre of the sphere the sky's gradient cancels: a lobe sees its albedo times one and the same level.
    scene = reference_scene(49)
    centre = len(scene.angles) // 2
    angles, weights = (part[centre, -42:].double() for part in (scene.angles, scene.weights))
    levels = []
    for kind, alpha in [(kind, alpha) for kind in KINDS for alpha in ALPHAS]:
        lobe = microfacet_lobe(angle_cosines(angles), alpha, torch.ones_like, kind)
        albedo = rough_reflectance(torch.ones(1, dtype=torch.float64), alpha, torch.ones_like, kind)
        levels.append((weights * lobe).sum() / albedo.sum())
    assert max(levels) < 1.1 * min(levels)


def test_the_environments_irradiance_is_that_of_a_fine_grid() -> None:
    # irradiance of a diffuse surface: the rings of half vectors against a lat-long grid of the same map
    theta, phi = torch.meshgrid(
        (torch.arange(90, dtype=torch.float64) + 0.5) * math.pi / 90,
        (torch.arange(180, dtype=torch.float64) + 0.5) * math.tau / 180,
        indexing="ij",
    )
    grid = torch.stack([theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos()], -1).reshape(-1, 3)
    light = environment_radiance(grid) * (theta.sin() * (math.pi / 90) * (math.tau / 180)).reshape(-1, 1)
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
def test_cached_tensors_are_remade_if_damaged_or_of_other_code(
    end: int, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the cache cannot be written to, they are computed every time."""
    calls: list[None] = []

    def make() -> dict[str, Tensor]:
        calls.append(None)
        return {"mask": torch.ones(3, dtype=torch.bool), "angles": torch.arange(6.0).reshape(2, 3).T}

    def same() -> None:
        found = cache_files.load_or_compute_tensors("some", [__file__], make)
        assert all(torch.equal(value, found[key]) and value.dtype == found[key].dtype for key, value in result.items())

    with monkeypatch.context() as patch:
        patch.setattr(cache_files, "_maker", lambda sources: "of another version")
        result = cache_files.load_or_compute_tensors("some", [__file__], make)
    for expected in (2, 3):
        for _ in range(2):
            same()
        assert len(calls) == expected
        path = cache / "some.safetensors"
        path.write_bytes(path.read_bytes()[:end])
    monkeypatch.setenv("METAPP_CACHE", str(path / "below"))
    with pytest.warns(UserWarning, match="temporary folder"):
        same()
    same()
    assert len(calls) == 4


# Directions and angles


RandomAngles = Callable[..., Tensor]


def random_directions(rng: torch.Generator, count: int = 1000) -> Tensor:
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=rng, dtype=torch.float64), dim=-1)
    directions[:, 2].abs_()
    return directions


def test_angles_survive_the_way_to_directions_and_back(random_angles: RandomAngles) -> None:
    angles = random_angles(above=False)
    wi, wo = rusinkiewicz_to_directions(angles)
    torch.testing.assert_close(directions_to_rusinkiewicz(wi, wo), angles, rtol=0, atol=1e-10)
    assert torch.equal(is_above_horizon(angles), (wi[:, 2] > 0) & (wo[:, 2] > 0))
    assert not is_above_horizon(angles).all()


def test_swapping_or_turning_the_directions_changes_no_angle(rng: torch.Generator) -> None:
    wi, wo = random_directions(rng), random_directions(rng)
    angles = directions_to_rusinkiewicz(wi, wo)
    assert ((angles[:, 2] >= 0) & (angles[:, 2] < math.pi)).all()
    torch.testing.assert_close(directions_to_rusinkiewicz(wo, wi), angles, rtol=0, atol=1e-10)
    cosine, sine = math.cos(1.2), math.sin(1.2)
    turn = torch.tensor([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(directions_to_rusinkiewicz(wi @ turn, wo @ turn), angles, rtol=0, atol=1e-10)


def test_half_and_difference_vectors_are_what_their_names_say(random_angles: RandomAngles) -> None:
    angles = random_angles()
    wi, wo = rusinkiewicz_to_directions(angles)
    half, difference = half_difference_vectors(angles).split(3, -1)
    torch.testing.assert_close(half, torch.nn.functional.normalize(wi + wo, dim=-1), rtol=0, atol=1e-10)
    torch.testing.assert_close((wi * half).sum(-1), angles[:, 1].cos())
    torch.testing.assert_close((wo * half).sum(-1), angles[:, 1].cos())
    torch.testing.assert_close(difference.norm(dim=-1), torch.ones(len(angles), dtype=torch.float64))
    at = angle_cosines(angles)
    torch.testing.assert_close(at.incident, wi[:, 2], rtol=0, atol=1e-12)
    torch.testing.assert_close(at.outgoing, wo[:, 2], rtol=0, atol=1e-12)


def test_angles_of_known_directions_agree_with_worked_values() -> None:
    up, side = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
    torch.testing.assert_close(directions_to_rusinkiewicz(up, up), torch.zeros(3))
    torch.testing.assert_close(directions_to_rusinkiewicz(side, up)[:2], torch.full((2,), math.pi / 4))
    torch.testing.assert_close(directions_to_rusinkiewicz(side, -side)[1], torch.tensor(math.pi / 2))
    wi, wo = rusinkiewicz_to_directions(torch.tensor([0.5, 0.5, 0.0]))
    torch.testing.assert_close(wi, torch.tensor([math.sin(1), 0, math.cos(1)]))
    torch.testing.assert_close(wo, up)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_where_angles_are_undefined(dtype: torch.dtype) -> None:
    up, side = torch.tensor([0.0, 0.0, 1.0], dtype=dtype), torch.tensor([1.0, 0.0, 0.0], dtype=dtype)
    slanted = torch.tensor([0.6, 0.0, 0.8], dtype=dtype)
    for first, other in [(up, up), (slanted, slanted), (slanted, slanted * torch.tensor([-1, 1, 1])), (side, up)]:
        wi, wo = first.clone().requires_grad_(), other.clone().requires_grad_()
        angles = directions_to_rusinkiewicz(wi, wo)
        assert angles.isfinite().all()
        for gradient in torch.autograd.grad(angles.sum(), (wi, wo)):
            assert gradient.isfinite().all()
