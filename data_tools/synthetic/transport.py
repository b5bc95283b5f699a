"""The default set of light transport: random Cornell boxes, each with samples of its light paths.

Training and test scenes come from other random streams.
"""

from __future__ import annotations

from collections.abc import Iterator

from data_tools.random_streams import random_stream
from data_tools.synthetic.cornell import draw_scene
from data_tools.synthetic.stationary.families import Split, split_draws
from data_tools.synthetic.transport_task import BESIDE, HELD, SAMPLES, UNITS, make_transport_task
from metapp.learning.task import Task

__all__ = ["BESIDE", "COUNTS", "UNITS", "cornell_tasks", "synthetic_tasks"]

COUNTS: dict[Split, int] = {"train": 40, "test": 8}


def synthetic_tasks(
    split: Split,
    count: int,
    seed: int = 0,
    *,
    samples: int = SAMPLES,
    held: int = HELD,
) -> Iterator[Task]:
    """The Cornell boxes of one split, one by one.

    Args:
        split: "train" or "test".
        count: how many. A larger set begins with the smaller one.
        seed: of all draws, >= 0.
        samples: of each scene, for fits to see.
        held: of each scene, for tests alone.

    Returns:
        Tasks as `make_transport_task` makes them, named "box-000" and so on ("box-t000" in the test split).

    Raises:
        ValueError: for another split, a negative count or seed; no Mitsuba that can render here.
    """
    for _, name, rng in split_draws("scenes", ["box"], COUNTS, split, count, seed):
        scene = draw_scene(rng)
        drawn = int(rng.integers(2**63))
        yield make_transport_task(name, scene, drawn, samples=samples, held=held)


def cornell_tasks(count: int, seed: int = 0, *, samples: int = SAMPLES, held: int = HELD) -> Iterator[Task]:
    """Other Cornell boxes than any of the default sets, one by one: those of `metapp data cornell`.

    Returns:
        Tasks as `make_transport_task` makes them, named "cornell-7-000" and so on, with the seed in the middle. A larger set
        begins with the smaller one.
    """
    for index in range(count):
        rng = random_stream(seed, len(COUNTS), 0, index)  # beside those that `split_draws` draws from
        scene = draw_scene(rng)
        drawn, name = int(rng.integers(2**63)), f"cornell-{seed}-{index:03d}"
        yield make_transport_task(name, scene, drawn, samples=samples, held=held)
