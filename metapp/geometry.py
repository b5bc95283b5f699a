"""Directions at a surface, the reflection of rough interfaces, and a sphere to look at them on.

Everything is differentiable and takes any leading axes, dtype and device. Directions are unit vectors of the local
frame, z the surface normal; `wi` points to the light, `wo` to the viewer. Angles are (theta_h, theta_d, phi_d) in rad
after Rusinkiewicz, "A New Change of Variables for Efficient BRDF Representation" (1998), with phi_h = 0: isotropic.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from torch import Tensor

MicrofacetKind = Literal["ggx", "beckmann"]
Fresnel = Callable[[Tensor], Tensor]  # cosines [..., 1] -> reflectance [..., C]


class Cosines(NamedTuple):
    """What an isotropic reflection model needs of a pair of directions; each [...], below zero under the horizon."""

    incident: Tensor
    outgoing: Tensor
    half: Tensor
    difference: Tensor


def _length(vectors: Tensor) -> Tensor:
    # The clamp keeps the gradient of the square root finite (and zero) at the zero vector.
    return (vectors * vectors).sum(-1).clamp_min(torch.finfo(vectors.dtype).tiny).sqrt()


def _difference(angles: Tensor) -> Tensor:
    _, theta_d, phi_d = angles.unbind(-1)
    return torch.stack(
        [theta_d.sin() * phi_d.cos(), theta_d.sin() * phi_d.sin(), theta_d.cos()],
        dim=-1,
    )


def _turn_about_y(vectors: Tensor, cosine: Tensor, sine: Tensor) -> Tensor:
    x, y, z = vectors.unbind(-1)
    return torch.stack([cosine * x + sine * z, y, cosine * z - sine * x], dim=-1)


def rusinkiewicz_to_directions(angles: Tensor) -> tuple[Tensor, Tensor]:
    """Half and difference angles to the two directions.

    Args:
        angles: [..., 3], (theta_h, theta_d, phi_d) in rad, phi_h = 0.

    Returns:
        wi and wo, [..., 3] each, unit length; below the horizon where the angles say so.
    """
    theta_h, difference = angles[..., 0], _difference(angles)
    mirrored = difference * difference.new_tensor([-1.0, -1.0, 1.0])
    cosine, sine = theta_h.cos(), theta_h.sin()
    return _turn_about_y(difference, cosine, sine), _turn_about_y(mirrored, cosine, sine)


def directions_to_rusinkiewicz(wi: Tensor, wo: Tensor) -> Tensor:
    """Two directions to half and difference angles; gradients are finite also where an angle is undefined.

    Args:
        wi: [..., 3], unit length.
        wo: [..., 3], unit length.

    Returns:
        angles [..., 3] in rad: theta_h and theta_d in [0, pi/2] above the horizon, phi_d in [0, pi): by reciprocity
        (swapping wi and wo adds pi to phi_d) the other half of the circle says the same.
    """
    total = wi + wo
    x, y, z = total.unbind(-1)
    sine = _length(total[..., :2])  # of theta_h, times the length of `total`, as is z of its cosine
    theta_h = torch.atan2(sine, z)
    theta_d = torch.atan2(_length(wi - wo), _length(total))
    # Where the half vector is the normal, or there is none, any azimuth will do: 0.
    tiny = torch.finfo(total.dtype).tiny
    azimuthal = x * x + y * y > tiny
    cos_phi, sin_phi = torch.where(azimuthal, x / sine, 1.0), torch.where(azimuthal, y / sine, 0.0)
    turned = torch.stack([cos_phi * wi[..., 0] + sin_phi * wi[..., 1], cos_phi * wi[..., 1] - sin_phi * wi[..., 0]])
    difference_x = theta_h.cos() * turned[0] - theta_h.sin() * wi[..., 2]
    differs = difference_x * difference_x + turned[1] * turned[1] > tiny
    phi_d = torch.atan2(torch.where(differs, turned[1], 0.0), torch.where(differs, difference_x, 1.0))
    phi_d = torch.where(phi_d < 0, phi_d + math.pi, phi_d)
    phi_d = torch.where(phi_d >= math.pi, 0.0, phi_d)  # a tiny negative angle rounds up to pi itself
    return torch.stack([theta_h, theta_d, phi_d], dim=-1)


def half_difference(angles: Tensor) -> Tensor:
    """Half and difference vectors, the input of the network of Sztrajman et al., "Neural BRDF ..." (2021).

    Args:
        angles: [..., 3] in rad.

    Returns:
        [..., 6]: half vector (sin theta_h, 0, cos theta_h), then difference vector, each of unit length.
    """
    theta_h = angles[..., 0]
    half = torch.stack([theta_h.sin(), torch.zeros_like(theta_h), theta_h.cos()], dim=-1)
    return torch.cat([half, _difference(angles)], dim=-1)


def cosines(angles: Tensor) -> Cosines:
    """The four cosines of half and difference angles [..., 3] in rad, without forming directions."""
    theta_h, theta_d, phi_d = angles.unbind(-1)
    half, difference = theta_h.cos(), theta_d.cos()
    common, apart = difference * half, theta_d.sin() * phi_d.cos() * theta_h.sin()
    return Cosines(common - apart, common + apart, half, difference)


def cos_incident(angles: Tensor) -> Tensor:
    """Cosine of the incident direction with the normal, [...], of angles [..., 3] in rad; below 0 under the horizon."""
    return cosines(angles).incident


def above_horizon(angles: Tensor) -> Tensor:
    """Whether both directions are above the surface: bool [...] of angles [..., 3] in rad."""
    at = cosines(angles)
    return (at.incident > 0) & (at.outgoing > 0)


def fresnel_dielectric(cos: Tensor, eta: Tensor | float) -> Tensor:
    """Unpolarised reflectance of a smooth dielectric interface (Fresnel), 1 under total internal reflection.

    Args:
        cos: cosine on the side the light comes from, in [0, 1].
        eta: index of refraction of the other side over this side; below 1 seen from within.

    Returns:
        Reflectance in [0, 1]; shapes broadcast.
    """
    transmitted_squared = 1 - (1 - cos * cos) / (eta * eta)
    transmitted = transmitted_squared.clamp_min(torch.finfo(cos.dtype).tiny).sqrt()
    parallel = (eta * cos - transmitted) / (eta * cos + transmitted)
    perpendicular = (cos - eta * transmitted) / (cos + eta * transmitted)
    return torch.where(transmitted_squared > 0, (parallel**2 + perpendicular**2) / 2, 1.0)


def fresnel_conductor(cos: Tensor, eta: Tensor | float, k: Tensor | float) -> Tensor:
    """Unpolarised reflectance of a smooth conductor of complex index eta + i k, seen from air (Moeller, "Optics").

    Args:
        cos: cosine with the normal, in [0, 1].
        eta: real part, > 0.
        k: extinction coefficient, >= 0.

    Returns:
        Reflectance in [0, 1]; shapes broadcast.
    """
    cos_squared = cos * cos
    sin_squared = 1 - cos_squared
    product = cos.new_tensor(1.0) * (eta * k)
    real = eta * eta - k * k - sin_squared
    modulus = (real * real + 4 * product * product).clamp_min(torch.finfo(cos.dtype).tiny).sqrt()
    # The textbook's a = sqrt((modulus + real) / 2) cancels for metals like silver; its product with b is eta * k.
    larger = ((modulus + real.abs()) / 2).sqrt()
    a = torch.where(real >= 0, larger, product / larger)
    perpendicular = (modulus + cos_squared - 2 * cos * a) / (modulus + cos_squared + 2 * cos * a)
    sum_ = modulus * cos_squared + sin_squared * sin_squared
    parallel = perpendicular * (sum_ - 2 * cos * a * sin_squared) / (sum_ + 2 * cos * a * sin_squared)
    return (perpendicular + parallel) / 2


def fresnel_schlick(cos: Tensor, f0: Tensor | float) -> Tensor:
    """Schlick's approximation (1994) from the reflectance `f0` at normal incidence; shapes broadcast."""
    return f0 + (1 - f0) * (1 - cos).clamp_min(0) ** 5


