"""BRDF tasks made of reflectance that was measured at pairs of directions, such as by a goniometer.

Measurements are neither interpolated nor rendered as a picture. Only repeated ones are changed: they are averaged. Of
an anisotropic material these are measurements of equal theta_h, theta_d, phi_d and phi_h; of an isotropic one they may
differ in phi_h, the azimuth of the half vector, on which its reflectance does not depend.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.numbers import Doubles
from metapp.appearance.geometry import directions_to_four_angles
from metapp.learning.task import Task

MIN_PAIRS = 4  # least number of samples of a task, after repeated measurements were averaged
MAX_PAIRS_ALL_SEEN = 1000  # largest number of samples of which none is held out: fits see all, and errors use all
MAX_REFLECTANCE_PER_SR = 1e9  # a BRDF's largest value; larger ones are a mistake
MAX_NOISE_SHARE = 0.25  # of the largest value; values no further below 0 than this are noise
MAX_THETA_RAD = math.radians(89.999)  # angle from the normal; measurements closer to the surface are left out
MAX_REPEAT_DEVIATION = 0.2  # of repeated measurements over their mean, above which a line says so
# The test whether reflectance depends on phi_h, the azimuth of the half vector
AZIMUTH_TEST_PAIRS = 1_024  # number of measurements, at most, that are compared with their neighbours
AZIMUTH_TEST_NEIGHBOURS = 8  # number of neighbours that each of them is compared with
MAX_DISTANCES = 1 << 24  # number of distances, at most, that are in memory while neighbours are sought: 128 MB
MIN_AZIMUTH_EXPLAINED_SHARE = 0.1  # share of the squared differences of neighbours that phi_h must explain
MIN_AZIMUTH_TEST_PAIRS = 64  # number of measurements below which a material counts as isotropic without a test
MIN_HALF_THETA_RAD = math.radians(3)  # angle from the normal below which a half vector has no meaningful azimuth

_ANGLE_STEP_RAD = 1e-5  # angles that are equal after rounding to it are one sample's


class MeasuredPairs(NamedTuple):
    """The reflectance that was measured at N pairs of directions.

    Attributes:
        wi: unit vectors [N, 3] to the light, in a frame whose z axis is the normal, float64.
        wo: unit vectors [N, 3] to the detector, float64.
        reflectance: linear RGB [N, 3] in 1/sr, >= 0, float64.
    """

    wi: Tensor
    wo: Tensor
    reflectance: Tensor

    def above(self, subject: str | Path) -> MeasuredPairs:
        """Return the pairs whose directions are both within MAX_THETA_RAD of the normal, and warn of others.

        Args:
            subject: the file or name that errors name.

        Raises:
            ValueError: there are pairs, but none of these.
        """
        rows = torch.minimum(self.wi[:, 2], self.wo[:, 2]) > math.cos(MAX_THETA_RAD)
        if len(rows) and not rows.any():
            raise ValueError(
                f"{subject}: light or detector of all {len(rows):,} pairs of directions is along or below the surface, "
                f"expected {MIN_PAIRS} or more pairs with both above it; measure at less than 90 degrees."
            )
        if left_out := len(rows) - int(rows.sum()):
            warnings.warn(
                f"{subject}: {left_out:,} of {len(rows):,} pairs of directions are left out: light or detector is "
                "along or below the surface.",
                stacklevel=2,
            )
        return MeasuredPairs(self.wi[rows], self.wo[rows], self.reflectance[rows])

    def draw(self, count: int) -> MeasuredPairs:
        """Return at most `count` of the pairs, drawn at random with a fixed seed, in their order."""
        rows = torch.randperm(len(self.wi), generator=torch.Generator().manual_seed(0))[:count].sort().values
        return MeasuredPairs(self.wi[rows], self.wo[rows], self.reflectance[rows])


def find_bad_reflectance(subject: str | Path, values: Doubles) -> tuple[int, int, str] | None:
    """Find the first measured value that is no reflectance, and warn of noise below 0.

    Values below 0 are noise, such as remains after a dark reading was subtracted, if they are small beside the largest
    one. Negative whole numbers are not: -1 and -999 stand for values that were not measured.

    Args:
        subject: the file or name that the warning names.
        values: measured values in 1/sr, [N, C].

    Returns:
        The row and the column of the value, and what was expected and what to do; None if all values are good or noise.
    """
    is_reflectance = (values >= 0) & (values <= MAX_REFLECTANCE_PER_SR)
    largest = float(values[is_reflectance].max(initial=0.0))
    is_noise = (values < 0) & (values >= -MAX_NOISE_SHARE * largest) & (values != np.round(values))
    is_bad = ~(is_reflectance | is_noise)
    if is_bad.any():
        row, column = np.argwhere(is_bad)[0]
        expected = f"0 to {MAX_REFLECTANCE_PER_SR:g} in 1/sr"
        if np.isnan(values[row, column]):
            return row, column, f"{expected}; fill in what a plan asks for, and leave out rows that were not measured"
        if values[row, column] < 0:
            expected += f", or noise down to {-MAX_NOISE_SHARE * largest:.2g}, a quarter of the largest value"
        return row, column, f"{expected}; leave out rows that were not measured"
    if count := int(is_noise.sum()):
        found = f"{count:,} of {values.size:,} values below 0, down to {values.min():.3g} /sr"
        warnings.warn(f"{subject}: {found}, expected 0 or more; taken for noise and set to 0", stacklevel=2)
    return None


def task_of_pairs(name: str, pairs: MeasuredPairs, source: str | Path = "") -> Task:
    """Make a BRDF task of measurements, all of which must lie above the surface.

    Repeated measurements become one sample, see :func:`merge_repeats`. The task holds the N samples in random order:
    fits see the first half, and the second half is held out. If there are at most MAX_PAIRS_ALL_SEEN samples, the task
    holds all of them twice, so that fits see all, and errors are measured on what fits have seen. The task has no
    picture of a sphere: it would have to be interpolated and so could not serve as a reference.

    Args:
        name: the name of the task.
        pairs: the measurements.
        source: the file that errors name; "" for the task's name.

    Returns:
        A task with float32 tensors: `angles` (theta_h, theta_d and phi_d) in rad and `reflectance` in 1/sr, linear RGB,
        [N, 3] each, or [2 N, 3] if all samples are held twice; of an anisotropic material also `phi_h` in rad, [N] or
        [2 N].

    Raises:
        ValueError: there are fewer than MIN_PAIRS samples.
    """
    angles, reflectance = merge_repeats(pairs)
    if len(angles) < len(pairs.wi) and (deviation := deviation_of_repeats(pairs)) > MAX_REPEAT_DEVIATION:
        warnings.warn(
            f"{source or name}: repeated measurements differ by {100 * deviation:.0f} % of their mean, expected up to "
            f"{100 * MAX_REPEAT_DEVIATION:.0f} %; their means are fitted: are they of one material, and in one unit?",
            stacklevel=2,
        )
    if len(angles) < MIN_PAIRS:
        found = f"different pairs of directions: {len(angles)} of {len(pairs.wi)}"
        raise ValueError(f"{source or name}: {found}, expected {MIN_PAIRS} or more; measure more.")
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))
    if len(order) <= MAX_PAIRS_ALL_SEEN:
        order = order.repeat(2)
    samples = brdf_task.angle_tensors(angles[order])
    return Task(name, {**samples, "reflectance": reflectance[order].float()})


def merge_repeats(pairs: MeasuredPairs) -> tuple[Tensor, Tensor]:
    """Average measurements of equal angles, to _ANGLE_STEP_RAD, into one sample.

    Otherwise a fit could see a sample that is held out. :func:`depends_on_azimuth` decides whether phi_h counts, by the
    averages, since repeats are no evidence.

    Returns:
        Angles in rad, [M, 4] of an anisotropic material, else [M, 3] without phi_h; and reflectance in 1/sr, [M, 3].
    """
    angles = brdf_task.wrap_azimuths(directions_to_four_angles(pairs.wi, pairs.wo), _ANGLE_STEP_RAD)
    if not len(angles):
        return angles[:, :3], pairs.reflectance
    samples = _average_duplicates(angles, pairs.reflectance)
    return samples if depends_on_azimuth(*samples) else _average_duplicates(angles[:, :3], pairs.reflectance)


def deviation_of_repeats(pairs: MeasuredPairs) -> float:
    """Return by how much repeated measurements deviate from their mean, over that mean: a root mean square.

    Measurements count as repeated if all four angles are equal; 0 without any.
    """
    angles = brdf_task.wrap_azimuths(directions_to_four_angles(pairs.wi, pairs.wo), _ANGLE_STEP_RAD)
    if not len(angles):
        return 0.0
    grey = pairs.reflectance.mean(1, keepdim=True)
    merged_angles, moments = _average_duplicates(angles, torch.cat([grey, grey.square()], 1))
    if len(merged_angles) == len(angles):
        return 0.0
    variance = (moments[:, 1] - moments[:, 0].square()).clamp_min(0) / moments[:, 0].square().clamp_min(1e-12)
    # samples that were measured once have a variance of 0: the others' share is at least that of the joined rows
    repeated_share = (len(angles) - len(merged_angles)) / len(merged_angles)
    return math.sqrt(float(variance.mean()) / min(repeated_share, 1.0))


def depends_on_azimuth(angles: Tensor, reflectance: Tensor) -> bool:
    """Tell whether measured reflectance depends on phi_h, the azimuth of the half vector.

    Neighbours are measurements whose other three angles nearly agree. If reflectance depends on phi_h, the difference
    of the log reflectance of neighbours follows from their phi_h. So these differences are fitted by least squares, as
    linear combinations of the differences of cos and sin of phi_h and of 2 phi_h. Reflectance depends on phi_h if the
    fit explains more than MIN_AZIMUTH_EXPLAINED_SHARE of the squared differences. Of pure noise a fit of four numbers
    explains a small share, which is subtracted before. Measurements that all have one azimuth count as isotropic.

    Args:
        angles: theta_h, theta_d, phi_d and phi_h in rad, [N, 4].
        reflectance: reflectance in 1/sr, [N, 3].
    """
    has_azimuth = angles[:, 0] > MIN_HALF_THETA_RAD
    angles, logs = angles[has_azimuth], torch.log(reflectance[has_azimuth].mean(1) + 1e-3)
    if len(angles) < MIN_AZIMUTH_TEST_PAIRS:
        return False
    order = torch.randperm(len(angles), generator=torch.Generator().manual_seed(0))[:AZIMUTH_TEST_PAIRS]
    points = _embed_angles(angles[:, :3])
    neighbours = [
        torch.cdist(part, points).topk(1 + AZIMUTH_TEST_NEIGHBOURS, largest=False).indices
        for part in points[order].split(max(1, MAX_DISTANCES // len(points)))
    ]
    first, second = order.repeat_interleave(AZIMUTH_TEST_NEIGHBOURS), torch.cat(neighbours)[:, 1:].reshape(-1)
    phi_h = angles[:, 3]
    harmonics = torch.stack([phi_h.cos(), phi_h.sin(), (2 * phi_h).cos(), (2 * phi_h).sin()], 1).double()
    harmonic_differences, log_differences = harmonics[first] - harmonics[second], (logs[first] - logs[second]).double()
    total_squares = float(log_differences.square().sum())
    ridge = 1e-9 * len(harmonic_differences) * torch.eye(4, dtype=torch.float64)
    matrix = harmonic_differences.T @ harmonic_differences + ridge
    right_side = harmonic_differences.T @ log_differences
    # Of pure noise, four fitted numbers explain about 4 / (number of measurements) of the squared differences.
    explained_squares = float(right_side @ torch.linalg.solve(matrix, right_side)) - 4 * total_squares / len(order)
    return total_squares > 0 and explained_squares > MIN_AZIMUTH_EXPLAINED_SHARE * total_squares


def _average_duplicates(angles: Tensor, reflectance: Tensor) -> tuple[Tensor, Tensor]:
    """Average the measurements whose angles are equal after they are rounded to _ANGLE_STEP_RAD.

    Args:
        angles: angles in rad, [N, 3 or 4].
        reflectance: reflectance in 1/sr, [N, 3].

    Returns:
        M <= N angles, [M, 3 or 4], each the mean of the angles that were equal, and their mean reflectance, [M, 3]. The
        order is by the first angle, then by the next ones.
    """
    rounded_angles = (angles / _ANGLE_STEP_RAD).round().long()
    rounded_angles -= rounded_angles.amin(0)
    # Each row of angles becomes one integer, its key, which sorts like the row: ten times as fast as `torch.unique` of
    # rows. After each column the keys are replaced by their ranks, so that they stay small.
    row_keys = rounded_angles[:, 0]
    for column in rounded_angles.T[1:]:
        row_keys = torch.unique(row_keys, return_inverse=True)[1] * (column.max() + 1) + column
    _, inverse, count = torch.unique(row_keys, return_inverse=True, return_counts=True)

    def average_rows(values: Tensor) -> Tensor:
        total = torch.zeros(len(count), values.shape[1], dtype=values.dtype).index_add(0, inverse, values)
        result: Tensor = total / count[:, None]
        return result

    return average_rows(angles), average_rows(reflectance)


def _embed_angles(angles: Tensor) -> Tensor:
    """Embed angles in a space in which the nearest neighbours are those of which reflectance is most alike.

    Distances in the three angles would not do. The root of theta_h spreads small angles, where highlights make
    reflectance change fast. The other two angles are polar coordinates, in which phi_d counts the less, the smaller
    theta_d is.

    Args:
        angles: theta_h, theta_d and phi_d in rad, [N, 3].

    Returns:
        Points [N, 4] for Euclidean distances, float64.
    """
    theta_h, theta_d, phi_d = angles.double().unbind(-1)
    doubled_phi_d = 2 * phi_d  # by reciprocity reflectance is equal at phi_d and phi_d + pi
    return torch.stack(
        [2 * theta_h.sqrt(), theta_d, theta_d * doubled_phi_d.cos() / 2, theta_d * doubled_phi_d.sin() / 2], -1
    )
