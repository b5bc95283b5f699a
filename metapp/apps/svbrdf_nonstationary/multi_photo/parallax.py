"""Heights of a surface by the parallax between photographs of it, and photographs from which parallax is removed.

Photographs are registered on a plane. What lies above or below the plane moves from one photograph to the next, by more
texels than shading can be compared over. So each texel's height is searched first, by a plane sweep (Collins 1996): all
photographs are projected onto planes of many heights, and at each texel they agree best at the height of the surface.
Shading differs between the photographs, since the flash moves with the camera; so contrast is compared, not brightness.
Then each photograph is read where it shows the surface, such that all show a point of it at the same texel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, conv2d, grid_sample, interpolate, pad

from metapp.appearance.flash import texel_positions

RELIEF_CHANNELS = 3  # of :meth:`Heights.describe`
MIN_PX = 32  # sides of photographs below which nothing is searched
MAX_HEIGHT_HALF_SIDES = 0.08  # of the planes above and below the one by which photographs are registered
PLANE_DISTANCE_TEXELS = 0.5  # by which a photograph moves from plane to plane, at most, on average over the patch
FINE_PLANES = 4  # planes above, and below, of a second sweep at twice the size
MIN_PARALLAX = 0.05  # displacement over height: with less, cameras are at one place and show no heights
UNKNOWN_DEVIATION = math.sqrt(2 / 3)  # of heights without parallax, in distances of planes: of three alike planes
CONTRAST_TEXELS = 5.0  # standard deviation of the window in which mean and contrast of photographs are made alike
MIN_CONTRAST = 0.02  # log radiance that is added to the contrast of the windows, so that noise is not raised to it
WINDOWS_TEXELS = (2.0, 4.0, 8.0)  # standard deviations of the windows over which agreement is averaged
AGREEMENT_SHARPNESS = 30.0  # factor of agreement, which is at most 1, in the log probability of a height
SMOOTHING_TEXELS = 2.0  # standard deviation of the window over which heights are averaged
MAX_SLOPE = 2.0  # of heights as networks read them
CONTRAST_LIGHT_FLOOR = 0.02  # radiance, 1 is white, that is added before logs


class Heights(NamedTuple):
    """Heights of a surface above the plane by which its photographs are registered.

    Attributes:
        height: the heights, [H, W], in half sides of the patch.
        deviation: the standard deviation of the heights by which photographs agree, [H, W], in distances of planes.
    """

    height: Tensor
    deviation: Tensor

    @classmethod
    def unknown(cls, like: Tensor) -> Heights:
        """Return heights of 0 of the form of a tensor [H, W], as of photographs without parallax."""
        return cls(torch.zeros_like(like), torch.full_like(like, UNKNOWN_DEVIATION))

    def describe(self) -> Tensor:
        """Return what networks read of the heights: slopes x and y, and half the log of the deviation, [3, H, W].

        Slopes are x and y over z of the normals of the surface, y up.
        """
        side = 2 / self.height.shape[-1]
        down, right = torch.gradient(_blur(self.height, 1.0), spacing=side, dim=(-2, -1))
        slopes = torch.stack([-right, down]).clamp(-MAX_SLOPE, MAX_SLOPE)
        return torch.cat([slopes, (self.deviation + 0.1).log()[None] / 2])


@torch.no_grad()
def find_heights(photos: Tensor, eyes: Tensor, size: tuple[int, int]) -> Heights:
    """Find the height at which photographs agree at each texel of the first one.

    A first sweep at `size` covers all heights; a second one, at twice the size where photographs are as fine, the
    heights around what the first one has found.

    Args:
        photos: linear photographs [N, 3, H, W], registered on a plane.
        eyes: the positions of the camera, [N, 3], in half sides of the patch.
        size: the height and width of the result in texels.

    Returns:
        The heights, of the given size; all are 0 where there is one photograph, all are small or all are taken from one
        place.

    Source: Collins, "A Space-Sweep Approach to True Multi-Image Matching" (1996).
    """
    coarse = adaptive_avg_pool2d(photos, size)
    mean_rate = float(_parallax(coarse, eyes).norm(dim=1).mean((1, 2)).amax())
    unknown = Heights.unknown(coarse[0, 0])
    if min(size) < MIN_PX or not mean_rate > MIN_PARALLAX:
        return unknown
    distance = PLANE_DISTANCE_TEXELS * 2 / size[1] / mean_rate
    heights = _sweep(coarse, eyes, unknown.height, distance, int(MAX_HEIGHT_HALF_SIDES / distance))
    fine_size = (2 * size[0], 2 * size[1])
    if photos.shape[-2] < fine_size[0] or photos.shape[-1] < fine_size[1]:
        return heights
    middle = interpolate(heights.height[None, None], fine_size, mode="bilinear")[0, 0]
    fine = _sweep(adaptive_avg_pool2d(photos, fine_size), eyes, middle, distance / 2, FINE_PLANES)
    # deviations are in distances of planes, which are twice as far apart at half the size
    return Heights(*(adaptive_avg_pool2d(values[None], size)[0] for values in (fine.height, fine.deviation / 2)))


def _sweep(photos: Tensor, eyes: Tensor, middle: Tensor, distance: float, count: int) -> Heights:
    """Find the heights at which photographs agree, among `count` planes on either side of others.

    Args:
        photos: linear photographs [N, 3, H, W].
        eyes: the positions of the camera, [N, 3], in half sides of the patch.
        middle: heights around which others are tried, [H, W].
        distance: the distance of planes, in half sides.
        count: the number of planes above, and of planes below.
    """
    rates = _parallax(photos, eyes)[1:]
    heights = middle + distance * torch.arange(-count, count + 1).to(photos)[:, None, None]
    contrast = _even_out((photos.mean(1) + CONTRAST_LIGHT_FLOOR).log())[:, None]
    agreement = torch.stack(
        [(contrast[:1] * read_displaced(contrast[1:], height * rates)).mean((0, 1)) for height in heights]
    )
    agreement = torch.stack([_blur(agreement, window) for window in WINDOWS_TEXELS]).mean(0)
    probability = torch.softmax(AGREEMENT_SHARPNESS * agreement, 0)
    mean = (probability * heights).sum(0)
    variance = (probability * (heights - mean).square()).sum(0)
    weight = 1 / (variance + distance**2)
    smooth = _blur(weight * mean, SMOOTHING_TEXELS) / _blur(weight, SMOOTHING_TEXELS)
    return Heights(smooth, variance.sqrt() / distance)


@torch.no_grad()
def remove_parallax(photos: Tensor, eyes: Tensor, height: Tensor) -> Tensor:
    """Read photographs where they show the surface, such that each point of it is at one texel in all of them.

    Args:
        photos: linear photographs [N, 3, H, W], registered on a plane.
        eyes: the positions of the camera, [N, 3], in half sides of the patch.
        height: the heights of the surface above the plane, [H, W], in half sides of the patch.

    Returns:
        The photographs, [N, 3, H, W]; the first one stays as it is.
    """
    if not height.any():
        return photos
    moved = read_displaced(photos[1:], height * _parallax(photos, eyes)[1:]).clamp(0, 1)
    return torch.cat([photos[:1], moved])


def _parallax(photos: Tensor, eyes: Tensor) -> Tensor:
    """Return by how much photographs move against the first one, as the surface rises, [N, 2, H, W], x and y up."""
    texels = texel_positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)
    rates = (texels - eyes[:, :2, None, None]) / eyes[:, 2:, None, None]
    return rates - rates[:1]


def read_displaced(pictures: Tensor, displacements: Tensor, padding: str = "border") -> Tensor:
    """Read pictures at displaced positions, by cubic interpolation.

    Args:
        pictures: the pictures, [N, C, H, W].
        displacements: how far from each texel to read, x and y up, in half sides, [N, 2, H, W].
        padding: what lies beyond the pictures: `padding_mode` of torch's `grid_sample`.
    """
    texels = texel_positions(*pictures.shape[-2:], dtype=pictures.dtype, device=pictures.device)
    grid = (texels + displacements) * texels.new_tensor([1, -1])[:, None, None]
    read: Tensor = grid_sample(pictures, grid.permute(0, 2, 3, 1), "bicubic", padding, align_corners=False)
    return read


def _even_out(pictures: Tensor) -> Tensor:
    """Give pictures [N, H, W] a mean of 0 and a contrast of 1 in all windows."""
    detail = pictures - _blur(pictures, CONTRAST_TEXELS)
    return detail / (_blur(detail.square(), CONTRAST_TEXELS).sqrt() + MIN_CONTRAST)


def _blur(pictures: Tensor, deviation: float) -> Tensor:
    """Return weighted means of pictures [..., H, W] over Gaussian windows of a standard deviation in texels."""
    margin = int(3 * deviation)
    kernel = torch.exp(-torch.arange(-margin, margin + 1).to(pictures).square() / (2 * deviation**2))
    row = (kernel / kernel.sum())[None, None, None]
    planes = pictures.reshape(-1, 1, *pictures.shape[-2:])
    planes = conv2d(pad(planes, (margin, margin, 0, 0), "replicate"), row)
    return conv2d(pad(planes, (0, 0, margin, margin), "replicate"), row.mT).reshape(pictures.shape)