def fresnel_diffuse(eta: Tensor | float) -> Tensor:
    """Reflectance of a smooth dielectric interface under uniform light, 2 * integral of F(mu) mu, in closed form.

    Args:
        eta: relative index of refraction, > 0, not 1; below 1 the reflectance seen from within.

    Returns:
        Reflectance in (0, 1), float64 for a float. Source: Walsh (1926), and from within 1 - (1 - F) / eta^2.
    """
    eta = torch.as_tensor(eta, dtype=None if isinstance(eta, Tensor) else torch.float64)
    n = torch.where(eta < 1, 1 / eta, eta)
    n2 = n * n
    outside = (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n2 * (n2 - 1) ** 2 / (n2 + 1) ** 3 * ((n - 1) / (n + 1)).log()
        - 2 * n**3 * (n2 + 2 * n - 1) / ((n2 + 1) * (n2 * n2 - 1))
        + 8 * n2 * n2 * (n2 * n2 + 1) / ((n2 + 1) * (n2 * n2 - 1) ** 2) * n.log()
    )
    return torch.where(eta < 1, 1 - (1 - outside) / n2, outside)


def ggx_distribution(cos_h: Tensor, alpha: Tensor | float) -> Tensor:
    """Density of facet normals per sr, GGX (Walter et al. 2007); D cos_h integrates to 1. `alpha` > 0 broadcasts."""
    # (1 - c)(1 + c), not 1 - c^2: exact in float32 next to the peak.
    spread = (1 - cos_h) * (1 + cos_h) + (alpha * cos_h) ** 2
    return torch.where(cos_h > 0, alpha * alpha / (math.pi * spread * spread), 0.0)


