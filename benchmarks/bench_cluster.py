"""Materials a minute by a plain loop, by Dask and by Ray Data, with one worker and with two: make bench-cluster.

Each material is a table of 2,000 measured pairs, which `metapp.fit` reads and fits by meta. A worker is a process with
one thread. The rate counts the time from when the first fit begins until the last fit ends; what happens before
(start of the cluster and its processes, imports of torch and metapp) is the seconds of start-up. CPU seconds are of the
processes that fit; other work on the machine hardly changes them. The loop is measured first and last, so that a change
of the machine's load shows.
"""

from __future__ import annotations

import argparse
import logging
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from examples.dask_fits import fits_of
from examples.ray_fits import Fits

TABLE_ROWS = 2000  # measured pairs of a material
BATCH_MATERIALS = 2  # materials that a worker gets at a time
TABLE_HEADER = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"


class TimeSpan(NamedTuple):
    """The times of a job, all in seconds.

    Attributes:
        asked_at: when the work was asked for.
        began_at: when the first fit began.
        ended_at: when the last fit ended.
        cpu_seconds: the CPU time of all fits.
    """

    asked_at: float
    began_at: float
    ended_at: float
    cpu_seconds: float


def time_fits(sources: Sequence[str]) -> tuple[float, float, float]:
    """Fit sources on a worker, and return when that began and ended, without imports, and its CPU seconds."""
    import metapp

    _ = metapp.fit  # imports torch, which is not timed
    began_at, cpu_began_at = time.time(), time.process_time()
    rows = fits_of(sources, "brdf")
    assert not any("failure" in row for row in rows), rows
    return began_at, time.time(), time.process_time() - cpu_began_at


class TimedFits(Fits):
    """An actor of Ray that fits a batch of sources and returns its times."""

    @override
    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        return {"stamps": np.array([time_fits([str(source) for source in batch["item"]])])}


def split_batches(sources: Sequence[str]) -> list[Sequence[str]]:
    """Split sources into batches of BATCH_MATERIALS."""
    return [sources[first : first + BATCH_MATERIALS] for first in range(0, len(sources), BATCH_MATERIALS)]


def fit_by_loop(sources: Sequence[str], workers: int) -> TimeSpan:
    """Fit sources in a plain loop of this process, whatever the number of workers, and return the times."""
    asked_at = time.time()
    return span_of_stamps(asked_at, [time_fits(batch) for batch in split_batches(sources)])


def fit_by_dask(sources: Sequence[str], workers: int) -> TimeSpan:
    """Fit sources on a local Dask cluster with this number of workers, and return the times."""
    from dask.distributed import Client, LocalCluster

    asked_at = time.time()
    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        return span_of_stamps(asked_at, client.gather(client.map(time_fits, split_batches(sources), pure=False)))


def fit_by_ray(sources: Sequence[str], workers: int) -> TimeSpan:
    """Fit sources by Ray Data with this number of actors, and return the times."""
    import ray

    logging.getLogger("ray.data").setLevel(logging.ERROR)
    asked_at = time.time()
    ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False, logging_level="error")
    ray.data.DataContext.get_current().enable_progress_bars = False
    data = ray.data.from_items(list(sources), override_num_blocks=len(split_batches(sources)))
    actors = ray.data.ActorPoolStrategy(size=workers)
    rows = data.map_batches(
        TimedFits, fn_constructor_args=("brdf",), batch_size=BATCH_MATERIALS, compute=actors
    ).take_all()
    ray.shutdown()
    return span_of_stamps(asked_at, [tuple(row["stamps"]) for row in rows])


def span_of_stamps(asked_at: float, stamps: Sequence[tuple[float, ...]]) -> TimeSpan:
    """Return the times of a job from the times of its batches."""
    begin_times, end_times, cpu_seconds = zip(*stamps, strict=True)
    return TimeSpan(asked_at, min(begin_times), max(end_times), sum(cpu_seconds))


CLUSTER_METHODS: list[tuple[str, Callable[[Sequence[str], int], TimeSpan], int]] = [
    ("loop", fit_by_loop, 1),
    ("Dask", fit_by_dask, 1),
    ("Dask", fit_by_dask, 2),
    ("Ray Data", fit_by_ray, 1),
    ("Ray Data", fit_by_ray, 2),
    ("loop", fit_by_loop, 1),
]


def write_materials(folder: Path, count: int) -> list[str]:
    """Write tables of Lambertian materials with a little noise, at random directions, and return their paths."""
    rng = np.random.default_rng(0)
    for number in range(count):
        angles = rng.uniform(0, 1, (TABLE_ROWS, 4)) * (80, 360, 80, 360)
        colours = rng.uniform(0.1, 0.6, 3) / np.pi * rng.uniform(0.98, 1.02, (TABLE_ROWS, 1))
        rows = np.concatenate([angles, colours], 1)
        np.savetxt(folder / f"m{number:03}.csv", rows, "%.6g", ",", header=TABLE_HEADER, comments="")
    return sorted(map(str, folder.glob("*.csv")))


def main() -> None:
    """Print the table as Markdown, row by row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=16, help="materials of each row")
    count = parser.parse_args().count
    with tempfile.TemporaryDirectory() as folder:
        sources = write_materials(Path(folder), count)
        time_fits(sources[:1])  # the first fit on a machine compiles code, which is kept
        print("| by | workers | materials a minute | of the loop | CPU s a material | start-up, s |")
        print("|---|---|---|---|---|---|", flush=True)
        first_rate = 0.0
        for name, fit_sources, workers in CLUSTER_METHODS:
            span = fit_sources(sources, workers)
            rate = 60 * count / (span.ended_at - span.began_at)
            first_rate = first_rate or rate
            figures = f"{rate:.0f} | {rate / first_rate:.2f} | {span.cpu_seconds / count:.2f}"
            print(f"| {name} | {workers} | {figures} | {span.began_at - span.asked_at:.1f} |", flush=True)


if __name__ == "__main__":
    main()
