"""Lat-long environment maps: their directions and solid angles, resampling, and the light they cast on a sphere.

A map is [..., 3, H, W] linear Rec.709 radiance, constant in each texel, row 0 at the top. The texel in (row, column)
has its centre at u = (column + 0.5) / W and v = (row + 0.5) / H, and lies in the direction d (+y up) where
u = atan2(d.x, -d.z) / (2 pi) mod 1 and v = acos(d.y) / pi, as in Mitsuba 3's `envmap`: the middle looks to +z.
The sphere that maps light is seen from +z: x to the right, y up, all rays of view parallel.

Everything is differentiable and takes any dtype and device.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from metapp.appearance.geometry import Cosines
from metapp.appearance.reflection import microfacet_lobe

_LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)  # of linear red, green and blue, Rec.709


def texel_directions(
    height: int, width: int, *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> Tensor:
    """Return directions of the texels' centres, [3, height, width], of unit length."""
    phi = (torch.arange(width, dtype=torch.float64) + 0.5) * (math.tau / width)
    theta = ((torch.arange(height, dtype=torch.float64) + 0.5) * (math.pi / height))[:, None]
    y = theta.cos().expand(height, width)
    return torch.stack([theta.sin() * phi.sin(), y, -theta.sin() * phi.cos()]).to(device, dtype)


def texel_index(directions: Tensor, height: int, width: int) -> Tensor:
    """Return the index of the texel in which each direction lies, counted row by row: int64 [...].

    Args:
        directions: directions of unit length, [3, ...].
        height: rows of the map.
        width: columns of the map.
    """
    x, y, z = directions
    across = torch.atan2(x, -z) / math.tau % 1
    down = torch.acos(y.clamp(-1, 1)) / math.pi
    row, column = (
        (coordinate * count).long().clamp(max=count - 1) for coordinate, count in ((down, height), (across, width))
    )
    return row * width + column


