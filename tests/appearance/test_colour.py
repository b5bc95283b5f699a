"""sRGB, tone mapping, and error measures of pictures."""

import numpy as np
import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.colorimetry import colour_difference, import_colour_science
from metapp.appearance.colour import (
    linear_to_srgb,
    radiance_to_display,
    srgb_to_linear,
    stretch_to_unit_range,
    tone_map,
)
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
    shown, low, high = stretch_to_unit_range(values)
    assert (shown.min(), shown.max()) == (0, 1)
    torch.testing.assert_close(low + shown * (high - low), values)
    shown, low, high = stretch_to_unit_range(torch.full((2, 2), -3.0))
    assert (shown.tolist(), low, high) == ([[0, 0], [0, 0]], -3, -3)


def test_exposure_is_a_clamp_and_a_root_with_finite_gradients() -> None:
    radiance = torch.tensor([-1.0, 0.0, 1e-6, 0.25, 1.0, 1.5], dtype=torch.float64, requires_grad=True)
    shown = radiance_to_display(radiance)
    assert shown[-2:].tolist() == [1, 1]
    assert shown[3].item() == pytest.approx(0.25 ** (1 / 2.2))
    assert shown[1].item() < 0.5 / 255
    (slope,) = torch.autograd.grad(shown.sum(), radiance)
    assert slope.isfinite().all()
    assert slope[[0, 1, 5]].tolist() == [0, 0, 0]
    assert slope.max() < 1000
    assert torch.autograd.gradcheck(
        radiance_to_display, (torch.linspace(0.01, 0.99, 9, dtype=torch.float64).requires_grad_(),)
    )


@pytest.fixture
def pictures() -> Tensor:
    return 0.1 + torch.rand(3, 3, 32, 32, generator=Generator().manual_seed(0))


def test_relative_errors_of_dark_pixels_have_a_floor() -> None:
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
    expected = pictures.flip(0) + 0.5
    value = measure(pictures, expected)
    assert value.shape == (3,)
    assert len(set(value.tolist())) > 1
    torch.testing.assert_close(measure(pictures[1:2], expected[1:2]), value[1:2])
    torch.testing.assert_close(measure(7 * pictures, 7 * expected), value)


def test_pixels_a_fifth_brighter_have_an_error_of_20_percent(pictures: Tensor) -> None:
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
    mean, similarity_map = structural_similarity_index_measure(
        one, other, data_range=1.0, reduction=None, return_full_image=True
    )
    assert torch.equal(ssim(one, other), similarity_map)
    assert torch.equal(ssim(one, other).flatten(1).mean(1), mean)
    assert 0 < mean.min() < mean.max() < 1


# Colour differences of published pairs, and sRGB as the standards have it


# L*, a*, b* of two colours and their difference: Sharma, Wu, Dalal 2005, table 1, where implementations often differ
SHARMA = """
50.0000   2.6772 -79.7751  50.0000   0.0000 -82.7485   2.0425
50.0000   2.8361 -74.0200  50.0000   0.0000 -82.7485   3.4412
50.0000   0.0000   0.0000  50.0000  -1.0000   2.0000   2.3669
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0009   7.1792
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0011   7.2195
50.0000   2.5000   0.0000  73.0000  25.0000 -18.0000  27.1492
50.0000   2.5000   0.0000  58.0000  24.0000  15.0000  19.4535
60.2574 -34.0099  36.2677  60.4626 -34.1751  39.4387   1.2644
61.2901   3.7196  -5.3901  61.4292   2.2480  -4.9620   1.8731
22.7233  20.0904 -46.6940  23.0331  14.9730 -42.5619   2.0373
90.8027  -2.0831   1.4410  91.1528  -1.6435   0.0447   1.4441
2.0776    0.0795  -1.1350   0.9033  -0.0636  -0.5514   0.9082
"""


def test_colour_differences_are_those_of_the_published_pairs() -> None:
    """Display values in D65 agree as well, but for two pairs at a discontinuity; black and white differ by 100."""
    colour, table = import_colour_science(), np.array(SHARMA.split(), float).reshape(-1, 7)
    np.testing.assert_allclose(colour.delta_E(table[:, :3], table[:, 3:6], method="CIE 2000"), table[:, 6], atol=1e-4)
    table = np.delete(table, (3, 4), 0)
    one, other = (colour.XYZ_to_sRGB(colour.Lab_to_XYZ(table[:, at : at + 3])).reshape(2, 5, 3) for at in (0, 3))
    np.testing.assert_allclose(colour_difference(one, other), table[:, 6].reshape(2, 5), atol=1e-3)
    assert colour_difference(np.ones((1, 3)), np.zeros((1, 3))) == pytest.approx(100, abs=1e-3)


def test_srgb_of_tensors_is_that_of_colour_science() -> None:
    """The library colour-science has the transfer functions of IEC 61966-2-1, but takes long to import."""
    values, colour = np.linspace(0, 1, 1001), import_colour_science()
    pairs = ((srgb_to_linear, colour.models.eotf_sRGB), (linear_to_srgb, colour.models.eotf_inverse_sRGB))
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours(torch.from_numpy(values)).numpy(), theirs(values), rtol=1e-7, atol=1e-9)
