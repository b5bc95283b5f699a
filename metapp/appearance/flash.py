"""A flat patch of material under a point flash: photographs of its maps, and the position of the flash.

The patch lies in the plane z = 0 about the origin and its half side is 1, x to the right, y up, z towards the camera.
The camera looks down from :func:`camera_position`, so high that a square photo covers the patch. Pictures live in
texture space, a pixel a texel: another view changes the shading, never the projection, as if the photo of a flat
material had been straightened.

Everything is differentiable and takes any leading axes (written B), dtype and device; shapes broadcast. Nothing here
knows what a network or a fit is.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.appearance.geometry import direction_cosines
from metapp.appearance.reflection import fresnel_schlick, microfacet_lobe

CAMERA_FOV_RAD = math.pi / 4  # a phone held upright, along the shorter side of its picture
# Below this roughness GGX is narrower than a texel: half vectors of neighbours differ by 0.003 rad in a map of 256.
LEAST_ROUGHNESS = 0.04
DISPLAY_GAMMA = 2.2  # power by which a display turns values into radiance
LEAST_NORMAL_Z = 0.05  # least z of normals that heights follow: slopes stay below 20
FARTHEST_FLASH_HALF_SIDES = 0.5  # distance from a photo's centre within which its flash is searched for
# Synthetic photographs: the share whose flash is beside the lens; for the others, standard deviations of the sideways
# offset of the flash in half sides of the patch, and of the natural logarithms of its height and brightness. The
# sideways deviation is the one in the strips of photographs by Deschaintre et al. 2018.
BESIDE_LENS_SHARE = 0.3
FLASH_OFFSET_HALF_SIDES, FLASH_HEIGHT_LOG_DEVIATION, FLASH_BRIGHTNESS_LOG_DEVIATION = 0.24, 0.08, 0.06


class Maps(NamedTuple):
    """The maps of a flat material; row 0 is the upper edge.

    Attributes:
        diffuse: [B, 3, H, W] linear RGB albedo in [0, 1].
        specular: [B, C, H, W], C = 1 or 3, linear reflectance at normal incidence in [0, 1].
        roughness: [B, 1, H, W] in (0, 1]; GGX's alpha is its square.
        normal: [B, 3, H, W], unit length, z up out of the patch.
    """

    diffuse: Tensor
    specular: Tensor
    roughness: Tensor
    normal: Tensor


def pack_maps(maps: Maps) -> Tensor:
    """Return maps without a leading axis, with 1 or 3 specular channels, as one tensor [10, H, W].

    The channels are the normal, diffuse red, green and blue, roughness, and specular red, green and blue.
    """
    specular = maps.specular.expand(3, -1, -1)
    return torch.cat([maps.normal, maps.diffuse, maps.roughness, specular])


def unpack_maps(maps: Tensor) -> Maps:
    """Return the maps that a tensor [..., 10, H, W] holds; the inverse of :func:`pack_maps`."""
    normal, diffuse, roughness, specular = maps.split((3, 3, 1, 3), -3)
    return Maps(diffuse, specular, roughness, normal)


STATISTICS_SIDES_PX = (256, 128, 64)  # px a side at which data sets state the statistics of maps


def map_statistics(maps: Maps) -> Tensor:
    """Compute means and standard deviations of a material's maps over the patch, [B, 2, 6].

    Channels: diffuse red, green and blue and mean specular, each as a display of gamma 2.2 shows it, roughness, and the
    sine of the angle between normal and patch normal.
    """
    specular = maps.specular.mean(-3, keepdim=True)
    display = torch.cat([maps.diffuse, specular], -3).clamp(1e-4, 1) ** (1 / DISPLAY_GAMMA)
    channels = torch.cat([display, maps.roughness, tilt_sine(maps.normal)], -3).flatten(-2)
    return torch.stack([channels.mean(-1), (channels.var(-1, unbiased=False) + 1e-8).sqrt()], -2)


def tilt_sine(normal: Tensor) -> Tensor:
    """Return the sine of the angle between normals [..., 3, H, W] and the patch's normal, [..., 1, H, W].

    It is 0.001 where the angle is 0, which keeps its gradient finite.
    """
    return (normal[..., :2, :, :].square().sum(-3, keepdim=True) + 1e-6).sqrt()


def mean_tilt_degrees(normal: Tensor) -> float:
    """Return the mean angle in degrees between normals [..., 3, H, W] and the patch's normal, to hundredths.

    >>> mean_tilt_degrees(torch.tensor([[0.6, 0.0], [0.0, 0.0], [0.8, 1.0]])[..., None])
    18.43
    """
    across, up = normal.split((2, 1), -3)
    return round(float(torch.atan2(across.norm(dim=-3, keepdim=True), up).rad2deg().mean()), 2)


def camera_distance() -> float:
    """Return the height, in half sides, from which a field of view of CAMERA_FOV_RAD is exactly the patch."""
    return 1 / math.tan(CAMERA_FOV_RAD / 2)


def camera_position(*, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None) -> Tensor:
    """Return the position of the camera, [3], above the centre; a flash beside its lens is at the same place."""
    return torch.tensor([0.0, 0.0, camera_distance()], dtype=dtype, device=device)


def relighting_positions(
    *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> dict[str, tuple[Tensor, ...]]:
    """Three (light [3], view [3]) for evaluation and pictures, by name."""
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


def _pad_field(field: Tensor, axis: int, periodic: bool) -> Tensor:
    """Pad a field by a texel at either end of an axis: periodically, or by linear extrapolation."""
    first, last, count = field.narrow(axis, 0, 1), field.narrow(axis, -1, 1), field.shape[axis]
    if periodic:
        return torch.cat([last, field, first], dim=axis)
    second, last_but_one = field.narrow(axis, 1, 1), field.narrow(axis, count - 2, 1)
    return torch.cat([2 * first - second, field, 2 * last - last_but_one], dim=axis)


def normal_from_height(height: Tensor, scale: Tensor | float = 1.0, *, periodic: bool = True) -> Tensor:
    """Compute normals [B, 3, H, W], z > 0, of a height field, by Scharr's central differences (2000), nearly isotropic.

    A slope that alternates from texel to texel is lost.

    Args:
        height: [B, 1, H, W], in texels, up out of the patch; H and W at least 2.
        scale: multiplies the height; a number or [B, 1, 1, 1].
        periodic: whether the field tiles; otherwise slopes are extrapolated at edges.
    """
    wide = _pad_field(_pad_field(height, -1, periodic), -2, periodic)
    along_x = wide[..., 2:] - wide[..., :-2]
    along_y = wide[..., :-2, :] - wide[..., 2:, :]  # rows go down, y goes up
    slope_x = (3 * along_x[..., :-2, :] + 10 * along_x[..., 1:-1, :] + 3 * along_x[..., 2:, :]) * (scale / 32)
    slope_y = (3 * along_y[..., :-2] + 10 * along_y[..., 1:-1] + 3 * along_y[..., 2:]) * (scale / 32)
    z = (1 + slope_x * slope_x + slope_y * slope_y).rsqrt()
    return torch.cat([-slope_x * z, -slope_y * z, z], dim=-3)


def height_from_normal(normal: Tensor, *, periodic: bool) -> Tensor:
    """Integrate normals to a height field [..., 1, H, W] in texels, of mean 0; its slopes fit theirs in least squares.

    Frankot and Chellappa, "A Method for Enforcing Integrability in Shape from Shading Algorithms" (1988): each
    frequency of the height is the projection of both slopes onto its derivatives; exact for band-limited fields.

    Args:
        normal: [..., 3, H, W], z up out of the patch; z below 0.05 counts as 0.05.
        periodic: whether the field tiles; otherwise it is mirrored at its edges.
    """
    x, y, z = normal.double().unbind(-3)
    z = z.clamp_min(LEAST_NORMAL_Z)
    along_x, along_row = -x / z, y / z  # rows go down, y goes up
    if not periodic:
        along_x = _mirror_slopes(along_x, -1)
        along_row = _mirror_slopes(along_row, -2)
    rows, columns = along_x.shape[-2:]
    across, down = _angular_frequencies(columns, normal)[None, :], _angular_frequencies(rows, normal)[:, None]
    squared = across.square() + down.square()
    # in place: each spectrum of 2048 x 2048 texels, mirrored, takes 0.3 GB
    spectrum = torch.fft.fft2(along_x).mul_(across)
    spectrum += torch.fft.fft2(along_row).mul_(down)
    spectrum.mul_(-1j).div_(squared.clamp_min(1e-12))  # where both frequencies are 0, the sum is 0, too
    padded_height: Tensor = torch.fft.ifft2(spectrum).real
    height = padded_height[..., : normal.shape[-2], : normal.shape[-1]]
    return (height - height.mean((-2, -1), keepdim=True)).to(normal)[..., None, :, :]


def _angular_frequencies(count: int, like: Tensor) -> Tensor:
    """Return angular frequencies in rad per texel, [count]; the highest one of an even count is stated as 0."""
    frequencies: Tensor = 2 * math.pi * torch.fft.fftfreq(count, dtype=torch.float64, device=like.device)
    if count % 2 == 0:  # a wave that alternates from texel to texel has no derivative
        frequencies[count // 2] = 0
    return frequencies


def _mirror_slopes(slopes: Tensor, odd: int) -> Tensor:
    """Mirror a field's slopes at its lower and right edges; the sign of slopes along the axis `odd` changes."""
    for axis in (-1, -2):
        slopes = torch.cat([slopes, slopes.flip(axis) * (-1 if axis == odd else 1)], axis)
    return slopes


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