def beckmann_distribution(cos_h: Tensor, alpha: Tensor | float) -> Tensor:
    """Density of facet normals per sr, Beckmann (Walter et al. 2007); D cos_h integrates to 1. `alpha` > 0."""
    cos_squared = cos_h.clamp_min(1e-3) ** 2  # the exponential is zero long before
    steepness = (1 - cos_h) * (1 + cos_h) / (cos_squared * alpha * alpha)
    return torch.where(cos_h > 0, (-steepness).exp() / (math.pi * alpha * alpha * cos_squared * cos_squared), 0.0)


def _masking_over_cosine(cos: Tensor, alpha: Tensor | float, kind: MicrofacetKind) -> Tensor:
    # Every use divides G1 by its cosine; this quotient stays finite at grazing angles.
    cos = cos.clamp_min(0)
    if kind == "ggx":
        return 2 / (cos + ((1 - cos) * (1 + cos) * alpha * alpha + cos * cos).sqrt())
    if kind == "beckmann":
        sine = ((1 - cos) * (1 + cos)).clamp_min(torch.finfo(cos.dtype).tiny).sqrt()
        ratio = cos / (alpha * sine)
        masked = ratio < 1.6
        ratio = ratio.clamp_max(1.6)
        # Walter et al. 2007, equation 27: within 0.35 % of the exact integral.
        quotient = (3.535 + 2.181 * ratio) / ((1 + 2.276 * ratio + 2.577 * ratio * ratio) * alpha * sine)
        return torch.where(masked, quotient, 1 / torch.where(masked, 1.0, cos))
    raise ValueError(f"microfacet kind: {kind!r}, expected 'ggx' or 'beckmann'")


def smith_masking(cos: Tensor, alpha: Tensor | float, kind: MicrofacetKind) -> Tensor:
    """Smith's masking G1, the visible share of the facets; exact for GGX, Walter's rational fit for Beckmann.

    Args:
        cos: cosine of the direction with the macroscopic normal; masked entirely at and below 0.
        alpha: roughness > 0, broadcast.
        kind: "ggx" or "beckmann".

    Returns:
        Visibility in [0, 1].
    """
    return _masking_over_cosine(cos, alpha, kind) * cos.clamp_min(0)


