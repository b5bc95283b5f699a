"""Directions, reflection models and the reference sphere: identities, gradients, and Mitsuba's own values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from metapp import geometry as geo

KINDS: tuple[geo.MicrofacetKind, ...] = ("ggx", "beckmann")
ALPHAS = (0.03, 0.1, 0.3, 0.6)


@pytest.fixture
def rng() -> torch.Generator:
    return torch.Generator().manual_seed(3)


def random_angles(rng: torch.Generator, count: int = 4000, *, above: bool = True) -> Tensor:
    high = torch.tensor([math.pi / 2, math.pi / 2, math.pi], dtype=torch.float64)
    angles = 1e-4 + torch.rand(count, 3, generator=rng, dtype=torch.float64) * (high - 2e-4)
    return angles[geo.above_horizon(angles)] if above else angles


def random_directions(rng: torch.Generator, count: int = 1000) -> Tensor:
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=rng, dtype=torch.float64), dim=-1)
    directions[:, 2].abs_()
    return directions


# Directions and angles


def test_angles_survive_the_way_to_directions_and_back(rng: torch.Generator) -> None:
    angles = random_angles(rng, above=False)
    torch.testing.assert_close(
        geo.directions_to_rusinkiewicz(*geo.rusinkiewicz_to_directions(angles)), angles, rtol=0, atol=1e-10
    )


def test_directions_survive_up_to_isotropy_and_reciprocity(rng: torch.Generator) -> None:
    wi, wo = random_directions(rng), random_directions(rng)
    wi_back, wo_back = geo.rusinkiewicz_to_directions(geo.directions_to_rusinkiewicz(wi, wo))
    torch.testing.assert_close((wi_back * wo_back).sum(-1), (wi * wo).sum(-1), rtol=0, atol=1e-10)
    heights, heights_back = torch.stack([wi, wo])[..., 2], torch.stack([wi_back, wo_back])[..., 2]
    torch.testing.assert_close(heights_back.sort(0).values, heights.sort(0).values, rtol=0, atol=1e-10)


def test_swapping_or_turning_the_directions_changes_no_angle(rng: torch.Generator) -> None:
    wi, wo = random_directions(rng), random_directions(rng)
    angles = geo.directions_to_rusinkiewicz(wi, wo)
    assert ((angles[:, 2] >= 0) & (angles[:, 2] < math.pi)).all()
    torch.testing.assert_close(geo.directions_to_rusinkiewicz(wo, wi), angles, rtol=0, atol=1e-10)
    cosine, sine = math.cos(1.2), math.sin(1.2)
    turn = torch.tensor([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(geo.directions_to_rusinkiewicz(wi @ turn, wo @ turn), angles, rtol=0, atol=1e-10)


def test_half_and_difference_vectors_are_what_their_names_say(rng: torch.Generator) -> None:
    angles = random_angles(rng)
    wi, wo = geo.rusinkiewicz_to_directions(angles)
    half, difference = geo.half_difference(angles).split(3, -1)
    torch.testing.assert_close(half, torch.nn.functional.normalize(wi + wo, dim=-1), rtol=0, atol=1e-10)
    torch.testing.assert_close((wi * half).sum(-1), angles[:, 1].cos())
    torch.testing.assert_close((wo * half).sum(-1), angles[:, 1].cos())
    torch.testing.assert_close(difference.norm(dim=-1), torch.ones(len(angles), dtype=torch.float64))
    at = geo.cosines(angles)
    torch.testing.assert_close(at.incident, wi[:, 2], rtol=0, atol=1e-12)
    torch.testing.assert_close(at.outgoing, wo[:, 2], rtol=0, atol=1e-12)
    torch.testing.assert_close(geo.cos_incident(angles), wi[:, 2], rtol=0, atol=1e-12)


def test_known_directions() -> None:
    up, side = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
    torch.testing.assert_close(geo.directions_to_rusinkiewicz(up, up), torch.zeros(3))
    torch.testing.assert_close(geo.directions_to_rusinkiewicz(side, up)[:2], torch.full((2,), math.pi / 4))
    torch.testing.assert_close(geo.directions_to_rusinkiewicz(side, -side)[1], torch.tensor(math.pi / 2))
    wi, wo = geo.rusinkiewicz_to_directions(torch.tensor([0.5, 0.5, 0.0]))
    torch.testing.assert_close(wi, torch.tensor([math.sin(1), 0, math.cos(1)]))
    torch.testing.assert_close(wo, up)


def test_the_horizon(rng: torch.Generator) -> None:
    angles = random_angles(rng, above=False)
    wi, wo = geo.rusinkiewicz_to_directions(angles)
    assert torch.equal(geo.above_horizon(angles), (wi[:, 2] > 0) & (wo[:, 2] > 0))
    assert not geo.above_horizon(angles).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_where_angles_are_undefined(dtype: torch.dtype) -> None:
    up, side = torch.tensor([0.0, 0.0, 1.0], dtype=dtype), torch.tensor([1.0, 0.0, 0.0], dtype=dtype)
    slanted = torch.tensor([0.6, 0.0, 0.8], dtype=dtype)
    for one, other in [(up, up), (slanted, slanted), (slanted, slanted * torch.tensor([-1, 1, 1])), (side, up)]:
        wi, wo = one.clone().requires_grad_(), other.clone().requires_grad_()
        angles = geo.directions_to_rusinkiewicz(wi, wo)
        assert angles.isfinite().all()
        for gradient in torch.autograd.grad(angles.sum(), (wi, wo)):
            assert gradient.isfinite().all()


def test_direction_gradients(rng: torch.Generator) -> None:
    angles = random_angles(rng, 12).requires_grad_()
    assert torch.autograd.gradcheck(geo.rusinkiewicz_to_directions, angles)
    assert torch.autograd.gradcheck(geo.half_difference, angles)
    assert torch.autograd.gradcheck(geo.cosines, angles)
    wi, wo = (direction.detach().requires_grad_() for direction in geo.rusinkiewicz_to_directions(angles))
    assert torch.autograd.gradcheck(geo.directions_to_rusinkiewicz, (wi, wo))


def test_leading_axes_and_dtypes_pass_through(rng: torch.Generator) -> None:
    angles = random_angles(rng)[:24].float().reshape(2, 3, 4, 3)
    wi, wo = geo.rusinkiewicz_to_directions(angles)
    assert wi.shape == (2, 3, 4, 3)
    assert wi.dtype == torch.float32
    torch.testing.assert_close(geo.directions_to_rusinkiewicz(wi, wo), angles, rtol=0, atol=2e-3)  # 1e-7 / 1e-4
    alpha, f0 = torch.full((2, 3, 4), 0.3), torch.full((2, 3, 4, 3), 0.04)
    value = geo.microfacet_reflection(wi, wo, alpha, lambda cos: geo.fresnel_schlick(cos, f0))
    assert value.shape == (2, 3, 4, 3)
    assert value.dtype == torch.float32


# Fresnel


def test_fresnel_at_published_angles() -> None:
    one = torch.tensor(1.0, dtype=torch.float64)
    torch.testing.assert_close(geo.fresnel_dielectric(one, 1.5), one * 0.04)
    brewster = torch.tensor(math.cos(math.atan(1.5)), dtype=torch.float64)
    perpendicular = ((1 - 1.5**2) / (1 + 1.5**2)) ** 2  # parallel light passes entirely
    torch.testing.assert_close(geo.fresnel_dielectric(brewster, 1.5), one * perpendicular / 2)
    assert geo.fresnel_dielectric(one * 0.5, 1 / 1.5) == 1  # 60 degrees from within: beyond the critical angle
    torch.testing.assert_close(geo.fresnel_conductor(one, 0.2, 3.9), one * (0.8**2 + 3.9**2) / (1.2**2 + 3.9**2))
    torch.testing.assert_close(geo.fresnel_schlick(torch.tensor([0.0, 1.0]), 0.04), torch.tensor([1.0, 0.04]))


def test_fresnel_is_the_same_from_both_sides_and_for_conductors_that_do_not_absorb() -> None:
    cos = torch.linspace(0.01, 1, 50, dtype=torch.float64)
    within = (1 - (1 - cos**2) / 1.5**2).sqrt()
    reflectance = geo.fresnel_dielectric(cos, 1.5)
    torch.testing.assert_close(geo.fresnel_dielectric(within, 1 / 1.5), reflectance)
    torch.testing.assert_close(geo.fresnel_conductor(cos, 1.5, 0.0), reflectance)


@pytest.mark.parametrize("eta", [0.4, 1 / 1.49, 0.9, 1.1, 1.49, 2.5])
def test_diffuse_fresnel_is_the_integral(eta: float) -> None:
    cos = (torch.arange(200_000, dtype=torch.float64) + 0.5) / 200_000
    integral = (2 * cos * geo.fresnel_dielectric(cos, eta)).mean()
    torch.testing.assert_close(geo.fresnel_diffuse(eta), integral, rtol=1e-6, atol=0)


def test_fresnel_gradients() -> None:
    cos = torch.linspace(0.05, 0.95, 7, dtype=torch.float64, requires_grad=True)
    eta = torch.linspace(1.2, 2.2, 7, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(geo.fresnel_dielectric, (cos, eta))
    assert torch.autograd.gradcheck(geo.fresnel_conductor, (cos, eta, (3 * cos).detach().requires_grad_()))
    assert torch.autograd.gradcheck(geo.fresnel_schlick, (cos, (cos / 2).detach().requires_grad_()))
    assert torch.autograd.gradcheck(geo.fresnel_diffuse, eta)


# Microfacets


def hemisphere(narrowest: float, count: int = 96) -> tuple[Tensor, Tensor]:
    """Directions [N, 3] and solid angles [N], dense towards the normal, for lobes as narrow as `narrowest` rad."""
    nodes, weights = geo.gauss_legendre(count)
    reach = math.asinh(math.pi / 2 / narrowest)
    theta = narrowest * (nodes * reach).sinh()
    phi = (torch.arange(count, dtype=torch.float64) + 0.5) * math.tau / count
    solid_angle = (weights * narrowest * reach * (nodes * reach).cosh() * theta.sin() * math.tau / count)[:, None]
    sine, cosine = theta.sin()[:, None], theta.cos()[:, None].expand(-1, count)
    directions = torch.stack([sine * phi.cos(), sine * phi.sin(), cosine], dim=-1)
    return directions.reshape(-1, 3), solid_angle.expand(-1, count).reshape(-1)


def density(kind: geo.MicrofacetKind) -> Callable[[Tensor, Tensor | float], Tensor]:
    return geo.ggx_distribution if kind == "ggx" else geo.beckmann_distribution


def test_gauss_legendre_agrees_with_numpy() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(17)
    torch.testing.assert_close(geo.gauss_legendre(17)[0], torch.from_numpy((nodes + 1) / 2), rtol=0, atol=1e-14)
    torch.testing.assert_close(geo.gauss_legendre(17)[1], torch.from_numpy(weights / 2), rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_facets_cover_the_surface_once(kind: geo.MicrofacetKind, alpha: float) -> None:
    normals, solid_angle = hemisphere(alpha)
    covered = (density(kind)(normals[:, 2], alpha) * normals[:, 2] * solid_angle).sum()
    assert covered.item() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(("kind", "tolerance"), [("ggx", 2e-3), ("beckmann", 6e-3)])  # Walter's fit is that good
@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.6])
def test_visible_facets_have_the_projected_area_of_the_surface(
    kind: geo.MicrofacetKind, alpha: float, tolerance: float
) -> None:
    normals, solid_angle = hemisphere(alpha, 256)
    for cos in (0.2, 0.5, 0.9, 1.0):
        view = torch.tensor([math.sqrt(1 - cos * cos), 0, cos], dtype=torch.float64)
        projected = density(kind)(normals[:, 2], alpha) * (normals @ view).clamp_min(0) * solid_angle
        visible = geo.smith_masking(view[2], alpha, kind) * projected.sum()
        assert visible.item() == pytest.approx(cos, rel=tolerance)


@pytest.mark.parametrize("kind", KINDS)
def test_masking_is_total_under_the_horizon_and_absent_from_above(kind: geo.MicrofacetKind) -> None:
    masking = geo.smith_masking(torch.tensor([-0.5, 0.0, 1.0]), 0.4, kind)
    torch.testing.assert_close(masking, torch.tensor([0.0, 0.0, 1.0]))
    assert (geo.smith_masking(torch.linspace(0, 1, 200), 0.4, kind).diff() >= -1e-4).all()


def test_an_unknown_kind_of_facet_is_an_error() -> None:
    with pytest.raises(ValueError, match="'phong', expected 'ggx' or 'beckmann'"):
        geo.smith_masking(torch.ones(1), 0.1, "phong")  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_microfacets_are_reciprocal_and_finite_at_grazing_angles(
    kind: geo.MicrofacetKind, rng: torch.Generator
) -> None:
    wi, wo = geo.rusinkiewicz_to_directions(random_angles(rng))
    grazing = torch.tensor([[1.0, 0.0, 0.0], [math.sqrt(1 - 1e-12), 0.0, 1e-6], [0.6, 0.0, -0.8]], dtype=torch.float64)
    mirrored = grazing * torch.tensor([-1.0, 1.0, 1.0])
    wi, wo = torch.cat([wi, grazing]).requires_grad_(), torch.cat([wo, mirrored]).requires_grad_()
    value = geo.microfacet_reflection(wi, wo, 0.1, lambda cos: geo.fresnel_dielectric(cos, 1.5), kind)
    swapped = geo.microfacet_reflection(wo, wi, 0.1, lambda cos: geo.fresnel_dielectric(cos, 1.5), kind)
    torch.testing.assert_close(value, swapped)
    assert (value >= 0).all()
    assert value[-1] == 0
    assert all(gradient.isfinite().all() for gradient in torch.autograd.grad(value.sum(), (wi, wo)))


@pytest.mark.parametrize("kind", KINDS)
def test_microfacet_gradients(kind: geo.MicrofacetKind, rng: torch.Generator) -> None:
    angles = random_angles(rng, 12)
    wi, wo = (direction.requires_grad_() for direction in geo.rusinkiewicz_to_directions(angles))
    alpha = torch.linspace(0.2, 0.7, len(angles), dtype=torch.float64, requires_grad=True)
    f0 = torch.rand(len(angles), 3, generator=rng, dtype=torch.float64, requires_grad=True)

    def reflect(wi: Tensor, wo: Tensor, alpha: Tensor, f0: Tensor) -> Tensor:
        return geo.microfacet_reflection(wi, wo, alpha, lambda cos: geo.fresnel_schlick(cos, f0), kind)

    assert torch.autograd.gradcheck(reflect, (wi, wo, alpha, f0))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_rough_reflectance_is_the_integral_of_the_lobe(kind: geo.MicrofacetKind, alpha: float) -> None:
    def fresnel(cos: Tensor) -> Tensor:
        return geo.fresnel_dielectric(cos, 1.5)

    half, solid_angle = hemisphere(alpha, 160)
    for cos in (0.3, 0.6, 1.0):
        wi = torch.tensor([math.sqrt(1 - cos * cos), 0, cos], dtype=torch.float64).expand_as(half)
        cos_d = (half * wi).sum(-1, keepdim=True)
        wo = 2 * cos_d * half - wi
        lobe = geo.microfacet_reflection(wi, wo, alpha, fresnel, kind) * wo[:, 2:] * 4 * cos_d.clamp_min(0)
        quick = geo.rough_reflectance(wi[0, 2], alpha, fresnel, kind)
        torch.testing.assert_close(quick, (lobe * solid_angle[:, None]).sum(0), rtol=5e-3, atol=0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_a_rough_interface_becomes_a_smooth_one(kind: geo.MicrofacetKind, eta: float) -> None:
    cos = torch.tensor([0.3, 0.6, 0.9, 1.0], dtype=torch.float64)
    reflected = geo.rough_reflectance(cos, 0.001, lambda cos: geo.fresnel_dielectric(cos, eta), kind)[:, 0]
    passed = geo.rough_transmittance(cos, 0.001, eta, kind)
    torch.testing.assert_close(reflected, geo.fresnel_dielectric(cos, eta), rtol=0, atol=3e-3)
    torch.testing.assert_close(reflected + passed, torch.ones_like(cos), rtol=0, atol=3e-3)
    for alpha in ALPHAS:
        rough = geo.rough_reflectance(cos, alpha, lambda cos: geo.fresnel_dielectric(cos, eta), kind)[:, 0]
        assert (rough + geo.rough_transmittance(cos, alpha, eta, kind) < 1.005).all()


# Mitsuba as the judge


@pytest.fixture(scope="module")
def mitsuba() -> Iterator[Any]:
    import mitsuba as module

    before = module.variant()
    module.set_variant("scalar_rgb")
    yield module
    if before:
        module.set_variant(before)


def mitsuba_brdf(module: Any, bsdf: dict[str, Any], wi: Tensor, wo: Tensor) -> Tensor:
    """BRDF [N, 3] of Mitsuba's plugin, whose values include the cosine of the outgoing direction."""
    plugin, context, values = module.load_dict(bsdf), module.BSDFContext(), []
    for incident, outgoing in zip(wi.tolist(), wo.tolist(), strict=True):
        interaction = module.SurfaceInteraction3f()
        interaction.wi = module.Vector3f(incident)
        values.append(list(plugin.eval(context, interaction, module.Vector3f(outgoing))))
    return torch.tensor(values, dtype=torch.float64) / wo[:, 2:]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_microfacets_agree_with_mitsuba(
    mitsuba: Any, kind: geo.MicrofacetKind, alpha: float, rng: torch.Generator
) -> None:
    angles = random_angles(rng, 500)
    angles[::2, 0] *= 0.2  # half of them near the peak
    wi, wo = geo.rusinkiewicz_to_directions(angles[geo.above_horizon(angles)])
    common = {"alpha": alpha, "distribution": kind}
    metal = {"type": "roughconductor", "eta": 0.4, "k": 2.4, **common}
    value = geo.microfacet_reflection(wi, wo, alpha, lambda cos: geo.fresnel_conductor(cos, 0.4, 2.4), kind)
    # 1e-6: below it Mitsuba cuts its distribution off at 1e-20, far out in Beckmann's tail.
    torch.testing.assert_close(value.expand(-1, 3), mitsuba_brdf(mitsuba, metal, wi, wo), rtol=1e-4, atol=1e-6)
    coat = {"type": "roughplastic", "int_ior": 1.5, "ext_ior": 1.0, "diffuse_reflectance": 0.0, **common}
    value = geo.microfacet_reflection(wi, wo, alpha, lambda cos: geo.fresnel_dielectric(cos, 1.5), kind)
    torch.testing.assert_close(value.expand(-1, 3), mitsuba_brdf(mitsuba, coat, wi, wo), rtol=1e-4, atol=1e-6)


