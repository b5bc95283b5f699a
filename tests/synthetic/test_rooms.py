"""Random rooms: what they hold, and the tasks of guide priors that are made of them."""

from __future__ import annotations

import json
import math

import pytest
import torch

from data_tools.synthetic.rooms import KINDS, random_room
from metapp.learning.app import stack
from metapp.learning.task import Task, problems_of
from metapp.rendering.guide_histogram import BINS
from metapp.rendering.guide_training import APP
from tests.needs_mitsuba import needs_mitsuba


@pytest.mark.parametrize("kind", KINDS)
def test_a_room_is_drawn_from_its_seed(kind: str) -> None:
    scene = random_room(kind, 3)
    assert json.dumps(scene) == json.dumps(random_room(kind, 3))
    assert json.dumps(scene) != json.dumps(random_room(kind, 4))
    assert {"sensor", "floor", "ceiling", "back", "left", "right"} <= set(scene)
    assert any("emitter" in shape for shape in scene.values() if isinstance(shape, dict))


def test_radiance_times_area_is_the_power() -> None:
    scene = random_room("board", 5)
    columns = list(zip(*scene["light"]["to_world"], strict=True))
    area = 4 * math.hypot(*columns[0]) * math.hypot(*columns[1])
    assert scene["light"]["emitter"]["radiance"]["value"][1] * area == pytest.approx(4)


def test_other_rooms_are_refused() -> None:
    with pytest.raises(ValueError, match="kind cellar, seed 1, expected one of box"):
        random_room("cellar", 1)
    with pytest.raises(ValueError, match="seed -1"):
        random_room("box", -1)


@needs_mitsuba
def test_tasks_of_guide_priors_hold_what_they_must(monkeypatch: pytest.MonkeyPatch) -> None:
    from data_tools.synthetic.guiding import NAMES, guide_tasks

    monkeypatch.setattr("data_tools.synthetic.guiding.PARTS", ((4,), (4,), (4,), (8,), (8,)))
    tasks = guide_tasks("board", 1)
    assert [task.name for task in tasks] == [f"board-1-{name}" for name in NAMES]
    assert not [problem for task in tasks for problem in problems_of(task, APP.holds)]
    for task in tasks:
        for key in ("visible", "truth"):
            torch.testing.assert_close(task.data[key].sum(1), torch.ones(len(task.data[key])))


def test_even_densities_have_the_loss_of_chance() -> None:
    """Whatever paths found: the mean of squares over an even density is their sum times the number of bins."""
    squares = torch.rand(6, BINS)
    squares /= squares.sum(1, keepdim=True)
    task = Task("a", {"features": torch.randn(6, 8, 16, 16), "visible": squares, "truth": squares.flip(0)})
    tasks = stack(APP, [task, task])
    rng = torch.Generator().manual_seed(0)
    theta = {key: torch.zeros_like(value) for key, value in APP.init(rng, 2).items()}
    batch = APP.sample(tasks, rng, 4)
    even = torch.full((2,), math.log(BINS))
    torch.testing.assert_close(APP.loss(theta, batch, {}), even)
    torch.testing.assert_close(APP.outer_loss(theta, batch, {}), even)
    torch.testing.assert_close(APP.errors(theta, tasks)["error"], even)
