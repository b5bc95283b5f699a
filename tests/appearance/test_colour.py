"""sRGB, tone mapping, and error measures of pictures."""

from __future__ import annotations

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.colour import linear_to_srgb, stretched, tone_map
from metapp.appearance.metrics import dssim, mape, smape, ssim


def test_tone_map_keeps_order_and_any_radiance_displays() -> None:
    radiance = torch.cat([torch.zeros(1), torch.logspace(-4, 6, 400)]).double()
    shown = tone_map(radiance)
    assert shown[0] == 0
    assert (shown.diff() > 0).all()
    assert shown[-1] < 1
    torch.testing.assert_close(tone_map(torch.ones(2, 3)), linear_to_srgb(torch.full((2, 3), 0.5)))
    assert tone_map(torch.tensor(-1.0)) == 0


def test_stretched_values_come_back_and_a_plane_is_black() -> None:
    values = torch.randn(7, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 30 - 4
    shown, low, high = stretched(values)
    assert (shown.min(), shown.max()) == (0, 1)
    torch.testing.assert_close(low + shown * (high - low), values)
    shown, low, high = stretched(torch.full((2, 2), -3.0))
    assert (shown.tolist(), low, high) == ([[0, 0], [0, 0]], -3, -3)


@pytest.fixture
def pictures() -> Tensor:
    return 0.1 + torch.rand(3, 3, 32, 32, generator=Generator().manual_seed(0))


def test_relative_errors_of_dark_pixels_are_of_a_share_of_the_mean() -> None:
    """1 % of the reference's mean, of a sum 2 %; of a black reference, of nearly nothing, but finite."""
    reference = torch.tensor([0.0, 0.0, 1.0, 1.0]).reshape(1, 1, 2, 2)
    picture = torch.tensor([0.001, 0.5, 1.0, 1.0]).reshape(1, 1, 2, 2)
    assert float(mape(picture, reference)) == pytest.approx((0.001 / 0.005 + 0.5 / 0.005) / 4)
    assert float(smape(picture, reference)) == pytest.approx((2 * 0.001 / 0.01 + 2) / 4)
    black = torch.zeros(1, 1, 2, 2)
    assert float(smape(black, black)) == float(mape(black, black)) == 0


@pytest.mark.parametrize("measure", [mape, smape, dssim])
def test_errors_are_of_each_picture_and_of_no_unit(measure, pictures: Tensor) -> None:  # type: ignore[no-untyped-def]
    torch.testing.assert_close(measure(pictures, pictures), torch.zeros(3), atol=1e-5, rtol=0)
    wanted = pictures.flip(0) + 0.5
    each = measure(pictures, wanted)
    assert each.shape == (3,)
    assert len(set(each.tolist())) > 1
    torch.testing.assert_close(measure(pictures[1:2], wanted[1:2]), each[1:2])
    torch.testing.assert_close(measure(7 * pictures, 7 * wanted), each)


def test_what_is_a_fifth_brighter_is_20_percent_off(pictures: Tensor) -> None:
    torch.testing.assert_close(mape(1.2 * pictures, pictures), torch.full((3,), 0.2))
    torch.testing.assert_close(smape(1.2 * pictures, pictures), torch.full((3,), 2 * 0.2 / 2.2))
    torch.testing.assert_close(smape(pictures, 1.2 * pictures), torch.full((3,), 2 * 0.2 / 2.2))
    torch.testing.assert_close(smape(torch.zeros_like(pictures), pictures), torch.full((3,), 2.0))


@pytest.mark.parametrize("size", [(3, 48, 40), (1, 33, 64)])
def test_structural_similarity_is_that_of_a_library(size: tuple[int, int, int]) -> None:
    from torchmetrics.functional.image import structural_similarity_index_measure

    rng = Generator().manual_seed(2)
    one, other = torch.rand(2, 4, *size, generator=rng)
    other = one + 0.3 * other
    mean, each = structural_similarity_index_measure(one, other, data_range=1.0, reduction=None, return_full_image=True)
    assert torch.equal(ssim(one, other), each)
    assert torch.equal(ssim(one, other).flatten(1).mean(1), mean)
    assert 0 < mean.min() < mean.max() < 1