def microfacet_lobe(at: Cosines, alpha: Tensor | float, fresnel: Fresnel, kind: MicrofacetKind = "ggx") -> Tensor:
    """Reflection by rough facets, D F G / (4 cos_i cos_o) with separable Smith masking (Torrance and Sparrow 1967).

    Args:
        at: cosines [...].
        alpha: roughness [...] or a number, > 0.
        fresnel: reflectance [..., C] of the cosine [..., 1] between light and facet.
        kind: "ggx" or "beckmann".

    Returns:
        BRDF [..., C] in 1/sr, 0 below the horizon, finite at grazing angles. One scattering event: energy is lost to
        the others.
    """
    density = (ggx_distribution if kind == "ggx" else beckmann_distribution)(at.half, alpha)
    shape = density * _masking_over_cosine(at.incident, alpha, kind) * _masking_over_cosine(at.outgoing, alpha, kind)
    shape = torch.where((at.incident > 0) & (at.outgoing > 0), shape / 4, 0.0)
    return shape[..., None] * fresnel(at.difference[..., None])


def microfacet_reflection(
    wi: Tensor, wo: Tensor, alpha: Tensor | float, fresnel: Fresnel, kind: MicrofacetKind = "ggx"
) -> Tensor:
    """As `microfacet_lobe`, for directions wi and wo [..., 3] of unit length."""
    length = _length(wi + wo)
    return microfacet_lobe(
        Cosines(wi[..., 2], wo[..., 2], (wi + wo)[..., 2] / length, length / 2), alpha, fresnel, kind
    )