def solid_angles(
    height: int, width: int, *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> Tensor:
    """Return the solid angle of one texel of each row, exact, [height, 1] in sr.

    All texels together have 4 pi.
    """
    theta = (torch.arange(height, dtype=torch.float64) + 0.5) * (math.pi / height)
    # cos a - cos b as a product: near the poles the difference would cancel.
    return (theta.sin() * (2 * math.sin(math.pi / 2 / height) * math.tau / width))[:, None].to(device, dtype)


def luminance(rgb: Tensor) -> Tensor:
    """Return luminance [..., H, W] of linear Rec.709 [..., 3, H, W].

    >>> luminance(torch.ones(3, 1, 1))
    tensor([[1.]])
    """
    return torch.einsum("...chw,c->...hw", rgb, rgb.new_tensor(_LUMINANCE_WEIGHTS))


def mean_luminance(maps: Tensor) -> Tensor:
    """Return the mean luminance of maps [..., 3, H, W] over the sphere of directions, [...]."""
    height, width = maps.shape[-2:]
    share = solid_angles(height, width, dtype=torch.float64) / (4 * math.pi)
    return (luminance(maps) * share.to(maps)).sum((-2, -1))


def resample_maps(maps: Tensor, height: int, width: int) -> Tensor:
    """Resample maps [..., 3, H, W] to [..., 3, height, width]: each new texel is the mean over its exact area.

    Radiance times solid angle, summed over the sphere, stays as it is.
    """
    rows, columns = maps.shape[-2:]
    along_v = _overlap_shares(*(-torch.linspace(0, math.pi, n + 1, dtype=torch.float64).cos() for n in (height, rows)))
    along_u = _overlap_shares(*(torch.linspace(0, 1, n + 1, dtype=torch.float64) for n in (width, columns)))
    return along_v.to(maps) @ maps @ along_u.to(maps).T


def level_maps(maps: Tensor, pitch_rad: float) -> Tensor:
    """Turn maps that a camera looking down recorded, so that the horizon lies level and +y points up.

    The direction to the camera, +z of the recorded map, then has an elevation of `pitch_rad`, above the middle column.
    Texels are interpolated linearly: lights smaller than a texel lose some of their radiance.

    Args:
        maps: radiance in directions of the camera, [..., 3, H, W].
        pitch_rad: how far below the horizon the camera looks, in rad; negative if it looks up.

    Returns:
        [..., 3, H, W].
    """
    if not pitch_rad:
        return maps
    height, width = maps.shape[-2:]
    x, y, z = texel_directions(height, width, dtype=maps.dtype, device=maps.device)
    sine, cosine = math.sin(pitch_rad), math.cos(pitch_rad)
    camera_y, camera_z = cosine * y - sine * z, sine * y + cosine * z
    # the padded map has a column more on either side, so that interpolation goes on around the sphere
    column = torch.atan2(x, -camera_z) / math.tau % 1 * width + 1
    row = torch.acos(camera_y.clamp(-1, 1)) / math.pi * height
    places = torch.stack([2 * column / (width + 2) - 1, 2 * row / height - 1], -1)
    planes = maps.reshape(1, -1, height, width)
    padded = torch.cat([planes[..., -1:], planes, planes[..., :1]], -1)
    levelled = grid_sample(padded, places[None], padding_mode="border", align_corners=False)
    return levelled.reshape(maps.shape)


def _overlap_shares(target: Tensor, source: Tensor) -> Tensor:
    """Return the share of each target interval, between edges [M + 1], that lies in each source interval: [M, N]."""
    upper = torch.minimum(target[1:, None], source[1:])
    lower = torch.maximum(target[:-1, None], source[:-1])
    return (upper - lower).clamp_min(0) / target.diff()[:, None]


def sphere_normals(
    size: int, *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> tuple[Tensor, Tensor]:
    """Return normals and mask of the sphere that touches the borders of a square picture of `size` px.

    Returns:
        Normals [3, size, size] of unit length at the pixels' centres, z >= 0, outside the disc the rim's normals; and
        bool [size, size], which pixels have their centre on the sphere.
    """
    centre = (torch.arange(size, dtype=torch.float64) + 0.5) * (2 / size) - 1
    x, y = centre.expand(size, size), -centre[:, None].expand(size, size)
    squared = x * x + y * y
    rim = squared.sqrt().clamp_min(1)
    normals = torch.stack([x / rim, y / rim, (1 - squared).clamp_min(0).sqrt()])
    return normals.to(device, dtype), (squared < 1).to(device)


def cosine_transfer(normals: Tensor, height: int, width: int) -> Tensor:
    """Compute light transport from a map [height, width] to white diffuse points with normals [P, 3].

    Entries are max(n . d, 0) * solid angle / pi at the texels' centres, rows scaled by their quadrature error to sum to
    1, so that a constant map gives itself; `cosine_transfer(...) @ maps.flatten(-2).mT` is radiance [..., P, 3].

    Args:
        normals: [P, 3], unit length.
        height: rows of the map.
        width: columns of the map.

    Returns:
        [P, height * width].
    """
    to_light, weights = _texel_quadrature(normals, height, width)
    return _normalize_rows((normals @ to_light).clamp_min(0) * weights)


def glossy_transfer(normals: Tensor, roughness: Tensor | float, height: int, width: int, *, samples: int = 1) -> Tensor:
    """Compute light transport from a map [height, width] to points of a rough mirror, seen from +z.

    It reflects by a GGX lobe with separable masking; rows are scaled to sum to 1, so that a constant map gives itself.

    Args:
        normals: [P, 3], unit length, z > 0; where z <= 0 the row is 0.
        roughness: in (0, 1]; GGX's alpha is its square.
        height: rows of the map.
        width: columns of the map.
        samples: samples of the lobe along each side of a texel. An alpha below about pi / (2 height samples) is
            undersampled.

    Returns:
        [P, height * width].
    """
    fine_size = height * samples, width * samples
    to_light, weights = _texel_quadrature(normals, *fine_size)
    incident, outgoing = normals @ to_light, normals[:, 2:]
    length = (2 + 2 * to_light[2]).clamp_min(torch.finfo(normals.dtype).eps).sqrt()  # length of d + (0, 0, 1)
    cosines = Cosines(incident, outgoing, (incident + outgoing) / length, length / 2)
    lobe = (
        microfacet_lobe(cosines, roughness * roughness, torch.ones_like).squeeze(-1) * incident.clamp_min(0) * weights
    )
    return _normalize_rows(lobe.reshape(-1, height, samples, width, samples).sum((2, 4)).flatten(1))


def _texel_quadrature(normals: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Return directions [3, H * W] of a map's texels and their solid angles over pi, [H * W], in the normals' dtype."""
    dtype, device = normals.dtype, normals.device
    weights = solid_angles(height, width, dtype=dtype, device=device).expand(height, width).flatten() / math.pi
    return texel_directions(height, width, dtype=dtype, device=device).flatten(1), weights


def _normalize_rows(rows: Tensor) -> Tensor:
    """Divide rows [P, N] >= 0 by their sums; zeros stay zeros."""
    return rows / rows.sum(-1, keepdim=True).clamp_min(torch.finfo(rows.dtype).tiny)
