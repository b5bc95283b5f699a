"""Occlusion in closed form, and the metallic-roughness workflow."""

from __future__ import annotations

import pytest
import torch

from metapp.appearance.surface import DIELECTRIC, from_metallic
from metapp.extensions.assets.occlusion import occlusion_from_height
from metapp.extensions.assets.planes import to_metallic
from tests.surfaces import grid, waves


def test_a_plane_is_open_and_so_is_a_single_peak() -> None:
    assert torch.equal(occlusion_from_height(torch.zeros(1, 8, 8), periodic=True), torch.ones(1, 8, 8))
    peak = torch.zeros(1, 33, 33)
    peak[0, 16, 16] = 10
    assert occlusion_from_height(peak, periodic=False)[0, 16, 16] == 1


@pytest.mark.parametrize("depth", [6.0, 12.0, 24.0])
def test_the_bottom_of_a_round_pit_sees_what_the_horizon_leaves(depth: float) -> None:
    size, radius = 65, 12.0
    x, y = (each - size / 2 for each in grid(size))
    pit = torch.where(x * x + y * y < radius * radius, -depth, 0.0)[None]
    seen = float(occlusion_from_height(pit, periodic=False, reach=0.5)[0, size // 2, size // 2])
    # walls lie between texels, at most one texel nearer or farther
    low, high = (1 / (1 + (depth / each) ** 2) for each in (radius - 1, radius + 1))
    assert low < seen < high


@pytest.mark.parametrize("rows", [4, 64])
def test_the_reach_of_occlusion_is_in_widths(rows: int) -> None:
    """Of a wall, in a field of other height than width; columns farther from it than the reach are open."""
    wall = torch.zeros(1, rows, 32)
    wall[..., 24:] = 100
    found = occlusion_from_height(wall, periodic=False, reach=0.25)[0, rows // 2]
    assert (found[: 24 - 8 - 1] == 1).all()
    assert (found[24 - 8 : 24] < 1).all()


def test_occlusion_goes_on_at_the_other_edge_where_a_field_tiles() -> None:
    wall = torch.zeros(1, 16, 16)
    wall[..., 0] = 4
    tiled = occlusion_from_height(wall, periodic=True)
    assert torch.allclose(tiled[..., 1], tiled[..., -1])
    assert occlusion_from_height(wall, periodic=False)[0, 8, -1] == 1


def test_large_fields_are_occluded_as_small_ones() -> None:
    """Waves of the same shape, four times as large."""
    small, large = (waves(size)[0].float() * size / 64 for size in (256, 1024))
    coarse = torch.nn.functional.interpolate(occlusion_from_height(large, periodic=True)[None], (256, 256), mode="area")
    fine = occlusion_from_height(small, periodic=True)
    assert (coarse[0] - fine).abs().max() < 0.02
    assert fine.std() > 0.03
    edges = occlusion_from_height(large, periodic=True)[0]
    inner = (edges[:, 1:] - edges[:, :-1]).abs().max()
    assert (edges[:, 0] - edges[:, -1]).abs().max() <= 1.5 * inner  # no seam


def drawn(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_it_is_inverted_where_such_maps_exist() -> None:
    base, metallic = DIELECTRIC + (1 - DIELECTRIC) * drawn(3, 16, 16), drawn(1, 16, 16)
    found = to_metallic(*from_metallic(base, metallic))
    assert torch.allclose(found.metallic, metallic, atol=1e-9)
    assert torch.allclose(found.base, base, atol=1e-9)


def test_metals_and_dielectrics_are_what_they_are() -> None:
    gold, plaster = torch.tensor([1.0, 0.77, 0.34])[:, None, None], torch.full((3, 1, 1), 0.8)
    dielectric = torch.full((1, 1, 1), DIELECTRIC)
    metal, other = to_metallic(torch.zeros(3, 1, 1), gold), to_metallic(plaster, dielectric)
    assert torch.allclose(metal.metallic, torch.ones(1, 1, 1), atol=1e-4)
    assert torch.allclose(metal.base, gold, atol=1e-4)
    assert torch.equal(other.metallic, torch.zeros(1, 1, 1))
    assert torch.allclose(other.base, plaster)


def test_what_no_such_material_reflects_stays_in_range_and_is_kept() -> None:
    diffuse, specular = drawn(3, 32, 32), drawn(3, 32, 32).flip(0)
    for each in to_metallic(diffuse, specular):
        assert each.isfinite().all()
        assert each.min() >= 0
        assert each.max() <= 1
    # and where nothing clips, all that is reflected is kept
    diffuse, specular = 0.4 * drawn(3, 16, 16), DIELECTRIC + 0.4 * drawn(1, 16, 16)
    again = from_metallic(*to_metallic(diffuse, specular))
    assert torch.allclose(again[0] + again[1], diffuse + specular, atol=1e-12)
