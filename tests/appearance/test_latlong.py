"""Lat-long maps: agreement with Mitsuba, energy, closed forms of diffuse light, symmetries and gradients."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from metapp.appearance.latlong import (
    cosine_transfer,
    glossy_transfer,
    level_maps,
    luminance,
    mean_luminance,
    resample_maps,
    solid_angles,
    sphere_normals,
    texel_directions,
    texel_index,
)

SIZES = [(2, 4), (5, 10), (16, 32), (64, 128), (64, 96)]


def draw_normals(rng: torch.Generator, count: int = 40, facing: bool = False) -> Tensor:
    """Random unit vectors, float64 [count, 3]; with z > 0.1 if they face the viewer."""
    normals = torch.randn(count, 3, generator=rng, dtype=torch.float64)
    if facing:
        normals[:, 2] = normals[:, 2].abs() + 0.1 * normals.norm(dim=-1)
    return normalize(normals, dim=-1)


def draw_maps(rng: torch.Generator, height: int, width: int, *batch: int) -> Tensor:
    return torch.rand(*batch, 3, height, width, generator=rng, dtype=torch.float64)


def shine(transfer: Tensor, maps: Tensor) -> Tensor:
    """Radiance [P, 3] through a transfer matrix."""
    return transfer @ maps.flatten(-2).mT


def energy(maps: Tensor) -> Tensor:
    """Radiance times solid angle over the sphere, [3]."""
    return (maps * solid_angles(*maps.shape[-2:], dtype=maps.dtype)).sum((-2, -1))


# Directions


def test_rows_and_columns_lie_where_mitsuba_has_them(mitsuba: Any, rng: torch.Generator) -> None:
    """Of one map each column is another colour; another rises evenly with the angle from the top pole.

    Mitsuba's first and last rows are the poles themselves, and it interpolates.
    """
    columns = draw_maps(rng, 1, 12).expand(3, 6, 12)
    rising = torch.linspace(0, 1, 7, dtype=torch.float64)[:, None].expand(3, 7, 14)
    angles = ((torch.arange(6, dtype=torch.float64) + 0.5) / 6)[:, None].expand(3, 6, 12)
    for maps, expected in ((columns, columns), (rising, angles)):
        pixels = np.ascontiguousarray(maps.float().permute(1, 2, 0).numpy())
        emitter: Any = mitsuba.load_dict({"type": "envmap", "bitmap": mitsuba.Bitmap(pixels)})
        seen = []
        for direction in texel_directions(6, 12, dtype=torch.float64).flatten(1).T.tolist():
            interaction = mitsuba.SurfaceInteraction3f()
            interaction.wi = -mitsuba.Vector3f(direction)
            seen.append(list(emitter.eval(interaction)))
        torch.testing.assert_close(torch.tensor(seen).T.reshape(3, 6, 12).double(), expected, atol=2e-6, rtol=0)


@pytest.mark.parametrize("size", SIZES)
def test_solid_angles_cover_the_sphere(size: tuple[int, int]) -> None:
    height, width = size
    exact = solid_angles(height, width, dtype=torch.float64)
    assert exact.shape == (height, 1)
    assert exact.sum().item() * width == pytest.approx(4 * math.pi, rel=1e-13)
    assert solid_angles(height, width).sum().item() * width == pytest.approx(4 * math.pi, rel=1e-6)
    # Archimedes: a band's area is its height.
    assert exact[: height // 2].sum().item() * width == pytest.approx(
        2 * math.pi * (1 - math.cos(math.pi * (height // 2) / height)), rel=1e-13
    )


def test_luminance_weights_channels_and_solid_angles() -> None:
    gray = torch.full((2, 3, 4, 8), 0.7, dtype=torch.float64)
    torch.testing.assert_close(luminance(gray), gray[:, 0])
    torch.testing.assert_close(mean_luminance(gray), gray[:, 0, 0, 0])
    green = torch.zeros(3, 4, 8)
    green[1, 0, 0] = 1e5
    expected = 0.7152e5 * solid_angles(4, 8)[0, 0].item() / (4 * math.pi)
    assert mean_luminance(green).item() == pytest.approx(expected, rel=1e-6)


# Resampling and rotation


@pytest.mark.parametrize("source", [(16, 32), (13, 26)])
@pytest.mark.parametrize("target", [(4, 8), (5, 9), (16, 32), (32, 64), (23, 50)])
def test_resampling_keeps_energy(source: tuple[int, int], target: tuple[int, int], rng: torch.Generator) -> None:
    maps = draw_maps(rng, *source, 2)
    other = resample_maps(maps, *target)
    assert other.shape == (2, 3, *target)
    torch.testing.assert_close(energy(other), energy(maps))
    torch.testing.assert_close(resample_maps(torch.ones_like(maps), *target), torch.ones_like(other))
    assert other.min() >= maps.min() - 1e-12
    assert other.max() <= maps.max() + 1e-12


# Light on a sphere


def smooth_map(directions: Tensor) -> Tensor:
    """A radiance [3, H, W] that changes slowly with the direction [3, H, W]."""
    return torch.stack([1 + directions[0], 2 + directions[1] * directions[2], 1.5 - directions[2]])


@pytest.mark.parametrize("pitch_degrees", [-50.0, 0.0, 20.0, 89.0])
def test_levelled_maps_have_light_where_it_comes_from(pitch_degrees: float) -> None:
    pitch = math.radians(pitch_degrees)
    world = texel_directions(64, 128, dtype=torch.float64)
    # the axes of a camera above: right, up in its picture, and back to the camera
    axes = [(1.0, 0.0, 0.0), (0.0, math.cos(pitch), -math.sin(pitch)), (0.0, math.sin(pitch), math.cos(pitch))]
    recorded = torch.tensordot(torch.tensor(axes, dtype=torch.float64), world, 1)
    levelled = level_maps(smooth_map(world)[None], pitch)[0]
    torch.testing.assert_close(levelled, smooth_map(recorded), atol=0.02, rtol=0)


def test_the_sphere_touches_its_picture() -> None:
    normals, mask = sphere_normals(64, dtype=torch.float64)
    assert normals.shape == (3, 64, 64)
    torch.testing.assert_close(normals.norm(dim=0), torch.ones(64, 64, dtype=torch.float64))
    assert mask.float().mean().item() == pytest.approx(math.pi / 4, rel=0.01)
    assert mask[0, 31:33].all()
    assert not mask[0, 0]
    assert (normals[2] > 0).equal(mask)
    assert normals[1, 0, 32] > 0.9  # y is up, x is right
    assert normals[0, 32, 63] > 0.9
    assert torch.equal(normals.flip(-1)[1:], normals[1:])


def harmonics(at: Tensor) -> dict[int, Tensor]:
    """Real spherical harmonics of degree 0 to 3, unnormalised, of vectors [..., 3]: some each, [K, ...]."""
    x, y, z = at.unbind(-1)
    second = torch.stack([x * y, y * z, z * x, x * x - z * z, 3 * y * y - 1])
    third = torch.stack([x * y * z, y * (5 * y * y - 3), x * (5 * y * y - 1)])
    return {0: torch.ones_like(x)[None], 1: torch.stack([x, y, z]), 2: second, 3: third}


def cosine_error(height: int, normals: Tensor) -> float:
    """Greatest deviation of diffuse light of spherical harmonics from the closed form."""
    width = 2 * height
    maps = harmonics(texel_directions(height, width, dtype=torch.float64).permute(1, 2, 0))
    transfer = cosine_transfer(normals, height, width)
    # Ramamoorthi and Hanrahan 2001, "An Efficient Representation for Irradiance Environment Maps", over pi
    factors = {0: 1.0, 1: 2 / 3, 2: 1 / 4, 3: 0.0}
    exact = harmonics(normals)
    return max(float((shine(transfer, maps[i]) - factors[i] * exact[i].T).abs().max()) for i in factors)


def test_diffuse_light_of_spherical_harmonics(rng: torch.Generator) -> None:
    normals = draw_normals(rng, 200)
    errors = {height: cosine_error(height, normals) for height in (8, 16, 32, 64)}
    assert errors[8] < 0.05
    assert errors[64] < 0.05 / 64  # in proportion to a texel's area
    assert errors[8] > 2 * errors[16] > 4 * errors[32] > 8 * errors[64]


@pytest.mark.parametrize("roughness", [0.25, 0.7])
def test_lobe_agrees_with_mitsuba(roughness: float, mitsuba_brdf: Callable, rng: torch.Generator) -> None:
    normals = draw_normals(rng, 6, facing=True)
    to_light = texel_directions(8, 16, dtype=torch.float64).flatten(1).T
    weights = solid_angles(8, 16, dtype=torch.float64).expand(8, 16).flatten()
    plugin = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": roughness**2}
    for normal, row in zip(normals, glossy_transfer(normals, roughness, 8, 16), strict=True):
        tangent = normalize(torch.linalg.cross(normal, normal.new_tensor([0.0, 1.0, 0.0])), dim=0)
        frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal])
        lit = to_light @ normal > 0
        wi, wo = to_light[lit] @ frame.T, frame[:, 2].expand(int(lit.sum()), 3)
        expected = mitsuba_brdf(plugin, wo, wi)[:, 0] * wi[:, 2] * weights[lit]
        torch.testing.assert_close(row[lit], expected / expected.sum(), rtol=1e-3, atol=1e-6)


def test_samples_within_a_texel_are_texels_of_a_finer_map(rng: torch.Generator) -> None:
    normals, maps = draw_normals(rng, facing=True), draw_maps(rng, 8, 16)
    finer = shine(glossy_transfer(normals, 0.3, 24, 48), resample_maps(maps, 24, 48))
    torch.testing.assert_close(shine(glossy_transfer(normals, 0.3, 8, 16, samples=3), maps), finer)


# Gradients


def test_a_direction_lies_in_the_texel_that_it_is_the_centre_of() -> None:
    found = texel_index(texel_directions(8, 16), 8, 16)
    assert torch.equal(found, torch.arange(8 * 16).reshape(8, 16))
    assert int(texel_index(torch.tensor([0.0, -1.0, 0.0]), 8, 16)) // 16 == 7  # the pole below