@functools.cache
def gauss_legendre(count: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights [count], float64, of Gauss-Legendre quadrature on [0, 1] (Golub and Welsch 1969)."""
    step = torch.arange(1, count, dtype=torch.float64)
    off_diagonal = step / (4 * step * step - 1).sqrt()
    nodes, vectors = torch.linalg.eigh(torch.diag(off_diagonal, 1) + torch.diag(off_diagonal, -1))
    return (nodes + 1) / 2, vectors[0] ** 2


def _visible_facets(cos: Tensor, alpha: float, kind: MicrofacetKind) -> tuple[Tensor, Tensor, Tensor]:
    """Facets seen from a direction: cos_h and cos_d, their cosines with normal and direction, and quadrature weights.

    Each [..., 64, 48], cos [...]; the weights sum to 1 but for the quadrature's error, 0 for facets seen from behind.
    """
    nodes, weights = (part.to(cos)[:, None] for part in gauss_legendre(64))
    # Normals distributed as D cos_h: a quantile gives the slope; the azimuth's mirror image counts double.
    slope_squared = nodes / (1 - nodes) if kind == "ggx" else -(1 - nodes).log()
    cos_h = (1 + alpha * alpha * slope_squared).rsqrt()
    sin_h = (1 - cos_h * cos_h).sqrt()
    azimuth = (torch.arange(48, dtype=cos.dtype, device=cos.device) + 0.5) * (math.pi / 48)
    cos = cos[..., None, None]
    cos_d = (cos * cos_h + (1 - cos * cos).clamp_min(0).sqrt() * sin_h * azimuth.cos()).clamp_min(0)
    return cos_h, cos_d, _masking_over_cosine(cos, alpha, kind) * cos_d / cos_h * weights / 48


def rough_reflectance(cos: Tensor, alpha: float, fresnel: Fresnel, kind: MicrofacetKind = "ggx") -> Tensor:
    """Share of the light from one direction that a microfacet lobe reflects, by quadrature over facet normals.

    With `fresnel_dielectric` of eta > 1 this is what a rough coat reflects; of eta < 1, what it keeps inside.

    Args:
        cos: cosines of the direction, [...], in (0, 1].
        alpha: roughness > 0.
        fresnel: reflectance [..., C] of cosines [..., 1].
        kind: "ggx" or "beckmann".

    Returns:
        Reflectance [..., C] in [0, 1], to about 1e-3 (less well in the last degrees before grazing).
    """
    cos_h, cos_d, weights = _visible_facets(cos, alpha, kind)
    outgoing = 2 * cos_d * cos_h - cos[..., None, None]
    share = weights * smith_masking(outgoing, alpha, kind)
    return (share[..., None] * fresnel(cos_d[..., None])).sum((-3, -2))


def rough_transmittance(cos: Tensor, alpha: float, eta: float, kind: MicrofacetKind = "ggx") -> Tensor:
    """Share of the light from one direction that passes a rough dielectric interface in one event (Walter 2007).

    Args:
        cos: cosines of the direction, [...], in (0, 1].
        alpha: roughness > 0.
        eta: index of refraction of the far side over the near side, > 0.
        kind: "ggx" or "beckmann".

    Returns:
        Transmittance [...] in [0, 1]; with `rough_reflectance` less than 1 in sum, by what facets mask.
    """
    cos_h, cos_d, weights = _visible_facets(cos, alpha, kind)
    refracted = (1 - (1 - cos_d * cos_d) / (eta * eta)).clamp_min(0).sqrt()
    onward = refracted * cos_h + (cos[..., None, None] - cos_d * cos_h) / eta  # cosine with the inward normal
    return (weights * (1 - fresnel_dielectric(cos_d, eta)) * smith_masking(onward, alpha, kind)).sum((-2, -1))


class SphereScene(NamedTuple):
    """A lit sphere seen by an orthographic camera, as (pixel, light) pairs to multiply with a BRDF.

    Attributes:
        mask: [size, size] bool, the pixels the sphere touches; P of them, in row-major order.
        coverage: [size, size] in [0, 1], the share of the pixel that the sphere covers.
        angles: [P, L, 3] in rad, of light (wi) and camera (wo) at the pixel's point.
        weights: [P, L, 3] linear RGB, radiance * cosine * solid angle; zero for lights below the horizon.
    """

    mask: Tensor
    coverage: Tensor
    angles: Tensor
    weights: Tensor


def _softbox(centre: tuple[float, float, float], size_rad: tuple[float, float], grid: tuple[int, int]) -> Tensor:
    forward = torch.nn.functional.normalize(torch.tensor(centre, dtype=torch.float64), dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward.new_tensor([0.0, 1.0, 0.0]), forward), dim=0)
    across, along = (
        ((torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5) * extent
        for count, extent in zip(grid, size_rad, strict=True)
    )
    tangent = across.tan()[:, None, None] * right + along.tan()[:, None] * torch.linalg.cross(forward, right)
    return torch.nn.functional.normalize((forward + tangent).reshape(-1, 3), dim=-1)


def _studio_lights() -> tuple[Tensor, Tensor]:
    """Directions [L, 3] (x right, y up, z to the camera) and their linear RGB irradiance [L, 3] across the beam."""
    lights = [  # directions, tint, power
        (_softbox((-0.55, 0.6, 0.75), (0.45, 0.45), (6, 6)), (1.0, 0.95, 0.88), 1.0),  # key
        (_softbox((0.95, 0.05, 0.45), (0.2, 0.7), (2, 8)), (0.84, 0.93, 1.0), 0.35),  # fill
        (_softbox((0.35, 0.75, -0.6), (0.6, 0.1), (8, 1)), (1.0, 1.0, 1.0), 0.4),  # rim, from behind
        (torch.tensor([[0.36, 0.48, 0.8]], dtype=torch.float64), (1.0, 0.98, 0.95), 0.2),  # lamp: shows highlights
    ]
    power = [torch.tensor(tint, dtype=torch.float64).mul(p / len(d)).expand(len(d), 3) for d, tint, p in lights]
    return torch.cat([d for d, _, _ in lights]), torch.cat(power)


def _dome(wo: Tensor, up: Tensor) -> tuple[Tensor, Tensor]:
    """A dim sky for each pixel: directions [P, 42, 3] and irradiance [P, 42, 3] of `wo` and "up" [P, 3], all local.

    Fixed lights would show as dots in polished metal. These lie on rings of half vectors about each pixel's normal,
    dense towards it, which integrates lobes of any width to a few percent.
    """
    nodes, weights = gauss_legendre(7)
    narrowest, reach = 0.05, math.asinh(math.pi / 2 / 0.05)
    theta_h = (narrowest * (nodes * reach).sinh())[:, None]
    # d theta_h sin theta_h d phi, then d wi = 4 cos theta_d d half
    solid_angle = weights[:, None] * narrowest * reach * (nodes[:, None] * reach).cosh() * theta_h.sin() * math.tau / 6
    phi_h = (torch.arange(6, dtype=torch.float64) + 0.5) * math.tau / 6
    half = torch.stack(
        [theta_h.sin() * phi_h.cos(), theta_h.sin() * phi_h.sin(), theta_h.cos().expand(7, 6)], dim=-1
    ).reshape(-1, 3)
    cos_d = wo @ half.T
    wi = 2 * cos_d[..., None] * half - wo[:, None]
    radiance = 0.06 + 0.05 * (wi * up[:, None]).sum(-1)  # brighter above than below
    irradiance = radiance * 4 * cos_d.clamp_min(0) * solid_angle.expand(7, 6).reshape(-1)
    return wi, irradiance[..., None] * irradiance.new_tensor([0.95, 0.97, 1.0])


def sphere_scene(
    size: int = 96, *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> SphereScene:
    """The reference picture: a sphere under three softboxes, a small lamp and a dim sky: 103 directions of light.

    Args:
        size: width and height in pixels, >= 8; the sphere fills 96 % of it.
        dtype: of the floating-point tensors.
        device: where they live.

    Returns:
        The scene, exposed such that a white diffuse sphere of albedo 0.8 is 0.85 where brightest.
    """
    if size < 8:
        raise ValueError(f"size of the reference sphere: {size} pixels, expected at least 8")
    centre = (torch.arange(size, dtype=torch.float64) + 0.5) * 2 / size - 1
    y, x = torch.meshgrid(-centre, centre, indexing="ij")
    radius = (x * x + y * y).sqrt() / 0.96
    coverage = (0.5 + (1 - radius) * 0.96 * size / 2).clamp(0, 1)
    mask = coverage > 0
    # A pixel on the rim may have its centre outside the disc; it shows the last point inside.
    shrink = 0.96 * (radius / 0.995).clamp_min(1)
    normal_x, normal_y = (x / shrink)[mask], (y / shrink)[mask]
    normal = torch.stack([normal_x, normal_y, (1 - normal_x**2 - normal_y**2).sqrt()], dim=-1)

    # An isotropic surface does not mind which tangents; these are never parallel to the normal, which faces the camera.
    tangent = torch.nn.functional.normalize(
        torch.stack([normal[:, 2], torch.zeros_like(normal_x), -normal_x], dim=-1), dim=-1
    )
    frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], dim=1)  # [P, 3, 3], rows are axes
    directions, irradiance = _studio_lights()
    wo = frame[:, :, 2]
    sky, sky_irradiance = _dome(wo, frame[:, :, 1])
    wi = torch.cat([torch.einsum("pij,lj->pli", frame, directions), sky], dim=1)
    weights = torch.cat([irradiance.expand(len(wi), -1, -1), sky_irradiance], dim=1) * wi[..., 2:].clamp_min(0)
    weights = weights * (0.85 * math.pi / 0.8 / weights.sum(1).mean(-1).max())
    return SphereScene(
        mask.to(device),
        coverage.to(device, dtype),
        directions_to_rusinkiewicz(wi, wo[:, None].expand_as(wi)).to(device, dtype),
        weights.to(device, dtype),
    )


def shade_sphere(scene: SphereScene, evaluate: Callable[[Tensor], Tensor], *, chunk: int = 65_536) -> Tensor:
    """A BRDF as a picture of the reference sphere.

    Args:
        scene: where the lights are.
        evaluate: BRDF [..., 3] in 1/sr, linear RGB, of angles [..., 3]; called with [<= chunk, 3].
        chunk: (pixel, light) pairs a call; it bounds the memory.

    Returns:
        [size, size, 4]: linear RGB radiance on black (that is, times coverage: associated alpha, as in EXR), coverage.
    """
    lit = scene.weights.amax(-1) > 0
    pixel = lit.nonzero()[:, 0]
    pairs = zip(scene.angles[lit].split(chunk), scene.weights[lit].split(chunk), strict=True)
    radiance = torch.cat([evaluate(angles) * weights for angles, weights in pairs])
    coverage = scene.coverage[scene.mask][:, None].to(radiance)
    linear_rgb = radiance.new_zeros(len(coverage), 3).index_add(0, pixel, radiance)
    image = radiance.new_zeros(*scene.mask.shape, 4)
    image[scene.mask] = torch.cat([linear_rgb * coverage, coverage], dim=-1)
    return image
