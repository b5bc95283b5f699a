"""Heights from normals, occlusion in closed form, and the metallic-roughness workflow."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from metapp.appearance.relief import height_from_normal, occlusion_from_height
from metapp.appearance.surface import DIELECTRIC, from_metallic, to_metallic


def grid(size: int) -> tuple[Tensor, Tensor]:
    """x to the right and y up of texels' centres, in texels."""
    rows, columns = torch.meshgrid(*2 * [torch.arange(size, dtype=torch.float64)], indexing="ij")
    return columns + 0.5, size - 0.5 - rows


def normal_of(along_x: Tensor, along_y: Tensor) -> Tensor:
    vectors = torch.stack([-along_x, -along_y, torch.ones_like(along_x)])
    return vectors / vectors.norm(dim=0)


def waves(size: int) -> tuple[Tensor, Tensor]:
    """A field of three waves, not alike along x and y, and its exact normals."""
    x, y = (2 * math.pi * each / size for each in grid(size))
    height = 3 * (2 * x).sin() + 2 * (x + 3 * y).cos() + (y + 0.3).sin()
    scale = 2 * math.pi / size
    along_x = scale * (6 * (2 * x).cos() - 2 * (x + 3 * y).sin())
    along_y = scale * (-6 * (x + 3 * y).sin() + (y + 0.3).cos())
    return height[None], normal_of(along_x, along_y)


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
