"""Fresnel's equations and microfacets: identities, gradients, and Mitsuba's own values."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.interfaces import (
    fresnel_conductor,
    fresnel_dielectric,
    rough_reflectance,
    rough_transmittance,
    smith_masking,
)
from metapp.appearance.geometry import direction_cosines, gauss_legendre, is_above_horizon, rusinkiewicz_to_directions
from metapp.appearance.reflection import (
    Fresnel,
    MicrofacetKind,
    fresnel_schlick,
    microfacet_lobe,
)

RandomAngles = Callable[..., Tensor]
MitsubaBrdf = Callable[[dict[str, Any], Tensor, Tensor], Tensor]
KINDS: tuple[MicrofacetKind, ...] = ("ggx", "beckmann")
ALPHAS = (0.03, 0.1, 0.3, 0.6)


def glass(cos: Tensor) -> Tensor:
    return fresnel_dielectric(cos, 1.5)


def lobe(wi: Tensor, wo: Tensor, alpha: Tensor | float, fresnel: Fresnel, kind: MicrofacetKind = "ggx") -> Tensor:
    """The lobe of directions [..., 3] about the z axis."""
    return microfacet_lobe(direction_cosines(wi, wo, wi.new_tensor([0.0, 0.0, 1.0])), alpha, fresnel, kind)


# Fresnel


def test_fresnel_at_published_angles() -> None:
    one = torch.tensor(1.0, dtype=torch.float64)
    torch.testing.assert_close(fresnel_dielectric(one, 1.5), one * 0.04)
    brewster = torch.tensor(math.cos(math.atan(1.5)), dtype=torch.float64)
    perpendicular = ((1 - 1.5**2) / (1 + 1.5**2)) ** 2  # parallel light passes entirely
    torch.testing.assert_close(fresnel_dielectric(brewster, 1.5), one * perpendicular / 2)
    assert fresnel_dielectric(one * 0.5, 1 / 1.5) == 1  # 60 degrees from within: beyond the critical angle
    torch.testing.assert_close(fresnel_conductor(one, 0.2, 3.9), one * (0.8**2 + 3.9**2) / (1.2**2 + 3.9**2))
    torch.testing.assert_close(fresnel_schlick(torch.tensor([0.0, 1.0]), 0.04), torch.tensor([1.0, 0.04]))


def test_fresnel_agrees_from_both_sides_and_without_absorption() -> None:
    cos = torch.linspace(0.01, 1, 50, dtype=torch.float64)
    within = (1 - (1 - cos**2) / 1.5**2).sqrt()
    reflectance = fresnel_dielectric(cos, 1.5)
    torch.testing.assert_close(fresnel_dielectric(within, 1 / 1.5), reflectance)
    torch.testing.assert_close(fresnel_conductor(cos, 1.5, 0.0), reflectance)


# Microfacets


def hemisphere(narrowest: float, count: int = 96) -> tuple[Tensor, Tensor]:
    """Directions [N, 3] and solid angles [N], dense towards the normal, for lobes as narrow as `narrowest` rad."""
    nodes, weights = gauss_legendre(count)
    reach = math.asinh(math.pi / 2 / narrowest)
    theta = narrowest * (nodes * reach).sinh()
    phi = (torch.arange(count, dtype=torch.float64) + 0.5) * math.tau / count
    solid_angle = (weights * narrowest * reach * (nodes * reach).cosh() * theta.sin() * math.tau / count)[:, None]
    sine, cosine = theta.sin()[:, None], theta.cos()[:, None].expand(-1, count)
    directions = torch.stack([sine * phi.cos(), sine * phi.sin(), cosine], dim=-1)
    return directions.reshape(-1, 3), solid_angle.expand(-1, count).reshape(-1)


@pytest.mark.parametrize("kind", KINDS)
def test_masking_is_total_below_and_absent_from_above(kind: MicrofacetKind) -> None:
    masking = smith_masking(torch.tensor([-0.5, 0.0, 1.0]), 0.4, kind)
    torch.testing.assert_close(masking, torch.tensor([0.0, 0.0, 1.0]))
    assert (smith_masking(torch.linspace(0, 1, 200), 0.4, kind).diff() >= -1e-4).all()
    with pytest.raises(ValueError, match="'phong', expected 'ggx' or 'beckmann'"):
        smith_masking(torch.ones(1), 0.1, "phong")  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_microfacets_are_reciprocal_and_finite_at_grazing_angles(
    kind: MicrofacetKind, random_angles: RandomAngles
) -> None:
    wi, wo = rusinkiewicz_to_directions(random_angles())
    grazing = torch.tensor([[1.0, 0.0, 0.0], [math.sqrt(1 - 1e-12), 0.0, 1e-6], [0.6, 0.0, -0.8]], dtype=torch.float64)
    mirrored = grazing * torch.tensor([-1.0, 1.0, 1.0])
    wi, wo = torch.cat([wi, grazing]).requires_grad_(), torch.cat([wo, mirrored]).requires_grad_()
    value = lobe(wi, wo, 0.1, glass, kind)
    swapped = lobe(wo, wi, 0.1, glass, kind)
    torch.testing.assert_close(value, swapped)
    assert (value >= 0).all()
    assert value[-1] == 0
    assert all(gradient.isfinite().all() for gradient in torch.autograd.grad(value.sum(), (wi, wo)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_rough_reflectance_is_the_integral_of_the_lobe(kind: MicrofacetKind, alpha: float) -> None:
    half, solid_angle = hemisphere(alpha, 160)
    for cos in (0.3, 0.6, 1.0):
        wi = torch.tensor([math.sqrt(1 - cos * cos), 0, cos], dtype=torch.float64).expand_as(half)
        cos_d = (half * wi).sum(-1, keepdim=True)
        wo = 2 * cos_d * half - wi
        light = lobe(wi, wo, alpha, glass, kind) * wo[:, 2:] * 4 * cos_d.clamp_min(0)
        quick = rough_reflectance(wi[0, 2], alpha, glass, kind)
        torch.testing.assert_close(quick, (light * solid_angle[:, None]).sum(0), rtol=5e-3, atol=0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_a_rough_interface_becomes_a_smooth_one(kind: MicrofacetKind, eta: float) -> None:
    cos = torch.tensor([0.3, 0.6, 0.9, 1.0], dtype=torch.float64)
    reflected = rough_reflectance(cos, 0.001, lambda cos: fresnel_dielectric(cos, eta), kind)[:, 0]
    passed = rough_transmittance(cos, 0.001, eta, kind)
    torch.testing.assert_close(reflected, fresnel_dielectric(cos, eta), rtol=0, atol=3e-3)
    torch.testing.assert_close(reflected + passed, torch.ones_like(cos), rtol=0, atol=3e-3)
    for alpha in ALPHAS:
        rough = rough_reflectance(cos, alpha, lambda cos: fresnel_dielectric(cos, eta), kind)[:, 0]
        assert (rough + rough_transmittance(cos, alpha, eta, kind) < 1.005).all()


# Mitsuba as the judge


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_microfacets_agree_with_mitsuba(
    mitsuba_brdf: MitsubaBrdf, kind: MicrofacetKind, alpha: float, random_angles: RandomAngles
) -> None:
    angles = random_angles(500)
    angles[::2, 0] *= 0.2  # half of them near the peak
    wi, wo = rusinkiewicz_to_directions(angles[is_above_horizon(angles)])
    metal = {"type": "roughconductor", "eta": 0.4, "k": 2.4}
    coat = {"type": "roughplastic", "int_ior": 1.5, "ext_ior": 1.0, "diffuse_reflectance": 0.0}
    for plugin, fresnel in ((metal, lambda cos: fresnel_conductor(cos, 0.4, 2.4)), (coat, glass)):
        value = lobe(wi, wo, alpha, fresnel, kind).expand(-1, 3)
        expected = mitsuba_brdf({**plugin, "alpha": alpha, "distribution": kind}, wi, wo)
        # 1e-6: below it Mitsuba cuts its distribution off at 1e-20, far out in Beckmann's tail.
        torch.testing.assert_close(value, expected, rtol=1e-4, atol=1e-6, msg=plugin["type"])
