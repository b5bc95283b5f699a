"""The default set of light transport: random Cornell boxes, each with samples of its light paths.

Training and test scenes come from other random streams.
"""

from __future__ import annotations

from collections.abc import Iterator

from data_tools.random_streams import random_stream
from data_tools.synthetic.cornell import draw_scene
from data_tools.synthetic.random_values import Split
from data_tools.synthetic.stationary.families import split_draws
from data_tools.synthetic.transport_task import BESIDE, HELD_OUT, SAMPLES, UNITS, make_transport_task
from metapp.learning.task import Task

__all__ = ["BESIDE", "COUNTS", "UNITS", "VERSION", "cornell_tasks", "synthetic_tasks"]

VERSION = 2  # of the set's tasks; 2 names the tensor of held-out samples `held_out`
COUNTS: dict[Split, int] = {"train": 40, "test": 8}


def synthetic_tasks(
    split: Split,
    count: int,
    seed: int = 0,
    *,
    samples: int = SAMPLES,
    held_out: int = HELD_OUT,
) -> Iterator[Task]:
    """Draw the Cornell boxes of one split, and yield each as a task.

    Args:
        split: "train" or "test".
        count: how many. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.
        samples: number of samples of each scene that a fit sees.
        held_out: number of samples of each scene for tests alone.

    Returns:
        Tasks as `make_transport_task` makes them, named "box-000" and so on ("box-t000" in the test split).

    Raises:
        ValueError: for another split, a negative count or seed; no Mitsuba that can render here.
    """
    for _, name, rng in split_draws("scenes", ["box"], COUNTS, split, count, seed):
        scene = draw_scene(rng)
        path_seed = int(rng.integers(2**63))
        yield make_transport_task(name, scene, path_seed, samples=samples, held_out=held_out)


def cornell_tasks(count: int, seed: int = 0, *, samples: int = SAMPLES, held_out: int = HELD_OUT) -> Iterator[Task]:
    """Draw the Cornell boxes of `metapp data cornell`, which are in no default set, and yield each as a task.

    Returns:
        Tasks as `make_transport_task` makes them, named "cornell-7-000" and so on, with the seed in the middle. A
            larger set begins with the smaller one.
    """
    for index in range(count):
        rng = random_stream(seed, len(COUNTS), 0, index)  # a stream that `split_draws` never draws from
        scene = draw_scene(rng)
        path_seed, name = int(rng.integers(2**63)), f"cornell-{seed}-{index:03d}"
        yield make_transport_task(name, scene, path_seed, samples=samples, held_out=held_out)