def test_the_body_of_smooth_plastic_agrees_with_mitsuba(mitsuba: Any, rng: torch.Generator) -> None:
    wi, wo = geo.rusinkiewicz_to_directions(random_angles(rng, 200))
    plugin = {"type": "plastic", "int_ior": 1.49, "ext_ior": 1.0, "nonlinear": True, "diffuse_reflectance": 0.7}
    passed = (1 - geo.fresnel_dielectric(wi[:, 2:], 1.49)) * (1 - geo.fresnel_dielectric(wo[:, 2:], 1.49))
    body = 0.7 / (1 - 0.7 * geo.fresnel_diffuse(1 / 1.49)) / 1.49**2 / math.pi * passed
    # Mitsuba fits the internal reflectance to 0.1 % (Egan and Hilgeman 1973); here it is exact.
    torch.testing.assert_close(body.expand(-1, 3), mitsuba_brdf(mitsuba, plugin, wi, wo), rtol=1e-3, atol=0)


# The reference sphere


@pytest.fixture(scope="module")
def scene() -> geo.SphereScene:
    return geo.sphere_scene(48, dtype=torch.float64)


def white(angles: Tensor) -> Tensor:
    return torch.full_like(angles, 0.8 / math.pi)


def test_the_sphere_fills_its_picture_and_is_well_exposed(scene: geo.SphereScene) -> None:
    assert scene.coverage.mean().item() == pytest.approx(math.pi / 4 * 0.96**2, rel=5e-3)
    assert scene.mask.sum() == len(scene.angles) == len(scene.weights)
    image = geo.shade_sphere(scene, white)
    assert image.shape == (48, 48, 4)
    torch.testing.assert_close(image[..., 3], scene.coverage)
    inside = image[scene.coverage == 1][:, :3]
    assert inside.mean(-1).max().item() == pytest.approx(0.85, abs=1e-6)
    assert 0.4 < inside.mean() < 0.7
    assert (image[~scene.mask] == 0).all()


