"""Deadlines: on descents whose steps take known times by a clock of their own."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Generator

from metapp.learning.adjoint import Drawn, Loss
from metapp.learning.deadline import Deadline, Pace, usual
from metapp.learning.guard import descend_guarded
from metapp.learning.learn import Step, descend, last
from metapp.learning.recipe import Adam, Guard
from metapp.learning.rules import sgd
from metapp.learning.task import Params, Tasks

STEP, REST = 0.010, 0.004
PACE = Pace(STEP, STEP, REST)


class Timed:
    """A descent on a parabola whose steps take the given times, the last one for ever."""

    def __init__(self, *steps: float) -> None:
        self.now, self.drawn, self.steps = 0.0, 0, steps
        self.loss = Loss(self._draw, lambda theta, batch, learned: 0.5 * theta["x"].square().sum(-1))

    def _draw(self, data: object, rng: Generator, done: float) -> Drawn:
        self.now += self.steps[min(self.drawn, len(self.steps) - 1)]
        self.drawn += 1
        return Drawn(("one",), {})

    def __call__(self) -> float:
        return self.now

    def descend(self, deadline: Deadline, most: int) -> Params:
        rate = {"rate": torch.full((1, 1), 0.5)}
        steps = deadline.plan(most)
        descent = descend({"x": torch.ones(1, 1)}, sgd(rate), None, self.loss, steps=steps, rng=Generator())
        return last(deadline.within(descent)).theta


@pytest.mark.parametrize("seconds", [0.0, 0.003, 0.02, 0.1, 0.25, 3.0])
def test_what_is_planned_ends_in_time(seconds: float) -> None:
    """With the pace that was measured no step is too many, and all but the spare time is used."""
    clock = Timed(STEP)
    deadline = Deadline(seconds, clock, PACE)
    clock.descend(deadline, 50)
    (taken,) = deadline.taken
    assert clock.now + REST <= seconds or taken == 0
    assert taken == 50 or (taken + 1) * STEP > 0.9 * (seconds - REST) - 1e-9


@pytest.mark.parametrize(
    ("step", "taken"), [(STEP, 8), (0.03, 3)], ids=["as in the pace", "slower, by the longest step of the pace"]
)
def test_as_many_steps_as_taken_move_the_parameters(step: float, taken: int) -> None:
    """No step begins that would end too late."""
    clock = Timed(step)
    deadline = Deadline(0.1, clock, Pace(STEP, step, REST))
    theta = clock.descend(deadline, 50)
    assert deadline.taken == [taken]
    assert clock.now == pytest.approx(taken * step)
    assert float(theta["x"]) == 0.5**taken


def test_a_pace_is_measured_on_a_descent() -> None:
    clock = Timed(0.01, 0.02, 0.03, 0.0)
    deadline = Deadline(math.inf, clock)
    clock.now = 1.0
    clock.descend(deadline, 4)
    clock.now += 0.5
    pace = deadline.pace()
    assert pace is not None
    assert pace.step == pytest.approx(0.02)
    assert pace.longest == pytest.approx(0.03)
    assert pace.rest == pytest.approx(0.5 + 0.06 - 4 * 0.02)
    assert usual([pace, Pace(1, 2, 3), Pace(3, 1, 9)]) == (1, 2, 3)


@pytest.mark.parametrize("steps", [0, 1])
def test_a_descent_of_no_two_steps_has_no_pace(steps: int) -> None:
    clock = Timed(STEP)
    deadline = Deadline(math.inf, clock)
    clock.descend(deadline, steps)
    assert deadline.pace() is None


def test_the_guard_goes_on_within_the_same_deadline() -> None:
    clock = Timed(STEP)
    deadline = Deadline(0.1, clock, PACE)
    found = guarded(clock, deadline, 4)
    assert found.guarded is not None
    assert found.guarded.all()
    assert deadline.taken[0] == 4
    assert 1 <= deadline.taken[1] <= 4
    assert clock.now <= 0.1
    assert deadline.pace() is None  # of no usual fit


def test_the_guard_without_time_for_a_step_keeps_the_initialisation() -> None:
    clock = Timed(STEP)
    clock.now = 0.099
    found = guarded(clock, Deadline(0.1, clock, PACE), 4)
    assert found.guarded is None
    assert float(found.theta["x"]) == 1.0


def guarded(clock: Timed, deadline: Deadline, most: int) -> Step:
    """A descent that diverges, and what the guard makes of it."""
    rule = sgd({"rate": torch.full((1, 1), 2.5)})
    tasks = Tasks(("one",), {}, torch.arange(1))
    guard = Guard(Adam(0.1))
    start, rng = {"x": torch.ones(1, 1)}, Generator()
    deadline.plan(most)
    return last(descend_guarded(start, rule, tasks, clock.loss, rng=rng, guard=guard, deadline=deadline))
