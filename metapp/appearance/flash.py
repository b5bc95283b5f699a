"""A flat patch of material under a point flash: its texels, its camera, its reflection, and renderings of its maps.

The patch lies in the plane z = 0 about the origin and its half side is 1, x to the right, y up, z towards the camera.
The camera looks down from :func:`camera_position`, so high that a square photo covers the patch. Pictures live in
texture space, a pixel a texel: another view changes the shading, never the projection, as if the photo of a flat
material had been straightened.

Everything is differentiable and takes any leading axes (written B), dtype and device; shapes broadcast.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from metapp.appearance.geometry import direction_cosines
from metapp.appearance.reflection import fresnel_schlick, microfacet_lobe
from metapp.appearance.svbrdf_maps import Maps

CAMERA_FOV_RAD = math.pi / 4  # a phone held upright, along the shorter side of its picture
# Below this roughness GGX is narrower than a texel: half vectors of neighbours differ by 0.003 rad in a map of 256.
LEAST_ROUGHNESS = 0.04


def camera_distance() -> float:
    """Return the height, in half sides, from which a field of view of CAMERA_FOV_RAD is exactly the patch."""
    return 1 / math.tan(CAMERA_FOV_RAD / 2)


def camera_position(*, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None) -> Tensor:
    """Return the position of the camera, [3], above the centre; a flash beside its lens is at the same place."""
    return torch.tensor([0.0, 0.0, camera_distance()], dtype=dtype, device=device)


def relighting_positions(
    *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> dict[str, tuple[Tensor, ...]]:
    """Return three pairs of a light [3] and a view [3], for evaluation and pictures, by name."""
    eye = camera_position(dtype=dtype, device=device)
    offsets = {
        "left": ((-0.8, 0.0, -0.8), (0.0, 0.0, 0.0)),
        "above": ((0.0, 0.8, -0.8), (0.0, 0.0, 0.0)),
        "aside": ((0.8, -0.8, -1.2), (-0.8, 0.5, 0.0)),
    }
    return {
        name: tuple(eye + eye.new_tensor(offset) for offset in offset_pair) for name, offset_pair in offsets.items()
    }


def texel_positions(
    height: int, width: int, *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> Tensor:
    """Return the centres of texels (x right, y up), [2, height, width], row 0 on top.

    The shorter side reaches from -1 to 1 and texels are square. The positions of a crop's texels are the same crop of
    this tensor.
    """
    texel = 2 / min(height, width)
    x, y = (
        (torch.arange(count, dtype=dtype, device=device) - (count - 1) / 2) * (sign * texel)
        for count, sign in ((width, 1), (height, -1))
    )
    return torch.stack([x.expand(height, width), y[:, None].expand(height, width)])


def directions_to_point(place: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the directions and squared distances from the texels of the patch to a point above it.

    Args:
        place: the point, [B, 3], z > 0.
        positions: [2, h, w] or [B, 2, h, w], see :func:`texel_positions`.

    Returns:
        Unit vectors [B, 3, h, w], and squared distances in half sides, [B, 1, h, w].
    """
    across = place[..., :2, None, None] - positions
    up = place[..., 2:, None, None].expand_as(across[..., :1, :, :])
    squared = (across * across).sum(-3, keepdim=True) + up * up
    return torch.cat([across, up], dim=-3) * squared.rsqrt(), squared


def evaluate_brdf(maps: Maps, wi: Tensor, wo: Tensor) -> Tensor:
    """Evaluate the BRDF of a material's texels: a Lambertian body under a GGX lobe with Schlick's Fresnel.

    diffuse (1 - specular) / pi + D F G / (4 cos_i cos_o), as Deschaintre et al., "Single-Image SVBRDF Capture with a
    Rendering-Aware Deep Network" (2018); G is separable. It is reciprocal. Its albedo for light from one
    direction is at most the albedo of the lobe plus diffuse (1 - specular): no more than 1 (to 0.5 %) up to 45 degrees;
    near grazing up to 2, as Schlick's reflectance rises there and the body keeps its light.

    Args:
        maps: the material; roughness below 0.04 counts as 0.04 (and gets no gradient), which keeps the lobe finite.
        wi: directions to the light, [B, 3, H, W], unit length, in the frame of the patch.
        wo: directions to the viewer, [B, 3, H, W], unit length, in the frame of the patch.

    Returns:
        [B, 3, H, W] in 1/sr, linear RGB. The lobe is 0 if a normal turns away from light or viewer, the body is
        not: multiply by the cosine, at least 0.
    """
    # Channels go last for a moment: views, nothing moves in memory.
    cosines = direction_cosines(*(vectors.movedim(-3, -1) for vectors in (wi, wo, maps.normal)))
    alpha = maps.roughness.squeeze(-3).clamp_min(LEAST_ROUGHNESS) ** 2
    f0 = maps.specular.movedim(-3, -1)
    lobe = microfacet_lobe(cosines, alpha, lambda cos: fresnel_schlick(cos, f0)).movedim(-1, -3)
    return maps.diffuse * (1 - maps.specular) / math.pi + lobe


def render_maps(
    maps: Maps,
    positions: Tensor,
    light: Tensor,
    view: Tensor,
    *,
    intensity: Tensor | float = 1.0,
    falloff: Tensor | float = 0.0,
    axis: Tensor | None = None,
) -> Tensor:
    """Render a material under a point flash: BRDF * cosine * intensity / squared distance, without shadows.

    Args:
        maps: the maps of the patch, or of any crop of it.
        positions: positions of the maps' texels in the patch, [2, h, w] or [B, 2, h, w]; see
            :func:`texel_positions`.
        light: [3] or [B, 3], position of the flash; z > 0.
        view: [3] or [B, 3], position of the viewer; z > 0.
        intensity: intensity of the flash: a number, [3] or [B, 3] linear RGB, or [B, 1]. With 1 a white Lambertian
            patch has radiance 1 right below a flash at the camera's height.
        falloff: power of the cosine with the flash's axis: 0 is a uniform point light, 1 a small flat lamp. A number or
            [B].
        axis: direction of the flash's axis, [3] or [B, 3], of any length; None for straight down.

    Returns:
        Linear radiance [B, 3, h, w], >= 0.
    """
    wi, squared_distance = directions_to_point(light, positions)
    wo, _ = directions_to_point(view, positions)
    power = falloff[..., None, None, None] if isinstance(falloff, Tensor) else falloff
    colour = intensity[..., None, None] if isinstance(intensity, Tensor) else intensity
    if axis is None:
        axis_cosine = wi[..., 2:, :, :]
    else:
        unit_axis = axis / axis.norm(dim=-1, keepdim=True)
        axis_cosine = -(wi * unit_axis[..., None, None]).sum(-3, keepdim=True).clamp(max=0)
    irradiance = colour * (math.pi * camera_distance() * camera_distance()) * axis_cosine**power / squared_distance
    cosine = (wi * maps.normal).sum(-3, keepdim=True).clamp_min(0)
    return evaluate_brdf(maps, wi, wo) * (irradiance * cosine)
