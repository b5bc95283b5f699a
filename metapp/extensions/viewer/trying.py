"""One small input of an application, fitted by Meta."""

from __future__ import annotations

import time
from pathlib import Path

from data_tools.synthetic.examples import EXAMPLES, write_example
from metapp.runs.fits.execution import execute
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request
from metapp.storage import Document

INPUTS = "inputs"


def try_app(app: str, out: Path, recipe: str = "") -> tuple[Path, Document]:
    """Write an input of an application into `out` and fit it by Meta, its run in the same folder.

    Args:
        app: the application.
        out: folder of inputs and runs.
        recipe: of the fit; "" for the application's own.

    Returns:
        The run's folder; application, name, error, seconds of inference, and those that all of it took.

    Raises:
        ValueError: a folder that cannot be written to; no such recipe, no checkpoint.
    """
    begin = time.perf_counter()
    source = write_example(app, out / INPUTS)[0]
    request = Request(app, inputs=[source], observe=EXAMPLES[app].observe, recipe=recipe, out=out, quiet=True)
    run = execute(plan(request))
    assert run is not None  # of several ranks only
    (fit,) = run.records
    told = {key: fit[key] for key in ("name", "error", "seconds")}
    return run.folder.path, {"app": app, **told, "whole_seconds": time.perf_counter() - begin}
