"""The axes of light directions, which photographs tell: y may point down, or x and y may be swapped.

Slopes found with directions in other axes are reflected or turned, and are then those of no surface: their curl, which
is 0 for a surface, is large. Of the eight readings of x and y each two that differ by half a turn are alike, since
they swap dents and bumps alone. The one nearest to the text is taken of such two.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.apps.svbrdf_nonstationary.multi_photo.integrability import find_curl

# Readings of x and y as others, [2, 2] matrices by which directions are multiplied, and in words
AXES = {
    "": ((1.0, 0.0), (0.0, 1.0)),
    "y points down": ((1.0, 0.0), (0.0, -1.0)),
    "x and y are swapped": ((0.0, 1.0), (1.0, 0.0)),
    "x and y are turned by 90 degrees": ((0.0, -1.0), (1.0, 0.0)),
}
COMPARED_SIDE_PX = 64  # longer side of the photographs that are compared; noise and glints are averaged
LEAST_Z = 0.2  # least z of normals whose slopes are compared
# Another reading is taken if its curl is below this share of the text's. With right texts it was 0.87 or more in
# renderings of 120 reliefs with shadows and highlights. On flat prints by a camera that moved it was as low as 0.24,
# but 0.51 or more where slopes change by more than the next constant.
MAX_CURL_RATIO = 0.45
LEAST_SLOPE_CHANGE = 0.06  # root mean square from px to px, as a mean tilt of 3 to 4 degrees has
RIDGE = 1e-4  # of the least squares, over the number of photographs


class LightAxes(NamedTuple):
    """A reading of the axes of light directions.

    Attributes:
        name: what the directions have in other axes than the text says, in words; "" if they are as it says.
        axes: the matrix by which x, y and z of the text are multiplied, [3, 3].
        stated_curl: the squared curl of slopes with the directions of the text, over their squared changes: 0 for a
            surface, 0.5 for noise.
        curl: this for the axes that were taken.
    """

    name: str
    axes: Tensor
    stated_curl: float
    curl: float


def find_axes(photos: Tensor, directions: Tensor) -> LightAxes:
    """Find which axes light directions have, by which slopes of least squares belong most to one surface.

    The text's reading is kept unless the curl of another is below MAX_CURL_RATIO of its curl, and where the relief is
    so low that albedo tells of slopes.

    Args:
        photos: linear grey photographs by a camera that stands still, of any resolution, [N, H, W].
        directions: unit vectors towards the lights, x right, y up, z towards the camera, [N, 3].
    """
    slopes = _solve_slopes(photos, directions)
    # slopes turn as directions do, so that one solve tells all readings
    readings = torch.stack(
        [torch.einsum("ij,jhw->ihw", torch.tensor(axes).to(slopes), slopes) for axes in AXES.values()]
    )
    squares = find_curl(readings).square().mean((1, 2))
    changes = squares.sum() / 2  # squared changes of both slopes to the right and upwards
    curls = dict(zip(AXES, (squares / changes.clamp_min(torch.finfo(squares.dtype).tiny)).tolist(), strict=True))
    best = min(curls, key=lambda name: curls[name])
    is_clear = curls[best] < MAX_CURL_RATIO * curls[""] and float(changes) > LEAST_SLOPE_CHANGE**2
    name = best if is_clear else ""
    axes = torch.block_diag(torch.tensor(AXES[name]), torch.ones(1, 1)).to(directions)
    return LightAxes(name, axes, curls[""], curls[name])


def _solve_slopes(photos: Tensor, directions: Tensor) -> Tensor:
    """Return slopes, x and y over z of normals, [2, h, w], of Lambertian texels by least squares.

    Args:
        photos: linear grey photographs, [N, H, W].
        directions: unit vectors towards the lights, [N, 3].
    """
    scale = min(1.0, COMPARED_SIDE_PX / max(photos.shape[1:]))
    height, width = (max(2, round(side * scale)) for side in photos.shape[1:])
    small = adaptive_avg_pool2d(photos[None].double(), (height, width))[0]
    lights = directions.double()
    ridge = RIDGE * len(lights) * torch.eye(3, dtype=lights.dtype)
    normals = torch.linalg.solve(lights.T @ lights + ridge, lights.T @ small.flatten(1))
    z = normals[2].maximum(LEAST_Z * normals.norm(dim=0)).clamp_min(torch.finfo(normals.dtype).tiny)
    slopes: Tensor = (normals[:2] / z).reshape(2, height, width)
    return slopes