def test_only_light_above_the_horizon_counts(scene: geo.SphereScene) -> None:
    lit = scene.weights.amax(-1) > 0
    assert (scene.weights >= 0).all()
    assert geo.above_horizon(scene.angles[lit]).all()
    assert scene.angles.shape[1] == 103
    assert scene.angles.isfinite().all()


def test_shading_is_the_weighted_sum_in_chunks_of_any_size(scene: geo.SphereScene) -> None:
    def glossy(angles: Tensor) -> Tensor:
        return geo.microfacet_lobe(
            geo.cosines(angles), 0.2, lambda cos: geo.fresnel_schlick(cos, cos.new_tensor([0.9, 0.6, 0.3]))
        )

    image = geo.shade_sphere(scene, glossy, chunk=1001)
    direct = (scene.weights * glossy(scene.angles)).sum(1) * scene.coverage[scene.mask][:, None]
    torch.testing.assert_close(image[scene.mask][:, :3], direct)


def test_the_sky_on_the_sphere_keeps_a_mirror_smooth(scene: geo.SphereScene) -> None:
    sky = scene._replace(angles=scene.angles[:, -42:], weights=scene.weights[:, -42:])

    def metal(alpha: float) -> Callable[[Tensor], Tensor]:
        return lambda angles: geo.microfacet_lobe(geo.cosines(angles), alpha, torch.ones_like).expand_as(angles)

    # Down the middle column: a dot of light would stand out from the sky's slow gradient.
    middle = geo.shade_sphere(sky, metal(0.03))[8:40, 24, 1]
    assert middle[0] > 5 * middle[-1]
    assert middle.diff(n=2).abs().max() < 0.01 * middle.max()


