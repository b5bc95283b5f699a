"""BRDF tasks of measured pairs of directions, which a goniometer or arrays in memory give.

Nothing is interpolated, and no pictures are made of measurements; repeated ones alone are averaged.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from data_tools.readers import brdf_task
from metapp.appearance.geometry import directions_to_four_angles
from metapp.learning.task import Task

MIN_PAIRS = 4  # different pairs of directions that a task needs
MAX_PAIRS_ALL_SEEN = 1000  # with at most this many measurements, none is held out
MAX_REFLECTANCE_PER_SR = 1e9  # a BRDF's largest value; larger ones are a mistake
MAX_THETA_RAD = math.radians(89.999)  # angle from the normal; measurements closer to the surface are left out
# Measurements that are compared to tell whether phi_h counts, and the neighbours that each is compared with.
AZIMUTH_TEST_PAIRS, AZIMUTH_TEST_NEIGHBOURS = 1_024, 8
MIN_AZIMUTH_EXPLAINED_SHARE = 0.1  # of squared differences of neighbours, from which on phi_h counts
MIN_AZIMUTH_TEST_PAIRS = 64  # fewer measurements count as isotropic
MIN_HALF_THETA_RAD = math.radians(3)  # half vectors closer to the normal have no meaningful azimuth


class MeasuredPairs(NamedTuple):
    """Measured pairs of directions.

    Attributes:
        wi: unit vectors [N, 3] to the light, z the normal, float64.
        wo: unit vectors [N, 3] to the detector, float64.
        reflectance: linear RGB [N, 3] in 1/sr, >= 0, float64.
    """

    wi: Tensor
    wo: Tensor
    reflectance: Tensor

    def above(self) -> MeasuredPairs:
        """Return the pairs of which neither direction is along or below the surface."""
        rows = torch.minimum(self.wi[:, 2], self.wo[:, 2]) > math.cos(MAX_THETA_RAD)
        return MeasuredPairs(self.wi[rows], self.wo[rows], self.reflectance[rows])


def task_of_pairs(name: str, pairs: MeasuredPairs, source: str | Path = "") -> Task:
    """Make the BRDF task of measurements, all of which must lie above the surface.

    The samples are the measurements, in random order: the first half is for fits to see, the second is held out. Of
    MAX_PAIRS_ALL_SEEN or fewer, both halves hold all measurements. Measurements of equal angles, to 1e-5 rad, are
    averaged, since a held-out sample must not have been seen. There is no picture of a sphere, which would have to be
    interpolated and so could not serve as a reference.

    Args:
        name: the name of the task.
        pairs: the measurements.
        source: the file that errors name; "" for the task's name.

    Returns:
        A task with float32 tensors: angles [N, 3] in rad, reflectance [N, 3] in 1/sr, linear RGB; phi_h [N] in rad if
        :func:`depends_on_azimuth` says that it counts.

    Raises:
        ValueError: there are too few measurements.
    """
    angles = directions_to_four_angles(pairs.wi, pairs.wo)
    azimuths = depends_on_azimuth(angles, pairs.reflectance)
    angles, reflectance = angles if azimuths else angles[:, :3], pairs.reflectance
    if len(angles):
        angles, reflectance = _merge_duplicates(angles, reflectance)
    if len(angles) < MIN_PAIRS:
        found = f"different pairs of directions: {len(angles)} of {len(pairs.wi)}"
        raise ValueError(f"{source or name}: {found}, expected {MIN_PAIRS} or more; measure more.")
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))
    if len(order) <= MAX_PAIRS_ALL_SEEN:
        order = order.repeat(2)
    samples = brdf_task.angle_tensors(angles[order].float())
    return Task(name, {**samples, "reflectance": reflectance[order].float()})


def depends_on_azimuth(angles: Tensor, reflectance: Tensor) -> bool:
    """Tell whether measured reflectance depends on phi_h: whether phi_h explains how neighbours differ.

    Differences of log reflectance are fitted by least squares of differences of the first two harmonics of phi_h, which
    noise does not follow. Measurements at one azimuth count as isotropic.

    Args:
        angles: theta_h, theta_d, phi_d and phi_h in rad, [N, 4].
        reflectance: reflectance in 1/sr, [N, 3].
    """
    tilted = angles[:, 0] > MIN_HALF_THETA_RAD
    angles, values = angles[tilted], torch.log(reflectance[tilted].mean(1) + 1e-3)
    if len(angles) < MIN_AZIMUTH_TEST_PAIRS:
        return False
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))[:AZIMUTH_TEST_PAIRS]
    points = _comparison_points(angles[:, :3])
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
    # four fitted numbers explain a share of noise, too, which is subtracted
    explained = float(moment @ torch.linalg.solve(gram, moment)) - 4 * total / len(order)
    return total > 0 and explained > MIN_AZIMUTH_EXPLAINED_SHARE * total


def _merge_duplicates(angles: Tensor, reflectance: Tensor) -> tuple[Tensor, Tensor]:
    """Average measurements of equal angles, to 1e-5 rad.

    Args:
        angles: angles in rad, [N, 3 or 4].
        reflectance: reflectance in 1/sr, [N, 3].

    Returns:
        Distinct angles and their reflectance, in the order of angles.
    """
    rounded_angles = (angles * 1e5).round().long()
    rounded_angles -= rounded_angles.amin(0)
    row_keys = rounded_angles[:, 0]
    # one key for each row, in the order of rows: ten times as fast as torch.unique of rows
    for column in rounded_angles.T[1:]:
        row_keys = torch.unique(row_keys, return_inverse=True)[1] * (column.max() + 1) + column
    _, inverse, count = torch.unique(row_keys, return_inverse=True, return_counts=True)

    def mean(values: Tensor) -> Tensor:
        total = torch.zeros(len(count), values.shape[1], dtype=values.dtype).index_add(0, inverse, values)
        result: Tensor = total / count[:, None]
        return result

    return mean(angles), mean(reflectance)


def _comparison_points(angles: Tensor) -> Tensor:
    """Map angles [N, 3] in rad to points [N, 4] whose distances say how alike the angles are; highlights are narrow."""
    theta_h, theta_d, phi_d = angles.double().unbind(-1)
    doubled_phi_d = 2 * phi_d  # doubled, since by reciprocity phi_d + pi is phi_d
    return torch.stack(
        [2 * theta_h.sqrt(), theta_d, theta_d * doubled_phi_d.cos() / 2, theta_d * doubled_phi_d.sin() / 2], -1
    )
