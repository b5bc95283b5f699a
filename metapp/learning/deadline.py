"""The time of a fit: its clock, its pace, and a deadline that stops it at the last step that fits."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch

from metapp.learning.learn import Step

SPARE = 0.1  # of the time that steps may take, left out of a plan: not all steps are as quick as the usual one
REMEMBERED = 7  # fits that say what pace is usual


class Stopwatch:
    """The clock of a fit: seconds since it was made; it waits for what the device has not done yet."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._begin = self._now()

    def __call__(self) -> float:
        """Seconds so far."""
        return self._now() - self._begin

    def _now(self) -> float:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        return time.perf_counter()


class Pace(NamedTuple):
    """The durations of the parts of a fit, in seconds.

    Attributes:
        step: a step, in the mean of a fit.
        longest: the longest step of a fit.
        rest: what is neither the initialisation nor a step.
    """

    step: float
    longest: float
    rest: float


def usual(paces: list[Pace]) -> Pace:
    """The median of the last fits, but of the longest steps the longest: a promise is kept by that."""
    step, longest, rest = zip(*paces[-REMEMBERED:], strict=True)
    return Pace(statistics.median(step), max(longest), statistics.median(rest))


class Deadline:
    """Plans how many steps fit, so that schedules end with the last one, and stops where they turn out to be slower.

    Attributes:
        planned: the steps of the descent that was planned last.
        taken: the steps of each descent of the fit: the first is by the rule, a second one by the guard.
    """

    def __init__(
        self,
        seconds: float = math.inf,
        clock: Callable[[], float] = time.perf_counter,
        pace: Pace | None = None,
    ) -> None:
        """Set a deadline.

        Args:
            seconds: when all must be done, by the clock; infinite where there is no hurry, or to measure a pace.
            clock: seconds since the fit's input was first seen.
            pace: of fits like this; None: all steps that are asked for are planned.
        """
        self._seconds, self._clock, self._pace = seconds, clock, pace
        self._begins: list[float] = []
        self._begin, self.planned = 0.0, 0
        self.taken: list[int] = []

    def plan(self, most: int) -> int:
        """The number of steps, of so many at most, that fit in the time that is left."""
        self._begin, self.planned = self._clock(), most
        self.taken.append(0)
        if self._pace:
            left = (1 - SPARE) * (self._seconds - self._begin - self._pace.rest)
            self.planned = max(0, min(most, int(left / max(self._pace.step, 1e-9))))
        return self.planned

    def within(self, descent: Iterator[Step]) -> Iterator[Step]:
        """The descent of the steps that were planned, up to the last one that ends in time."""
        for now in descent:
            self.taken[-1] = now.step
            yield now
            if now.step < self.planned and self._is_over():
                break

    def _is_over(self) -> bool:
        """True if one more step would end too late."""
        now = self._clock()
        if self._pace and now + max(self._pace.longest, self._pace.step) + self._pace.rest > self._seconds:
            return True
        self._begins.append(now)
        return False

    def pace(self) -> Pace | None:
        """The pace of this fit, which has just ended; None where it does not say what is usual."""
        if len(self.taken) != 1 or self.taken[0] < 2:
            return None
        seconds = [after - before for before, after in zip(self._begins, self._begins[1:], strict=False)]
        step = statistics.fmean(seconds)
        return Pace(step, max(seconds), max(0.0, self._clock() - self._begin - self.taken[0] * step))
