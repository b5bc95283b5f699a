"""The synthetic environments: lit from dim to dazzling as real ones are."""

from __future__ import annotations

import pytest
import torch

from data_tools.draws import stream
from data_tools.synthetic.illumination import white_balance
from metapp.appearance.latlong import luminance, mean_luminance
from tests.synthetic.drawn import drawn


@pytest.mark.long
def test_maps_are_finite_lit_everywhere_and_of_mean_luminance_1() -> None:
    tasks = drawn("illumination").tasks
    light = torch.stack([task.data["map"] for task in tasks])
    assert light.isfinite().all()
    assert light.min() >= 0
    assert (mean_luminance(light) - 1).abs().max() < 1e-4
    assert (luminance(light) > 0).float().mean() > 0.98
    # kcd/m^2: from lamplight to sunlight
    scales = torch.stack([task.data["scale"] for task in drawn("illumination").train])
    assert scales.min() > 1e-3
    assert scales.max() < 50
    assert scales.max() > 300 * scales.min()


def test_cameras_take_away_strong_casts() -> None:
    red = torch.tensor([8.0, 1.0, 0.25]).expand(64, 128, 3).permute(2, 0, 1).numpy()
    for seed in range(50):
        gains = torch.from_numpy(white_balance(red, stream(seed)))
        seen = gains * torch.tensor([8.0, 1.0, 0.25])
        assert 0.4 < seen[0] / seen[2] < 2 ** (1.2 + 0.6) * 1.01
