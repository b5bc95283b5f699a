"""Materials a minute by a plain loop, by Dask and by Ray Data, with one worker and with two: make bench-cluster.

Each material is a table of 2,000 measured pairs, which `metapp.fit` reads and fits by meta. A worker is a process with
one thread. The rate is of the time from when the first fit begins until the last one ends; what starts before that
(cluster, processes, imports of torch and metapp) is the seconds of start-up. CPU seconds are of the processes that fit;
other work on the machine hardly changes them. The loop is measured first and last, so that a load that changes shows.
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

from examples.dask_fits import fits_of
from examples.ray_fits import Fits

TABLE_ROWS, BATCH_MATERIALS = 2000, 2
TABLE_HEADER = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"


class TimeSpan(NamedTuple):
    """When work was asked for, the first fit began, the last one ended; the CPU time of fits; all in seconds."""

    asked: float
    began: float
    ended: float
    cpu: float


def time_fits(sources: Sequence[str]) -> tuple[float, float, float]:
    """Fit sources on a worker: when that began and ended, without imports, and the CPU seconds between."""
    import metapp

    _ = metapp.fit  # imports torch
    began, cpu = time.time(), time.process_time()
    rows = fits_of(sources, "brdf")
    assert not any("failure" in row for row in rows), rows
    return began, time.time(), time.process_time() - cpu


class TimedFits(Fits):
    """The same by an actor of Ray."""

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        return {"stamps": np.array([time_fits([str(source) for source in batch["item"]])])}


def split_batches(sources: Sequence[str]) -> list[Sequence[str]]:
    return [sources[first : first + BATCH_MATERIALS] for first in range(0, len(sources), BATCH_MATERIALS)]


def fit_by_loop(sources: Sequence[str], workers: int) -> TimeSpan:
    asked = time.time()
    return span_of_stamps(asked, [time_fits(batch) for batch in split_batches(sources)])


def fit_by_dask(sources: Sequence[str], workers: int) -> TimeSpan:
    from dask.distributed import Client, LocalCluster

    asked = time.time()
    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        return span_of_stamps(asked, client.gather(client.map(time_fits, split_batches(sources), pure=False)))


def fit_by_ray(sources: Sequence[str], workers: int) -> TimeSpan:
    import ray

    logging.getLogger("ray.data").setLevel(logging.ERROR)
    asked = time.time()
    ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False, logging_level="error")
    ray.data.DataContext.get_current().enable_progress_bars = False
    data = ray.data.from_items(list(sources), override_num_blocks=len(split_batches(sources)))
    actors = ray.data.ActorPoolStrategy(size=workers)
    rows = data.map_batches(
        TimedFits, fn_constructor_args=("brdf",), batch_size=BATCH_MATERIALS, compute=actors
    ).take_all()
    ray.shutdown()
    return span_of_stamps(asked, [tuple(row["stamps"]) for row in rows])


def span_of_stamps(asked: float, stamps: Sequence[tuple[float, ...]]) -> TimeSpan:
    began, ended, cpu = zip(*stamps, strict=True)
    return TimeSpan(asked, min(began), max(ended), sum(cpu))


CLUSTER_METHODS: list[tuple[str, Callable[[Sequence[str], int], TimeSpan], int]] = [
    ("loop", fit_by_loop, 1),
    ("Dask", fit_by_dask, 1),
    ("Dask", fit_by_dask, 2),
    ("Ray Data", fit_by_ray, 1),
    ("Ray Data", fit_by_ray, 2),
    ("loop", fit_by_loop, 1),
]


def write_materials(folder: Path, count: int) -> list[str]:
    """Tables of Lambertian materials with a little noise, at random directions."""
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
        time_fits(sources[:1])  # what the first fit on a machine compiles and keeps
        print("| by | workers | materials a minute | of the loop | CPU s a material | start-up, s |")
        print("|---|---|---|---|---|---|", flush=True)
        first = 0.0
        for name, run, workers in CLUSTER_METHODS:
            done = run(sources, workers)
            rate = 60 * count / (done.ended - done.began)
            first = first or rate
            figures = f"{rate:.0f} | {rate / first:.2f} | {done.cpu / count:.2f} | {done.began - done.asked:.1f}"
            print(f"| {name} | {workers} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
