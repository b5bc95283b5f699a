"""The baseline of mirror balls: what is seen stays."""

from __future__ import annotations

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.latlong import directions
from metapp.extensions.baselines.baseline import Allowed
from metapp.extensions.baselines.illumination import shown as unwrapped_map
from metapp.extensions.baselines.illumination import unwrapped
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
    made = unwrapped_map(data)
    front = directions(32, 64)[2] > 0
    torch.testing.assert_close(made[..., front], light[..., front])
    torch.testing.assert_close(made, made.flip(-1).roll(32, -1))


def test_a_glossy_sphere_is_refused(rng: Generator) -> None:
    """Nothing is certain in its photograph: what was said before is that the error is not finite."""
    data = {"seen": torch.zeros(1, 3, 8, 16), "certain": torch.zeros(1, 2, 8, 16)}
    tasks = Tasks(("garden",), data, torch.arange(1))
    with pytest.raises(ValueError, match="garden: a photo of a glossy sphere, expected a mirror ball's"):
        unwrapped(tasks, rng, Allowed(1, 1))
