"""Straight lines in pictures: whether a picture breaks the lines of its exemplar.

Joints, cracks, threads and fibres are lines that go on for many texels. A generator that loses them makes edges that
are as strong, but short. This is measured on the two pictures alone, which need not have a lattice, unlike in
:mod:`metapp.appearance.lattice`.
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance.lattice import remove_quadratic_trend

SMALLEST_SIDE_PX = 64  # least side of pictures that are measured, px
IGNORED_BORDER_PX = 16  # px left out at each side: exemplars do not tile, and filters by Fourier transforms assume it
LINE_LENGTH_WIDTHS = 8.0  # standard deviation of filters along a line, in widths of the line
QUANTILE_PX = 60_000  # number of px, at least, of which quantiles are taken where there are as many
# energies, in squared display values, below which lines and edges count as absent
FAINTEST_LINE_ENERGY = 1e-14
MIN_EDGE_ENERGY = 1e-9


def compare_lines(exemplar: Tensor, picture: Tensor) -> float:
    """Compare the straight lines of a picture with the lines of its exemplar, at the same scale.

    Args:
        exemplar: display values [C, H, W].
        picture: display values [C, h, w], of a texture that tiles.

    Returns:
        The strength of the picture's lines of 1 and 2 px relative to its edges, over the same strength of the exemplar:
        about 0.94 to 1.05 if lines are intact, less if they are broken. NaN if a picture has a side below
        SMALLEST_SIDE_PX or the exemplar has no edges.
    """
    smallest = min(*exemplar.shape[-2:], *picture.shape[-2:])
    if smallest < SMALLEST_SIDE_PX or _edge_energy(_gray(exemplar)) < MIN_EDGE_ENERGY:
        return math.nan
    return math.exp(_line_strength(_gray(picture)) - _line_strength(_gray(exemplar)))


def _gray(picture: Tensor) -> Tensor:
    """Return the mean of the channels of a picture [C, H, W] without its slow change, float32 on the CPU, [H, W]."""
    return remove_quadratic_trend(picture.float().cpu()).mean(0)


def _edge_energy(gray: Tensor) -> float:
    """Return the energy of short edges of 2 px that a tenth of all px exceed."""
    return _quantile(_strongest_response(gray, 2, 1.0), 0.9)


def _line_strength(gray: Tensor) -> float:
    """Return the logarithm of the strength of lines of 1 and 2 px relative to edges."""
    fine = [
        math.log(max(_quantile(_strongest_response(gray, width, LINE_LENGTH_WIDTHS), 0.95), FAINTEST_LINE_ENERGY))
        for width in (1, 2)
    ]
    return sum(fine) / len(fine) - math.log(max(_edge_energy(gray), MIN_EDGE_ENERGY))


def _strongest_response(gray: Tensor, width: int, length: float) -> Tensor:
    """Return the energy of edges and ridges along the direction where they are strongest, of px off the border, [N].

    Args:
        gray: a picture [H, W].
        width: standard deviation across edges in px, a power of 2, by which the picture is reduced first.
        length: standard deviation along edges, in widths.
    """
    small = avg_pool2d(gray[None], width)[0] if width > 1 else gray
    spectrum, strongest = torch.fft.fft2(small), torch.zeros(())
    for kernel in _directional_kernels(small.shape[0], small.shape[1], length):
        response = torch.fft.ifft2(spectrum * kernel)
        strongest = torch.maximum(strongest, response.real.square() + response.imag.square())
    border = min(max(6, IGNORED_BORDER_PX // width), (min(small.shape) - 1) // 2)
    return strongest[border:-border, border:-border].flatten()


@functools.lru_cache(maxsize=8)
def _directional_kernels(height: int, width: int, length: float) -> list[Tensor]:
    """Return the spectra [H, W] of derivatives of Gaussians in all directions, 1 px wide, without negative frequencies.

    Half of the spectrum alone makes responses complex, so that their energy is the same on an edge and on a ridge.
    """
    down = math.tau * torch.fft.fftfreq(height)[:, None]
    across = math.tau * torch.fft.fftfreq(width)[None]
    kernels, directions = [], 12 if length > 1 else 8
    for i in range(directions):
        angle = math.pi * i / directions
        along = math.cos(angle) * across + math.sin(angle) * down
        beside = math.cos(angle) * down - math.sin(angle) * across
        kernels.append(torch.exp(-0.5 * (beside.square() + (length * along).square())) * beside.clamp_min(0))
    return kernels


def _quantile(energies: Tensor, share: float) -> float:
    """Return a quantile of energies [N], by at least QUANTILE_PX of them and fewer than twice as many."""
    return float(torch.quantile(energies[:: max(1, len(energies) // QUANTILE_PX)], share))
