"""Baselines of mirror balls: what is seen stays, what clips comes back where it was and of its colour."""

from __future__ import annotations

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.latlong import directions, mean_luminance, solid_angles
from metapp.extensions.baselines.baseline import Allowed
from metapp.extensions.baselines.mirror_balls import _fit, answer
from metapp.learning.task import Tasks

LAMP = torch.tensor([0.6, 0.0, 0.8])


def shown(clip: float = 1.0) -> tuple[Tensor, dict[str, Tensor]]:
    """A map with a red lamp before the ball, and what its mirror shows of the front."""
    towards = directions(32, 64)
    lamp = ((torch.einsum("c,chw->hw", LAMP, towards) - 1) * 200).exp()
    light = 0.2 + 0.1 * towards[:1] + 40 * lamp * torch.tensor([1.0, 0.5, 0.25])[:, None, None]
    front, clips = (towards[2] > 0).float(), (light.amax(0) > clip).float()
    return light[None], {
        "seen": light.clamp(max=clip)[None],
        "certain": torch.stack([front * (1 - clips), front * clips])[None],
    }


def test_what_is_seen_stays_and_what_is_behind_mirrors_it() -> None:
    light, data = shown(clip=100.0)
    made = answer(data, 0.0)
    front = directions(32, 64)[2] > 0
    torch.testing.assert_close(made[..., front], light[..., front])
    torch.testing.assert_close(made, made.flip(-1).roll(32, -1))


@pytest.mark.parametrize("gain", [1.0, 7.0])
def test_clipped_light_comes_back_where_it_was(gain: float) -> None:
    _, data = shown()
    added = answer(data, gain) - answer(data, 0.0)
    area = solid_angles(32, 64)
    of_clip = ((data["seen"] * data["certain"][:, 1:]) * area).sum((2, 3))
    torch.testing.assert_close((added * area).sum((2, 3)), gain * of_clip)
    mean = torch.einsum("hw,chw->c", mean_luminance_of(added), directions(32, 64) * area)
    assert float(mean @ LAMP / mean.norm()) > 0.999
    assert (data["certain"][0, 1] * added[0, 0] * area).sum() > 0.5 * (added[0, 0] * area).sum()  # as wide as that


def mean_luminance_of(maps: Tensor) -> Tensor:
    return maps[0].mean(0)


def test_without_clipping_nothing_is_added() -> None:
    _, data = shown(clip=100.0)
    torch.testing.assert_close(answer(data, 5.0), answer(data, 0.0))
    assert torch.isfinite(mean_luminance(answer(data, 5.0))).all()


def test_a_glossy_sphere_is_refused(rng: Generator) -> None:
    """Nothing is certain in its photograph: what was said before is that the error is not finite."""
    data = {"seen": torch.zeros(1, 3, 8, 16), "certain": torch.zeros(1, 2, 8, 16)}
    tasks = Tasks(("garden",), data, torch.arange(1))
    with pytest.raises(ValueError, match="garden: a photo of a glossy sphere, expected a mirror ball's"):
        _fit(tasks, rng, Allowed(1, 1), gain=0.0)
