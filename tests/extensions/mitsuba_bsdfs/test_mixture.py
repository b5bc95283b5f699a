"""Sampling by lobes: the density of directions, by quadrature and by counts of samples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from metapp.appearance.lobes import ALPHAS, NODES, Lobes
from tests.needs_mitsuba import needs_mitsuba

pytestmark = needs_mitsuba

SHARES = np.tile([0.1, 0.5, 0.4], (NODES, 1))
MIXTURES = {
    "narrow": Lobes(((ALPHAS[0], ALPHAS[0]), (ALPHAS[3], ALPHAS[3])), SHARES),
    "wide": Lobes(((ALPHAS[-1], ALPHAS[-1]), (ALPHAS[6], ALPHAS[6])), SHARES),
    "anisotropic": Lobes(((ALPHAS[-2], ALPHAS[2]), (ALPHAS[4], ALPHAS[8])), SHARES, 0.4),
}
FINE, COARSE = 1920, 24  # rings of the quadrature and of the histogram; a ring has as many cells
AZIMUTH = 0.9  # of viewers, in rad
# azimuths are AZIMUTH + pi s^3, s from -1 to 1: dense where lobes are narrow at grazing angles


def hemisphere(mi: Any, mixture: Any, viewer: Any) -> NDArray[np.float64]:
    """The density's integral over each cell [COARSE, COARSE] of polar angle and s, by the midpoint rule."""
    import drjit as dr

    index = dr.arange(mi.UInt32, FINE * FINE)
    theta = (mi.Float(index // FINE) + 0.5) * (math.pi / 2 / FINE)
    s = (mi.Float(index % FINE) + 0.5) * (2 / FINE) - 1
    (sine, cosine), (sin_phi, cos_phi) = dr.sincos(theta), dr.sincos(AZIMUTH + math.pi * s * s * s)
    light = mi.Vector3f(-sine * cos_phi, -sine * sin_phi, cosine)
    values = np.array(mixture.density(viewer, light) * sine * (3 * math.pi * s * s), dtype=np.float64)
    side = FINE // COARSE
    cells: NDArray[np.float64] = values.reshape(COARSE, side, COARSE, side).sum((1, 3))
    return cells * (math.pi / 2 / FINE) * (2 / FINE)


@pytest.mark.parametrize("name", MIXTURES)
@pytest.mark.parametrize("degrees", [0, 30, 69, 85])
def test_the_density_integrates_to_1_and_is_that_of_samples(mi: Any, name: str, degrees: float) -> None:
    from metapp.extensions.mitsuba_bsdfs.mixture import Mixture

    mixture, angle, count = Mixture(MIXTURES[name]), math.radians(degrees), 200_000
    sine = math.sin(angle)
    viewer = mi.Vector3f(sine * math.cos(AZIMUTH), sine * math.sin(AZIMUTH), math.cos(angle))
    expected = hemisphere(mi, mixture, viewer)
    assert expected.sum() == pytest.approx(1, abs=1e-3)
    numbers = np.random.default_rng(3).random((3, count)).astype(np.float32)
    light = np.array(mixture.sample(viewer, mi.Float(numbers[0]), mi.Point2f(numbers[1:])), dtype=np.float64)
    assert (light[2] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(light, axis=0), 1, atol=1e-5)
    theta = np.arctan2(np.hypot(light[0], light[1]), light[2])
    s = np.cbrt(((np.arctan2(-light[1], -light[0]) - AZIMUTH) / math.pi + 1) % 2 - 1)
    found, _, _ = np.histogram2d(theta, s, COARSE, [[0, math.pi / 2], [-1, 1]])
    assert found.sum() == count
    # of each cell the count is binomial: five standard deviations, and one sample for cells of few
    assert (abs(found - count * expected) <= 5 * np.sqrt(count * expected * (1 - expected)) + 1).all()
