"""Photographs under unseen lamps: exact where theory says so, and as if photographs had been left out."""

import pytest
import torch

from metapp.appearance.doubts import UNRELATED_LAMPS
from metapp.apps.svbrdf_nonstationary.rti.light_process import (
    LightProcess,
    choose_process,
    left_out_gain_db,
    mix_photos,
)
from metapp.apps.svbrdf_nonstationary.rti.lit_photos import LitPhotos
from metapp.apps.svbrdf_nonstationary.rti.relit_planes import make_relit_planes
from tests.apps.rti.scenes import dome, lit_task, photograph, wavy_maps

PROCESS = LightProcess(1.8, 1.5, 1e-4)


def test_the_covariance_is_one_of_a_random_function() -> None:
    lamps = dome(40).double()
    covariance = PROCESS.covariance(lamps, lamps)
    torch.testing.assert_close(covariance, covariance.T)
    assert float(torch.linalg.eigvalsh(covariance).min()) > 0


def test_what_is_linear_in_the_direction_is_predicted() -> None:
    lamps, others = dome(30), dome(7, 25.0)
    coefficients = torch.tensor([0.2, -0.3, 0.4])
    predicted = PROCESS.interpolation(others, lamps) @ (0.1 + lamps @ coefficients)
    torch.testing.assert_close(predicted, 0.1 + others @ coefficients, atol=2e-3, rtol=0)


def test_photographs_are_predicted_as_if_they_had_been_left_out() -> None:
    lamps = dome(12)
    weights = PROCESS.leaving_one_out(lamps)
    assert torch.equal(weights.diagonal(), torch.zeros(12))
    for number in range(12):
        kept = [other for other in range(12) if other != number]
        expected = PROCESS.interpolation(lamps[number : number + 1], lamps[kept])[0]
        torch.testing.assert_close(weights[number, kept], expected, atol=1e-4, rtol=1e-3)


def test_noisy_photographs_get_a_process_with_more_noise() -> None:
    lamps, rng = dome(40), torch.Generator().manual_seed(0)
    clean = photograph(wavy_maps(24), lamps)
    noisy = (clean + 25 * torch.randn(clean.shape, generator=rng)).clamp(0, 255).to(torch.uint8)
    assert choose_process(clean, lamps).noise < choose_process(noisy, lamps).noise


def test_photographs_are_mixed_by_strips() -> None:
    photos, weights = photograph(wavy_maps(300), dome(4)), torch.rand(2, 4)
    expected = torch.einsum("kn,nchw->kchw", weights, photos.float() / 255)
    torch.testing.assert_close(mix_photos(weights, photos), expected)


def test_planes_relight_as_all_photographs_do() -> None:
    lamps, others = dome(40), dome(9, 30.0)
    photos = photograph(wavy_maps(24, 0.04, 0.4), lamps)
    errors = []
    for count in (6, 12, 40):
        planes = make_relit_planes(LitPhotos(photos, lamps), count)
        assert planes.planes.shape == (count, 3, 24, 24)
        expected = mix_photos(planes.process.interpolation(others, lamps), photos)
        pictures = torch.einsum("mk,kchw->mchw", planes.weights(others), planes.planes)
        errors.append(float((pictures - expected).square().mean().sqrt()))
    assert errors[0] > 1.5 * errors[1] > 3 * errors[2]
    assert errors[2] < 1e-4


@pytest.mark.parametrize("lamps", [8, 40])
def test_directions_of_other_photographs_are_a_doubt(lamps: int) -> None:
    task = lit_task(side=24, lamps=lamps, specular=0.04)
    mixed = task.data["lamps"][torch.randperm(lamps, generator=torch.Generator().manual_seed(2))]
    gains = [left_out_gain_db(task.data["lit"], directions) for directions in (task.data["lamps"], mixed)]
    assert gains[0] > UNRELATED_LAMPS.limit + 1 > UNRELATED_LAMPS.limit - 1 > gains[1]
