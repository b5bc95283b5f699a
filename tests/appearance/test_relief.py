"""Heights from normals."""

from __future__ import annotations

import math

import pytest
import torch

from metapp.appearance.relief import height_from_normal
from tests.surfaces import grid, normal_of, waves


def test_waves_that_tile_are_found_exactly() -> None:
    height, normal = waves(48)
    assert torch.allclose(height_from_normal(normal, periodic=True), height, atol=1e-10)
    both = height_from_normal(torch.stack([normal.flip(-1), normal]), periodic=True)
    assert torch.equal(both[1], height_from_normal(normal, periodic=True))


def test_a_hill_in_a_frame_and_a_tilted_plane_are_found_where_nothing_tiles() -> None:
    size = 64
    x, y = ((each - size / 2) / (size / 6) for each in grid(size))
    height = 5 * (-(x * x + 2 * y * y) / 2).exp()
    normal = normal_of(-x * height / (size / 6), -2 * y * height / (size / 6))
    found = height_from_normal(normal, periodic=False)[0]
    assert (found - (height - height.mean())).abs().max() < 0.02  # of 5
    # and a tilted plane
    x, y = grid(32)
    plane = 0.3 * x - 0.2 * y
    found = height_from_normal(normal_of(0.3 + 0 * x, -0.2 + 0 * y), periodic=False)[0]
    assert (found - (plane - plane.mean())).abs().max() < 0.15  # half a texel's step: edges are mirrored


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("kept", [(48, 24), (24, 48)])
def test_fields_need_not_be_square(kept: tuple[int, int], periodic: bool) -> None:
    """Waves along the longer side alone, of which the other is a part."""
    rows, columns = kept
    x, y = (4 * math.pi * each / 48 for each in grid(48))
    along, slope = (x, (1, 0)) if columns == 48 else (y, (0, 1))
    step = 4 * math.pi / 48 * along.cos()
    normal = normal_of(slope[0] * step, slope[1] * step)[:, :rows, :columns]
    found = height_from_normal(normal, periodic=periodic)
    assert found.shape == (1, rows, columns)
    assert (found[0] - along.sin()[:rows, :columns]).abs().max() < (1e-9 if periodic else 0.2)
