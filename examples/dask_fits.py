"""Fit many materials on a Dask cluster, a JSON line each; workers read paths or addresses such as s3://bucket/a.binary.

python examples/dask_fits.py materials/*.binary > fits.jsonl           # on two processes of this machine
python examples/dask_fits.py --scheduler tcp://head:8786 FILE...       # on a cluster that runs already

A worker is one process with one thread, as Dask sets OMP_NUM_THREADS=1: threads would slow small networks down.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path


@contextlib.contextmanager
def download(source: str) -> Iterator[str]:
    """Yield the path of a source; a file at an address is copied to this machine first, and the copy is removed."""
    if "://" not in source:
        yield source
        return
    import fsspec  # needs the package of the address's protocol, such as s3fs

    with tempfile.TemporaryDirectory() as folder, fsspec.open(source) as file:
        copy = Path(folder, source.rpartition("/")[2])
        copy.write_bytes(file.read())
        yield str(copy)


def fits_of(sources: Sequence[str], app: str) -> list[dict[str, object]]:
    """Fit sources on a worker, and return name, error and seconds of each, or why it was not fitted."""
    import metapp  # imported by the worker, once a process

    rows: list[dict[str, object]] = []
    for source in sources:
        try:
            with download(source) as path:
                fit = metapp.fit(app, path)
            rows.append({"source": source, "name": fit.name, "error": fit.error, "seconds": fit.seconds})
        except (ValueError, OSError, FloatingPointError) as error:  # a bad file does not stop the others
            rows.append({"source": source, "failure": str(error)})
    return rows


def fit_on_cluster(
    sources: Sequence[str], app: str = "brdf", scheduler: str = "", workers: int = 2
) -> Iterator[dict[str, object]]:
    """Fit sources in batches of 8, and yield a row for each as soon as its batch is done."""
    from dask.distributed import Client, LocalCluster, as_completed

    batches = [sources[first : first + 8] for first in range(0, len(sources), 8)]
    cluster = scheduler or LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    with Client(cluster) as client:
        futures = client.map(fits_of, batches, [app] * len(batches), pure=False)
        for _, rows in as_completed(futures, with_results=True):
            yield from rows
    if not isinstance(cluster, str):
        cluster.close()


def main() -> None:
    """Print a JSON line for each material."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", metavar="FILE", help="paths that all workers see, or addresses")
    parser.add_argument("--app", default="brdf", help="application, such as brdf or texture")
    parser.add_argument(
        "--scheduler", default="", help="address of a Dask scheduler; default: a cluster on this machine"
    )
    parser.add_argument("--workers", type=int, default=2, help="number of processes on this machine")
    options = parser.parse_args()
    for row in fit_on_cluster(options.sources, options.app, options.scheduler, options.workers):
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
