"""Light judged by three spheres: what does not count, and errors that are known in closed form."""

import math

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.latlong import sphere_normals
from metapp.appearance.metrics import rgb_angle_degrees, si_rmse
from metapp.appearance.reflection import fresnel_schlick
from metapp.apps.illumination.spheres import (
    METAL_REFLECTANCE,
    SPHERE_NAMES,
    SPHERE_PX,
    TONE_GAMMA,
    TONE_MEDIAN,
    sphere_errors,
)

KEYS = {f"{name}_{kind}" for name in SPHERE_NAMES for kind in ("rmse", "angle")}
WARM = torch.tensor([1.0, 0.6, 0.3])


def maps_of(seed: int, count: int = 2, height: int = 16) -> Tensor:
    """Colourful maps with a few bright texels."""
    drawn = torch.rand(count, 3, height, 2 * height, generator=Generator().manual_seed(seed))
    return 0.05 + drawn + 1000 * (drawn > 0.99)


def gray(seed: int) -> Tensor:
    return maps_of(seed).mean(1, keepdim=True).expand(-1, 3, -1, -1)


def degrees(one: Tensor, other: Tensor) -> float:
    """Between two RGB vectors."""
    return math.degrees(math.acos(float(one @ other / one.norm() / other.norm())))


def test_equal_maps_have_no_error() -> None:
    errors = sphere_errors(maps_of(0), maps_of(0))
    assert errors.keys() == KEYS
    for name, values in errors.items():
        assert values.shape == (2,), name
        assert values.abs().max() < 1e-4, name


@pytest.mark.parametrize("scale", [1e-3, 7.0, 1e4])
def test_the_scale_of_maps_does_not_count(scale: float) -> None:
    maps, target = maps_of(0), maps_of(1)
    errors = sphere_errors(maps, target)
    for changed in (sphere_errors(scale * maps, target), sphere_errors(maps, scale * target)):
        for name in KEYS:
            torch.testing.assert_close(changed[name], errors[name], rtol=1e-3, atol=1e-4)
    assert min(float(values.min()) for values in errors.values()) > 1e-3


def test_a_tinted_map_is_off_by_the_angle_of_its_tint() -> None:
    # a power of a product is a product of powers, and all reflectances are gray
    errors = sphere_errors(WARM[:, None, None] * gray(0), gray(0))
    known = degrees(WARM ** (1 / TONE_GAMMA), torch.ones(3))
    for name in SPHERE_NAMES:
        torch.testing.assert_close(errors[f"{name}_angle"], torch.full((2,), known), rtol=1e-4, atol=1e-3)


def test_errors_of_even_light_of_another_colour() -> None:
    even = torch.ones(1, 3, 16, 32)
    errors = sphere_errors(WARM[:, None, None] * even, even)
    known = math.radians(degrees(WARM ** (1 / TONE_GAMMA), torch.ones(3)))
    normals, mask = sphere_normals(SPHERE_PX)
    # of gray of 0.5 what is across the colour of the estimate stays, whatever that is scaled by
    across = math.sqrt(3) * TONE_MEDIAN * math.sin(known)
    reflectance = fresnel_schlick(normals[2], METAL_REFLECTANCE)[mask].square().mean().sqrt()
    torch.testing.assert_close(errors["mirror_rmse"], (across * reflectance)[None], rtol=1e-4, atol=0)
    torch.testing.assert_close(errors["silver_rmse"], (across * reflectance)[None], rtol=1e-4, atol=0)
    white = 0.8 + 0.2 * fresnel_schlick(normals[2], 0.04)[mask]
    torch.testing.assert_close(errors["diffuse_rmse"], (across * white.square().mean().sqrt())[None], rtol=1e-4, atol=0)


@pytest.mark.parametrize("which", ["maps", "target", "both"])
def test_black_maps_have_finite_errors(which: str) -> None:
    maps, target = maps_of(0), maps_of(1)
    black = torch.zeros_like(maps)
    errors = sphere_errors(maps if which == "target" else black, target if which == "maps" else black)
    for name, values in errors.items():
        assert torch.isfinite(values).all(), name
        if which == "both":
            assert values.max() == 0
        if name.endswith("angle") and which != "both":
            torch.testing.assert_close(values, torch.full((2,), 90.0))  # nothing is worse


def test_measures_of_pictures_in_closed_form() -> None:
    one, mask = torch.zeros(1, 3, 2, 2), torch.tensor([[True, True], [True, False]])
    one[0, 0], one[0, 1, 0, 0] = 2.0, 2.0
    other = torch.zeros(1, 3, 2, 2)
    other[0, 0], other[0, 2, 1, 1] = 1.0, 99.0  # the latter is masked
    torch.testing.assert_close(rgb_angle_degrees(one, other, mask), torch.tensor([45 / 3]))
    # the nearest multiple is 6 / 16 of it
    nearest, expected = 0.375 * one[..., mask], other[..., mask]
    torch.testing.assert_close(si_rmse(one, other, mask), ((nearest - expected) ** 2).sum().div(3).sqrt()[None])
    for scale in (0.1, 0.37, 0.38, 3.0):
        assert si_rmse(one, other, mask) <= ((scale * one[..., mask] - expected) ** 2).sum().div(3).sqrt()
