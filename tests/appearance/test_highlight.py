"""Highlights: the gloss that they show, and maps beneath those that clip."""

import pytest
import torch
from torch import Tensor

from metapp.appearance.colour import radiance_to_display
from metapp.appearance.flash import camera_position, render_maps, texel_positions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.highlight import (
    F0_BOUND_CLAUSE,
    clipped_highlight_warnings,
    estimate_gloss,
    fill_clipped,
    find_clipped,
    find_white,
    remove_flash_falloff,
)
from metapp.appearance.svbrdf_maps import Maps

SIZE = 128


def above(x: float, y: float) -> Tensor:
    return (camera_position() + torch.tensor([x, y, 0.0]))[None]


def photo(
    roughness: float, specular: float, light: Tensor, diffuse: tuple[float, float, float] = (0.3, 0.2, 0.1)
) -> Tensor:
    """A flat even material [1, 3, SIZE, SIZE] under a flash."""
    ones = torch.ones(1, 1, SIZE, SIZE)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(1, 3, SIZE, SIZE)
    maps = Maps(torch.tensor(diffuse)[:, None, None] * ones, specular * ones, roughness * ones, up)
    return radiance_to_display(render_maps(maps, texel_positions(SIZE, SIZE), light, light, falloff=1.0))


@pytest.mark.parametrize(("roughness", "within"), [(0.16, 0.25), (0.25, 0.12), (0.4, 0.12), (0.6, 0.12)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, -0.3)])
def test_gloss_of_flat_even_materials_is_found(roughness: float, within: float, place: tuple[float, float]) -> None:
    light = above(*place)
    found = estimate_gloss(photo(roughness, 0.04, light), light)
    assert float(found.roughness) == pytest.approx(roughness, rel=within)
    assert float(found.specular) == pytest.approx(0.04, rel=0.5)
    torch.testing.assert_close(found.diffuse, torch.tensor([[0.3, 0.2, 0.1]]), rtol=0.08, atol=0)


