"""Normals of heights, and heights of normals."""

import math

import pytest
import torch

from metapp.appearance.height_fields import height_from_normal, normal_from_height
from tests import surfaces
from tests.surfaces import normal_from_slopes, wave_heights_and_normals


def test_normals_of_a_slope() -> None:
    x, y = surfaces.texel_centres(16)
    expected = torch.tensor([-1.0, 0.5, 1.0], dtype=torch.float64)[:, None, None] / 1.5
    for periodic, inner in ((False, slice(None)), (True, slice(1, -1))):
        normal = normal_from_height((0.5 * x - 0.25 * y)[None], 2.0, periodic=periodic)[:, inner, inner]
        torch.testing.assert_close(normal, expected.expand_as(normal))


def test_waves_that_tile_are_found_exactly() -> None:
    height, normal = wave_heights_and_normals(48)
    assert torch.allclose(height_from_normal(normal, periodic=True), height, atol=1e-10)
    both = height_from_normal(torch.stack([normal.flip(-1), normal]), periodic=True)
    assert torch.equal(both[1], height_from_normal(normal, periodic=True))


def test_heights_of_a_hill_and_of_a_plane_that_do_not_tile() -> None:
    size = 64
    x, y = ((centres - size / 2) / (size / 6) for centres in surfaces.texel_centres(size))
    height = 5 * (-(x * x + 2 * y * y) / 2).exp()
    normal = normal_from_slopes(-x * height / (size / 6), -2 * y * height / (size / 6))
    found = height_from_normal(normal, periodic=False)[0]
    assert (found - (height - height.mean())).abs().max() < 0.02  # of 5
    # and a tilted plane
    x, y = surfaces.texel_centres(32)
    plane = 0.3 * x - 0.2 * y
    found = height_from_normal(normal_from_slopes(0.3 + 0 * x, -0.2 + 0 * y), periodic=False)[0]
    assert (found - (plane - plane.mean())).abs().max() < 0.15  # half a texel's step: edges are mirrored


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("kept", [(48, 24), (24, 48)])
def test_fields_need_not_be_square(kept: tuple[int, int], periodic: bool) -> None:
    """Waves along the longer side alone, of which the other is a part."""
    rows, columns = kept
    x, y = (4 * math.pi * centres / 48 for centres in surfaces.texel_centres(48))
    along, slope = (x, (1, 0)) if columns == 48 else (y, (0, 1))
    step = 4 * math.pi / 48 * along.cos()
    normal = normal_from_slopes(slope[0] * step, slope[1] * step)[:, :rows, :columns]
    found = height_from_normal(normal, periodic=periodic)
    assert found.shape == (1, rows, columns)
    assert (found[0] - along.sin()[:rows, :columns]).abs().max() < (1e-9 if periodic else 0.2)