def radiance_to_display(radiance: Tensor) -> Tensor:
    """Convert linear radiance of any shape, 1 is white, to display values in [0.002, 1]: clamp to [1e-6, 1], gamma 2.2.

    The floor keeps the slope at black finite (850) and is less than half a step of 8 bits. Outside the range the
    gradient is 0: a descent must begin dark enough, since a picture that is over-exposed all over has none.
    """
    return radiance.clamp(1e-6, 1.0) ** (1 / DISPLAY_GAMMA)


@functools.lru_cache(4)  # 15 MB each; the photos of one camera have one shape
def _radial_models(rows: int, columns: int) -> tuple[Tensor, Tensor, Tensor]:
    """Build models of radial brightness about each of K - 1 centres, and at last of a linear slope; float64.

    Returns:
        centres [K, 2], where the slope's is 0; an orthonormal basis [K, rows * columns, 3] of the radial pictures
        a + b log(1 + r^2) + c exp(-8 r^2), or of a + b x + c y; and [K, 3], by how much each basis picture falls from
        the centre to r = 1, 0 for the slope.
    """
    ticks = torch.arange(-12, 13, dtype=torch.float64) * (FARTHEST_FLASH_HALF_SIDES / 12)
    centres = torch.cartesian_prod(ticks, ticks)
    centres = centres[centres.square().sum(-1) <= FARTHEST_FLASH_HALF_SIDES**2 + 1e-9]
    cells = texel_positions(rows, columns, dtype=torch.float64).flatten(1).T

    def profile(squared: Tensor) -> Tensor:
        return torch.stack([torch.ones_like(squared), squared.log1p(), (-8 * squared).exp()], dim=-1)

    slope = torch.cat([torch.ones_like(cells[:, :1]), cells], dim=-1)
    pictures = torch.cat([profile((cells - centres[:, None]).square().sum(-1)), slope[None]])
    basis, triangle = torch.linalg.qr(pictures)
    centre_terms, rim_terms = profile(torch.tensor([[[0.0]], [[1.0]]], dtype=torch.float64))
    falls = (centre_terms - rim_terms).expand(len(centres), 1, 3)
    falls = torch.linalg.solve_triangular(triangle[:-1], falls, upper=True, left=False)[:, 0]
    slope_centre = torch.zeros_like(centres[:1])
    return torch.cat([centres, slope_centre]), basis, torch.cat([falls, torch.zeros_like(falls[:1])])