def glossy(seed: int, size: int) -> Maps:
    """A drawn material [1, C, size, size]: paint in cells, a bumpy surface, one roughness and one specular colour."""
    draws = torch.Generator().manual_seed(seed)
    paint = torch.rand(1, 3, 8, 8, generator=draws).repeat_interleave(size // 8, -1).repeat_interleave(size // 8, -2)
    bumps = torch.nn.functional.interpolate(torch.randn(1, 1, 16, 16, generator=draws), (size, size), mode="bicubic")
    roughness, specular = 0.15 + 0.35 * torch.rand(2, generator=draws)
    even = torch.ones(1, 1, size, size)
    return Maps(0.1 + 0.5 * paint, specular * even.expand(1, 3, -1, -1), roughness * even, normal_from_height(bumps))


def photo_with_clipping(maps: Maps, clipped: float) -> Tensor:
    """A photo [3, H, W] of 8 bits, with a little noise, of whose px such a share clips in all channels."""
    size = maps.roughness.shape[-1]
    radiance = render_maps(maps, texel_positions(size, size), above(0.1, 0.0), above(0.1, 0.0))[0]
    level = radiance.amin(0).flatten().sort().values[round((1 - clipped) * (size * size - 1))]
    display = radiance_to_display(radiance / level * (1.02 if clipped else 0.8))
    noise = torch.randn(display.shape, generator=torch.Generator().manual_seed(0))
    return (255 * (display + 0.005 * noise)).round().clamp(0, 255) / 255


@pytest.mark.parametrize("seed", range(20))
def test_highlights_are_doubted_if_white_is_clipped(seed: int) -> None:
    """Exposures of which 0.5 to 5 % clip are said, others, of which less than 0.1 % does, are not."""
    maps = glossy(seed, 64)
    share = 0.005 * 10 ** (seed / 19)
    (clause,) = clipped_highlight_warnings(photo_with_clipping(maps, share), F0_BOUND_CLAUSE)
    assert clause.endswith("% of the photo is clipped, so F0 is a lower bound (a darker exposure shows more)")
    assert 0.9 * share < float(clause.split()[0]) / 100 < 2.5 * share  # with what all but clips
    assert clipped_highlight_warnings(photo_with_clipping(maps, 0.0), F0_BOUND_CLAUSE) == []


@pytest.mark.parametrize("paint", [(255, 120, 80), (255, 252, 190), (229, 229, 229)])
def test_saturated_paint_is_no_clipped_highlight(paint: tuple[int, int, int]) -> None:
    """One or two clipped channels are a colour, and white beneath which JPEG left traces of colour is a highlight."""
    photo = (torch.tensor(paint) / 255)[:, None, None].expand(3, 64, 64)
    assert not find_white(photo).any()
    assert find_white((torch.tensor([250, 255, 243]) / 255)[:, None, None].expand(3, 64, 64)).all()


def test_highlights_are_filled_and_glints_are_not() -> None:
    photo = torch.full((1, 3, 256, 256), 0.3)
    photo[..., ::16, ::16] = 1
    assert not find_clipped(photo).any()
    photo[..., 100:110, 90:120] = 1
    found = find_clipped(photo)[0, 0]
    assert found[101:109, 91:119].all()
    assert found.sum() <= 300


@pytest.fixture
def maps_with_blots() -> tuple[Maps, Tensor]:
    """Maps [2, C, 128, 128] of an even material, wrong beneath the first photo's clipped highlight, and both photos."""
    photos = torch.full((2, 3, 128, 128), 0.5)
    photos[0, :, 40:80, 40:80] = 1
    photos[0, :, 60, 60] = 0.2  # a dark speck that is seen
    even = torch.ones(2, 1, 128, 128)
    maps = Maps(0.3 * even.repeat(1, 3, 1, 1), 0.1 * even, 0.4 * even, torch.rand(2, 3, 128, 128))
    for part, wrong in zip(maps[:3], (0.01, 0.9, 0.8), strict=True):
        part[0, :, 40:80, 40:80] = wrong
        part[:, :, 60, 60] = 0.77
        part[:, :, 5, 5] = 0.66
    return maps, photos


def test_maps_beneath_clipped_highlights_are_those_around(maps_with_blots: tuple[Maps, Tensor]) -> None:
    maps, photos = maps_with_blots
    filled = fill_clipped(maps, photos)
    for part, before, value in zip(filled, maps, (0.3, 0.1, 0.4), strict=False):
        covered = part[0, :, 40:80, 40:80].clone()
        covered[:, 20, 20] = value
        torch.testing.assert_close(
            covered, torch.full_like(covered, value), atol=0.03, rtol=0
        )  # at corners, 0.2 off before
        torch.testing.assert_close(part[0, :, 60, 60], before[0, :, 60, 60])
        far = torch.ones(128, 128, dtype=torch.bool)
        far[30:90, 30:90] = False
        assert torch.equal(part[0][:, far], before[0][:, far])
        assert torch.equal(part[1], before[1])
    assert torch.equal(filled.normal, maps.normal)
    assert fill_clipped(maps, photos.clamp_max(0.9)) is maps


def test_finer_maps_are_filled_as_coarser_ones(maps_with_blots: tuple[Maps, Tensor]) -> None:
    maps, photos = maps_with_blots
    fine = Maps(*(part.repeat_interleave(2, -1).repeat_interleave(2, -2) for part in maps))
    found = Maps(*(torch.nn.functional.avg_pool2d(part, 2) for part in fill_clipped(fine, photos)))
    for part, expected in zip(found[:3], fill_clipped(maps, photos)[:3], strict=True):
        torch.testing.assert_close(part[0, :, 45:55, 45:55], expected[0, :, 45:55, 45:55], atol=0.01, rtol=0)


def test_a_photo_that_clips_all_over_leaves_mean_maps(maps_with_blots: tuple[Maps, Tensor]) -> None:
    maps, photos = maps_with_blots
    filled = fill_clipped(maps, torch.ones_like(photos))
    for part, before in zip(filled[:3], maps[:3], strict=True):
        assert torch.isfinite(part).all()
        assert before.amin() <= part.amin() <= part.amax() <= before.amax()


def test_width_of_clipped_highlights_is_estimated() -> None:
    light = above(0.0, 0.0)
    picture = photo(0.25, 0.1, light)
    assert (picture > 0.99).float().mean() > 0.005
    assert float(estimate_gloss(picture, light).roughness) == pytest.approx(0.25, rel=0.2)


def test_contrast_separates_varnish_from_cloth_and_highlight_share_metal() -> None:
    light = above(0.0, 0.0)
    shiny, matte = (
        float(estimate_gloss(photo(*parameters, light), light).central_lobe_share)
        for parameters in ((0.2, 0.04), (0.8, 0.02))
    )
    assert matte < 0.3 < 0.8 < shiny
    bodies = ((0.2, (0.0, 0.0, 0.0)), (0.02, (0.4, 0.4, 0.4)))
    metal, cloth = (float(estimate_gloss(photo(0.5, f0, light, diffuse=body), light).lobe_share) for f0, body in bodies)
    assert cloth < 0.15 < 0.9 < metal


def test_photos_without_their_light_are_as_bright_in_all_rings() -> None:
    light = above(0.1, 0.0)
    picture = photo(0.3, 0.05, light)
    even = remove_flash_falloff(picture, light)
    assert float(even.std((2, 3)).max()) < 0.1 * float(picture.std((2, 3)).max())
    torch.testing.assert_close(even.mean((2, 3)), picture.mean((2, 3)), rtol=0.05, atol=0)
    stains = 1 + 0.2 * (torch.rand(SIZE, SIZE, generator=torch.Generator().manual_seed(0)) < 0.5)
    stained = remove_flash_falloff(picture * stains, light)
    assert float((stained / even / stains).std()) < 0.05
