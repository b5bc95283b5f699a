"""Fit many materials by Ray Data, a JSON line each; workers read paths or addresses such as s3://bucket/a.binary.

python examples/ray_fits.py materials/*.binary > fits.jsonl            # on two processes of this machine
RAY_ADDRESS=auto python examples/ray_fits.py --workers 64 FILE...      # on a cluster that runs already

Each worker is an actor with one CPU: Ray gives it one thread, and metapp stays imported between its batches.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np


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


class Fits:
    """An actor that fits the sources of a batch, and returns a row of JSON for each."""

    def __init__(self, app: str) -> None:
        import metapp  # imported by the worker, once

        self.app, self.metapp = app, metapp

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Fit the sources of a batch, and return their rows."""
        return {"row": np.array([json.dumps(self._fit_row(str(source))) for source in batch["item"]], dtype=object)}

    def _fit_row(self, source: str) -> dict[str, object]:
        """Fit a source, and return its name, error and seconds, or why it was not fitted."""
        try:
            with download(source) as path:
                fit = self.metapp.fit(self.app, path)
        except (ValueError, OSError, FloatingPointError) as error:  # a bad file does not stop the others
            return {"source": source, "failure": str(error)}
        return {"source": source, "name": fit.name, "error": fit.error, "seconds": fit.seconds}


def fit_on_cluster(sources: Sequence[str], app: str = "brdf", workers: int = 2) -> Iterator[dict[str, object]]:
    """Fit sources in batches of 8, and yield a row for each as soon as its batch is done."""
    import ray

    if not ray.is_initialized():
        settings = {} if "RAY_ADDRESS" in os.environ else {"num_cpus": workers, "include_dashboard": False}
        ray.init(log_to_driver=False, logging_level="error", **settings)
    ray.data.DataContext.get_current().enable_progress_bars = False
    data = ray.data.from_items(list(sources), override_num_blocks=-(-len(sources) // 8))
    actors = ray.data.ActorPoolStrategy(size=workers)
    rows = data.map_batches(Fits, fn_constructor_args=(app,), batch_size=8, compute=actors)
    for row in rows.iter_rows():
        yield json.loads(row["row"])


def main() -> None:
    """Print a JSON line for each material."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", metavar="FILE", help="paths that all workers see, or addresses")
    parser.add_argument("--app", default="brdf", help="application, such as brdf or texture")
    parser.add_argument("--workers", type=int, default=2, help="number of actors, each with one CPU")
    options = parser.parse_args()
    for row in fit_on_cluster(options.sources, options.app, options.workers):
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
