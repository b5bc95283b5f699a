"""A BRDF task of measured pairs of directions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from data_tools.readers import brdf_task
from metapp.appearance.geometry import directions_to_four_angles
from metapp.learning.task import Task

MIN_PAIRS = 4  # pairs of directions
MAX_PAIRS_ALL_SEEN = 1000  # with at most this many measurements, none is held out
MAX_REFLECTANCE_PER_SR = 1e9  # of a BRDF, in 1/sr
MAX_THETA_RAD = math.radians(89.999)  # from the normal: what is nearer to the surface is left out
AZIMUTH_TEST_PAIRS, AZIMUTH_TEST_NEIGHBOURS = (
    1_024,
    8,
)  # measurements that tell whether phi_h counts, and neighbours of each
MIN_AZIMUTH_EXPLAINED_SHARE = 0.1  # share of the squared differences of neighbours, from which on phi_h counts
MIN_AZIMUTH_TEST_PAIRS = 64  # measurements that tell so at least
MIN_HALF_THETA_RAD = math.radians(3)  # half vectors nearer to the normal have no azimuth to speak of


class MeasuredPairs(NamedTuple):
    """Measured pairs of directions.

    Attributes:
        wi, wo: unit vectors [N, 3] to light and detector, z the normal, float64.
        reflectance: linear RGB [N, 3] in 1/sr, >= 0, float64.
    """

    wi: Tensor
    wo: Tensor
    reflectance: Tensor

    def above(self) -> MeasuredPairs:
        """Those of which neither direction is along or below the surface."""
        rows = torch.minimum(self.wi[:, 2], self.wo[:, 2]) > math.cos(MAX_THETA_RAD)
        return MeasuredPairs(self.wi[rows], self.wo[rows], self.reflectance[rows])


def task_of_pairs(name: str, pairs: MeasuredPairs, source: str | Path = "") -> Task:
    """Measurements above the surface as a BRDF task; `source` is the file that errors name.

    The samples are the measurements, in random order, half of them for fits to see; of FEW at most, fits
    see all of them. Those of the same half and difference angles, to 1e-5 rad, are averaged, since a held-out sample
    must not have been seen. There is no picture of a sphere: it would be interpolated, and no reference.

    Returns:
        angles [N, 3] rad, reflectance [N, 3] in 1/sr, linear RGB, float32; phi_h [N] if that counts, as
        `depends_on_azimuth` says.

    Raises:
        ValueError: too few measurements.
    """
    angles = directions_to_four_angles(pairs.wi, pairs.wo)
    azimuths = depends_on_azimuth(angles, pairs.reflectance)
    angles, reflectance = angles if azimuths else angles[:, :3], pairs.reflectance
    if len(angles):
        angles, reflectance = _distinct(angles, reflectance)
    if len(angles) < MIN_PAIRS:
        found = f"different pairs of directions: {len(angles)} of {len(pairs.wi)}"
        raise ValueError(f"{source or name}: {found}, expected {MIN_PAIRS} or more; measure more.")
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))
    if len(order) <= MAX_PAIRS_ALL_SEEN:
        order = order.repeat(2)
    samples = brdf_task.angle_tensors(angles[order].float())
    return Task(name, {**samples, "reflectance": reflectance[order].float()})


def depends_on_azimuth(angles: Tensor, reflectance: Tensor) -> bool:
    """True if reflectance [N, 3] depends on phi_h of angles [N, 4] rad: if that explains how neighbours differ.

    By least squares of differences of log reflectance on differences of the first two harmonics of phi_h, which noise
    does not follow. Measurements at one azimuth count as isotropic.
    """
    tilted = angles[:, 0] > MIN_HALF_THETA_RAD
    angles, values = angles[tilted], torch.log(reflectance[tilted].mean(1) + 1e-3)
    if len(angles) < MIN_AZIMUTH_TEST_PAIRS:
        return False
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))[:AZIMUTH_TEST_PAIRS]
    points = _points(angles[:, :3])
    nearest = [
        torch.cdist(part, points).topk(1 + AZIMUTH_TEST_NEIGHBOURS, largest=False).indices
        for part in points[order].split(512)
    ]
    first, second = order.repeat_interleave(AZIMUTH_TEST_NEIGHBOURS), torch.cat(nearest)[:, 1:].reshape(-1)
    phi_h = angles[:, 3]
    waves = torch.stack([phi_h.cos(), phi_h.sin(), (2 * phi_h).cos(), (2 * phi_h).sin()], 1).double()
    changes, difference = waves[first] - waves[second], (values[first] - values[second]).double()
    total = float(difference.square().sum())
    gram = changes.T @ changes + 1e-9 * len(changes) * torch.eye(4, dtype=torch.float64)
    moment = changes.T @ difference
    # a few numbers explain a share of noise, too
    explained = float(moment @ torch.linalg.solve(gram, moment)) - 4 * total / len(order)
    return total > 0 and explained > MIN_AZIMUTH_EXPLAINED_SHARE * total


def _distinct(angles: Tensor, reflectance: Tensor) -> tuple[Tensor, Tensor]:
    """The measurements with one mean value for those of the same angles."""
    places = (angles * 1e5).round().long()
    places -= places.amin(0)
    key = places[:, 0]
    for column in places.T[1:]:  # a number for each row, in the order of rows; ten times as fast as unique rows
        key = torch.unique(key, return_inverse=True)[1] * (column.max() + 1) + column
    _, inverse, count = torch.unique(key, return_inverse=True, return_counts=True)

    def mean(values: Tensor) -> Tensor:
        total = torch.zeros(len(count), values.shape[1], dtype=values.dtype).index_add(0, inverse, values)
        result: Tensor = total / count[:, None]
        return result

    return mean(angles), mean(reflectance)


def _points(angles: Tensor) -> Tensor:
    """Angles [N, 3] as points [N, 4] whose distances say how alike they are: highlights are narrow."""
    theta_h, theta_d, phi_d = angles.double().unbind(-1)
    turn = 2 * phi_d  # by reciprocity phi_d + pi is phi_d
    return torch.stack([2 * theta_h.sqrt(), theta_d, theta_d * turn.cos() / 2, theta_d * turn.sin() / 2], -1)
