"""Photographs under other lamps, by a Gaussian process over light directions.

At each pixel the display value is a function of the direction to the lamp: a random function whose covariance is the
same everywhere. What it is under an unseen lamp, given the values under N lamps, is a sum over these with weights that
no pixel changes (Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, section 2.2). So are the
values that a photograph would have if it were left out (section 5.4.2), by which the covariance is chosen.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import torch
from torch import Tensor

LINEAR_VARIANCE = 3.0  # of a constant and of each component of the direction: matt shading is linear in it
# Candidates of which each object takes the best: deviations along z count ELONGATIONS times as much as along x and y.
LENGTHS, ELONGATIONS, NOISES = (1.2, 1.8, 2.7), (1.0, 1.5, 2.2), (1e-3, 3e-3, 1e-2, 3e-2)
COMPARED_PIXELS = 6000  # by which the candidates are compared
PIXELS_AT_ONCE = 65_536  # of a photograph
LEAST_ERROR = 1e-3  # root mean square of display values below which errors count as equal


class LightProcess(NamedTuple):
    """A Gaussian process over directions to lamps, whose variance of display values in [0, 1] is about 1.

    Attributes:
        length: length over which values stay alike, in the space of directions.
        elongation: the factor by which differences along z count.
        noise: variance of the noise of a photograph.

    >>> lamps = torch.nn.functional.normalize(torch.tensor([[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]), dim=1)
    >>> LightProcess(1.8, 1.5, 1e-3).interpolation(lamps, lamps).diag().round(decimals=1)
    tensor([1., 1., 1., 1.])
    """

    length: float
    elongation: float
    noise: float

    def covariance(self, first: Tensor, second: Tensor) -> Tensor:
        """Return the covariance of values under lamps [K, 3] and [N, 3], [K, N]: linear, and Matern's of order 3/2."""
        scale = first.new_tensor([1.0, 1.0, self.elongation]) / self.length
        distance = math.sqrt(3) * torch.cdist(
            first * scale, second * scale, compute_mode="donot_use_mm_for_euclid_dist"
        )
        return LINEAR_VARIANCE * (1 + first @ second.T) + (1 + distance) * (-distance).exp()

    def interpolation(self, directions: Tensor, lamps: Tensor) -> Tensor:
        """Return the weights of photographs in a picture under each of K lamps, [K, N], which sum to about 1.

        Args:
            directions: unit vectors towards the K lamps, [K, 3].
            lamps: unit vectors towards the lamps of the N photographs, [N, 3].
        """
        directions, lamps = directions.double(), lamps.double()
        weights: Tensor = torch.linalg.solve(self._noisy_covariance(lamps), self.covariance(lamps, directions))
        return weights.T.float()

    def leaving_one_out(self, lamps: Tensor) -> Tensor:
        """Return the weights of photographs in the prediction of each of them by all others, [N, N]; 0 on the diagonal.

        Args:
            lamps: unit vectors towards the lamps of the N photographs, [N, 3].
        """
        inverse: Tensor = torch.linalg.inv(self._noisy_covariance(lamps.double()))
        weights = -inverse / inverse.diagonal()[:, None]
        return weights.fill_diagonal_(0).float()

    def _noisy_covariance(self, lamps: Tensor) -> Tensor:
        return self.covariance(lamps, lamps) + self.noise * torch.eye(len(lamps), dtype=lamps.dtype)


def choose_process(photos: Tensor, lamps: Tensor) -> LightProcess:
    """Choose the process that best predicts each photograph by all others.

    Args:
        photos: photographs, sRGB uint8 [N, 3, H, W].
        lamps: unit vectors towards their lamps, [N, 3].
    """
    candidates = itertools.starmap(LightProcess, itertools.product(LENGTHS, ELONGATIONS, NOISES))
    return max(candidates, key=lambda process: float(left_out_db(process, photos, lamps).mean()))


def left_out_db(process: LightProcess, photos: Tensor, lamps: Tensor) -> Tensor:
    """Return how well each photograph is predicted by all others, as the PSNR of display values in dB, [N].

    Args:
        process: the process that predicts it.
        photos: photographs, sRGB uint8 [N, 3, H, W].
        lamps: unit vectors towards their lamps, [N, 3].
    """
    values = sample_pixels(photos)
    errors = process.leaving_one_out(lamps) @ values - values
    return -10 * (errors.square().mean(1) + LEAST_ERROR**2).log10()


def left_out_gain_db(photos: Tensor, lamps: Tensor) -> float:
    """Return by how much directions to lamps predict photographs better than the mean photograph does, in dB.

    See :func:`left_out_db` for the arguments.
    """
    values = sample_pixels(photos)
    mean_db = -10 * ((values - values.mean(0)).square().mean(1) + LEAST_ERROR**2).log10()
    return float((left_out_db(choose_process(photos, lamps), photos, lamps) - mean_db).mean())


def sample_pixels(photos: Tensor) -> Tensor:
    """Return display values of about COMPARED_PIXELS evenly spread pixels of photographs, [N, 3 P] in [0, 1]."""
    values = photos.flatten(2)
    step = max(1, values.shape[-1] // COMPARED_PIXELS)
    return values[..., step // 2 :: step].flatten(1).float() / 255


def mix_photos(weights: Tensor, photos: Tensor) -> Tensor:
    """Return weighted sums of photographs, as display values [K, 3, H, W] of about 0 to 1.

    Args:
        weights: the weight of each photograph in each of K pictures, [K, N].
        photos: photographs, sRGB uint8 [N, 3, H, W].
    """
    channels, height, width = photos.shape[1:]
    pictures = torch.empty(len(weights), channels, height, width)
    # few rows at a time: as floats the photographs take four times their memory
    step = max(1, PIXELS_AT_ONCE // width)
    for top in range(0, height, step):
        strip = photos[:, :, top : top + step].float() / 255
        pictures[:, :, top : top + step] = (weights @ strip.flatten(1)).unflatten(1, strip.shape[1:])
    return pictures
