"""Fits that tests write into folders without a network that fitted them, and specifications that inputs choose."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor

from metapp.runs.fit import Fit
from metapp.runs.inputs.finding import find
from metapp.runs.resolve import resolve
from metapp.runs.spec import Spec, parse_fit_options

SPEC = Spec(app="brdf", paradigm="general", recipe="quick", data="files", device="cpu", steps=0)


def fit_of(name: str, source: str = "", error: float | None = 0.5, spec: Spec = SPEC, **more: Any) -> Fit:
    """A fit of a name; further fields of it, and those of its specification in `spec`."""
    seconds = more.pop("seconds", 0.1)
    return Fit(name=name, spec=spec, source=source or f"/in/{name}.csv", error=error, seconds=seconds, **more)


def spec_with(**changes: Any) -> Spec:
    return replace(SPEC, **changes)


def write_fit(
    run: Path,
    fit: Fit,
    theta: dict[str, Tensor] | None = None,
    draw: Callable[[Path], object] = lambda folder: None,
) -> Fit:
    """Write a fit into the folder of a run, and return it."""
    if theta is not None:
        fit.parameters = theta
    fit.keep(run, draw)
    return fit


def resolve_inputs(app: str, *things: object, paradigm: str = "meta", **options: Any) -> tuple[list[Spec], list[str]]:
    """The specification of each input, and the lines that say why; checkpoints are not looked for."""
    spec, run_options = parse_fit_options(app, paradigm, **options)
    return resolve(spec, find(spec, things, run_options.data), trained=False)
