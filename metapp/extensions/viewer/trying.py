"""One small input of each application, fitted by Meta, and the page of all."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from data_tools.synthetic.examples import EXAMPLES, write_example
from metapp.extensions.viewer.viewing import Wanted, view_page
from metapp.runs.fits.execution import execute
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request
from metapp.storage import Document

INPUTS, PAGE = "inputs", "try.html"


class Tried(NamedTuple):
    """A fit of an example.

    Attributes:
        folder: of the run.
        record: application, name, error, seconds of inference, and those that all of it took.
    """

    folder: Path
    record: Document


def try_app(app: str, out: Path, recipe: str = "") -> Tried:
    """Write an input of an application into `out` and fit it by Meta, its run in the same folder.

    Args:
        app: the application.
        out: folder of inputs and runs.
        recipe: of the fit; "" for the application's own.

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
    return Tried(run.folder.path, {"app": app, **told, "whole_seconds": time.perf_counter() - begin})


def try_page(tried: Sequence[Tried], out: Path, *, quiet: bool) -> Path:
    """Write the page of all, `try.html` in `out`."""
    return view_page(Wanted([each.folder for each in tried]), out / PAGE, quiet=quiet)
