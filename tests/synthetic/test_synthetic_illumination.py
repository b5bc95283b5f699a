"""The synthetic environments: varied, lit from dim to dazzling as real ones are, the same for a seed."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from data_tools.draws import stream
from data_tools.synthetic.illumination import white_balance
from metapp.appearance.latlong import luminance, mean_luminance, solid_angles
from tests.synthetic.drawn import drawn


@pytest.fixture(scope="module")
def light() -> Tensor:
    """[64, 3, 64, 128]."""
    return torch.stack([task.data["map"] for task in drawn("illumination").tasks])


@pytest.mark.long
def test_maps_are_finite_lit_everywhere_and_of_mean_luminance_1(light: Tensor) -> None:
    assert light.isfinite().all()
    assert light.min() >= 0
    assert (mean_luminance(light) - 1).abs().max() < 1e-4
    assert (luminance(light) > 0).float().mean() > 0.98
    # kcd/m^2: from lamplight to sunlight
    scales = torch.stack([task.data["scale"] for task in drawn("illumination").train])
    assert scales.min() > 1e-3
    assert scales.max() < 50
    assert scales.max() > 300 * scales.min()


@pytest.mark.long
def test_every_map_is_another_place_and_suns_stand_in_all_directions(light: Tensor) -> None:
    small = torch.nn.functional.avg_pool2d(light, 8).add(0.05).log().flatten(1)
    apart = torch.cdist(small, small, p=1).fill_diagonal_(float("inf")) / small.shape[1]
    assert apart.min() > 0.15  # and with that no test map is a training map
    levels = luminance(light)
    columns = levels[levels.flatten(1).amax(1) > 500].flatten(1).argmax(1) % 128
    assert len(columns) > 8
    assert len((columns // 32).unique()) == 4


@pytest.mark.long
def test_light_is_spread_as_in_real_places(light: Tensor) -> None:
    """The medians and the range of some statistics lie where those of published environment maps do."""
    levels, share = luminance(light), solid_angles(64, 128) / (4 * torch.pi)
    weight = share.expand(64, 128).flatten()
    rising, order = levels.flatten(1).sort(dim=1)
    below = weight[order].cumsum(1)
    median = rising.gather(1, (below > 0.5).int().argmax(1, keepdim=True)).squeeze(1)
    brightest = ((rising * weight[order]) * (below > 0.99)).sum(1)  # share of the light from 1 % of all directions
    upper = (levels * share)[:, :32].sum((1, 2))
    peak = levels.flatten(1).amax(1)
    for found, low, middle, high in (
        (median, 0.06, (0.2, 0.5), 0.6),
        (brightest, 0.06, (0.15, 0.6), 0.8),
        (upper, 0.6, (0.72, 0.9), 0.92),
        (peak, 8, (30, 400), 2000),
    ):
        assert found.min() < low
        assert middle[0] < found.median() < middle[1]
        assert found.max() > high


@pytest.mark.long
def test_photos_show_the_map() -> None:
    """What lies above is brighter than what lies below in the photos of most maps, as it is in the maps."""
    train = drawn("illumination").train
    photos = torch.stack([task.data["photos"] for task in train]).float().mean((1, 2))
    light = torch.stack([luminance(task.data["map"]) for task in train])
    above = photos[:, :32].sum((1, 2)) > photos[:, 32:].sum((1, 2))
    expected = light[:, :32, 64 - 40 : 64 + 40].sum((1, 2)) > light[:, 32:, 64 - 40 : 64 + 40].sum((1, 2))
    assert (above == expected).float().mean() > 0.8


def test_cameras_take_away_strong_casts() -> None:
    red = torch.tensor([8.0, 1.0, 0.25]).expand(64, 128, 3).permute(2, 0, 1).numpy()
    for seed in range(50):
        gains = torch.from_numpy(white_balance(red, stream(seed)))
        seen = gains * torch.tensor([8.0, 1.0, 0.25])
        assert 0.4 < seen[0] / seen[2] < 2 ** (1.2 + 0.6) * 1.01