def test_shading_passes_gradients_to_the_material(scene: geo.SphereScene) -> None:
    albedo = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
    image = geo.shade_sphere(scene, lambda angles: albedo * torch.ones_like(angles))
    (gradient,) = torch.autograd.grad(image[..., :3].sum(), albedo)
    torch.testing.assert_close(gradient * 0.5, image[..., :3].sum().detach())


def test_the_sky_integrates_lobes_of_any_width() -> None:
    # At the centre of the sphere the sky's gradient cancels: a lobe sees its albedo times one and the same level.
    scene = geo.sphere_scene(49, dtype=torch.float64)
    centre = len(scene.angles) // 2
    angles, weights = scene.angles[centre, -42:], scene.weights[centre, -42:]
    levels = []
    for kind, alpha in [(kind, alpha) for kind in KINDS for alpha in ALPHAS]:
        lobe = geo.microfacet_lobe(geo.cosines(angles), alpha, torch.ones_like, kind)
        albedo = geo.rough_reflectance(torch.ones(1, dtype=torch.float64), alpha, torch.ones_like, kind)
        levels.append((weights * lobe).sum() / albedo.sum())
    assert max(levels) < 1.1 * min(levels)


def test_a_sphere_of_too_few_pixels_is_an_error() -> None:
    with pytest.raises(ValueError, match="4 pixels, expected at least 8"):
        geo.sphere_scene(4)
