"""GGX lobes of two roughnesses."""

from __future__ import annotations

import math

import pytest

from metapp.extensions.baselines import anisotropic_lobes
from tests import anisotropic
from tests.anisotropic import APP, TURN


@pytest.mark.usefixtures("small_spheres")
def test_roughnesses_and_axes_are_those_of_the_material() -> None:
    prepared = APP.prepare(anisotropic.task())
    numbers = anisotropic_lobes.fit(prepared["where"][:2048], prepared["target"][:2048], 1)
    first, second, turn = numbers[3:6].tolist()
    found = sorted([(math.exp(first), turn), (math.exp(second), turn + math.pi / 2)], reverse=True)
    assert found[0][0] == pytest.approx(0.4, rel=0.1)
    assert found[1][0] == pytest.approx(0.12, rel=0.1)
    assert math.sin(found[0][1] - TURN) == pytest.approx(0, abs=0.03)