def _find_falloff_centre(brightness: Tensor) -> Tensor:
    """Estimate the centre [B, 2] of the radial fall-off of log brightness [B, rows, columns].

    It is the mean of a posterior over centres: the likelihood counts 40 cells as independent (texture correlates the
    errors of neighbours), and the prior, 0.2 wide, decides where nothing is radial.
    """
    centres, basis, falls = (part.to(brightness) for part in _radial_models(*brightness.shape[-2:]))
    cells = brightness.flatten(-2)
    cells = cells - cells.mean(-1, keepdim=True)
    coefficients = torch.einsum("knp,...n->...kp", basis, cells)
    explained = torch.where((coefficients * falls).sum(-1) >= 0, coefficients.square().sum(-1), 0.0)
    unexplained = 1 - explained / cells.square().sum(-1, keepdim=True).clamp_min(1e-6)
    misfit = 40 * unexplained.clamp_min(1e-3).log() + centres.square().sum(-1) / 0.2**2
    return (-misfit / 2).softmax(-1) @ centres


def _find_highlight(radiance: Tensor) -> tuple[Tensor, Tensor]:
    """Find the centre of the bright outliers among cells [B, rows, columns], and whether they are one central spot.

    Returns:
        The centre [B, 2] in half sides, and bool [B, 1].
    """
    positions = texel_positions(*radiance.shape[-2:], dtype=radiance.dtype, device=radiance.device).flatten(1).T
    cells = radiance.flatten(-2)
    deviations = cells - cells.median(-1, keepdim=True).values
    # 1.4826: the ratio for a normal distribution
    standard_deviation = 1.4826 * deviations.abs().median(-1, keepdim=True).values + 1e-3
    # Neither the fall-off on a matte material nor most textures reach six deviations.
    weights = (deviations / standard_deviation - 6).clamp_min(0)
    total = weights.sum(-1, keepdim=True)
    normalized_weights = weights / total.clamp_min(1e-6)
    centre = normalized_weights @ positions
    spread_squared = normalized_weights @ positions.square().sum(-1, keepdim=True) - centre.square().sum(
        -1, keepdim=True
    )
    is_near = centre.square().sum(-1, keepdim=True) < FARTHEST_FLASH_HALF_SIDES**2
    return centre, is_near & (total > 3) & (spread_squared < 0.35**2)


def estimate_flash_position(photo: Tensor) -> Tensor:
    """Estimate the point of the patch below the flash from a photo's highlight, or without one from its fall-off.

    Put both light and view above that point: an off-centre highlight mostly means a camera that was not held straight.

    Args:
        photo: [B, 3, H, W] or [3, H, W] as displayed (gamma-encoded), in [0, 1]; 16 pixels or more a side.

    Returns:
        [B, 2] in half sides, x right and y up, at most 0.5 from the centre, and near it where the photo is ambiguous.
        Errors on renders: 0.03, 0.1 under strong texture, 0.3 where that is coarse and matte. Without useful gradients.
    """
    height, width = photo.shape[-2:]
    cell = min(height, width) / min(32, height, width)
    luminance = photo.mean(-3, keepdim=True)

    def pool(picture: Tensor) -> Tensor:
        size = round(height / cell), round(width / cell)
        return torch.nn.functional.adaptive_avg_pool2d(picture, size).squeeze(-3)

    highlight, is_clear = _find_highlight(pool(luminance**DISPLAY_GAMMA))
    return torch.where(is_clear, highlight, _find_falloff_centre((pool(luminance) + 1 / 255).log()))
