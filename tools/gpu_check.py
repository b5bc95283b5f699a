"""Fit every application by every paradigm on a GPU and on the CPU: errors and seconds as a Markdown table.

gpu_check.py [--device cuda] [--data DIR] [--steps N] [--seeds N] [APP[:PROTOCOL]...]

A few steps of each on one drawn task. Devices draw other random numbers, so a GPU's error must lie where the CPU's lie
with several seeds, or no farther beside them than these scatter, or LEAST of it. `--device cpu` is a dry run.
"""

from __future__ import annotations

import argparse
import itertools
import platform
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch

import metapp
from metapp.names import app_names, protocols_of
from metapp.paradigms import PARADIGMS
from metapp.runs.inputs.embedded import make_embedded_set

DRAWN_TASKS = 5  # drawn of each application, of which one is fitted
MIN_ERROR_TOLERANCE = 0.15  # of an error: noise that textures are made of depends on the device, but on no seed


class DeviceOutcome(NamedTuple):
    """Fits of one application by one paradigm: errors on the CPU by seed, seconds, and those of the device."""

    errors: list[float]
    seconds: float
    error: float = float("nan")
    device_seconds: float = float("nan")
    failure: str = ""

    @property
    def verdict(self) -> str:
        """Whether the device's error lies where the CPU's lie; or the failure."""
        if self.failure:
            return self.failure
        low, high = min(self.errors), max(self.errors)
        room = max(high - low, MIN_ERROR_TOLERANCE * abs(high))
        return "" if low - room <= self.error <= high + room else "differs"


def select_apps(chosen: Sequence[str]) -> list[tuple[str, str]]:
    """Applications with their protocols, "" for the only one; all, or those chosen as APP or APP:PROTOCOL."""
    every = [(app, protocol) for app in app_names() for protocol in (protocols_of(app) or ("",))]
    known = {name for app, protocol in every for name in (app, f"{app}:{protocol}")}
    if unknown := sorted(set(chosen) - known):
        raise SystemExit(f"{', '.join(unknown)}: expected of {', '.join(sorted(known))}.")
    return [pair for pair in every if not chosen or pair[0] in chosen or ":".join(pair) in chosen]


def fit_test_task(app: str, protocol: str, paradigm: str, device: str, steps: int, seed: int, data: Path) -> metapp.Fit:
    """The fit of the test task of a data set."""
    options: dict[str, Any] = {} if paradigm == "general" else {"steps": steps}
    (fit,) = metapp.fit_all(app, paradigm=paradigm, observe=protocol, data=data, device=device, seed=seed, **options)
    return fit


def compare_devices(
    app: str, protocol: str, paradigm: str, device: str, steps: int, seeds: int, data: Path
) -> DeviceOutcome:
    """Fits on the CPU, then on the device, of which the second is timed: the first call of a kernel loads it."""
    cpu = [fit_test_task(app, protocol, paradigm, "cpu", steps, seed, data) for seed in range(seeds)]
    result = DeviceOutcome([float(fit.error or 0) for fit in cpu], min(fit.seconds for fit in cpu))
    try:
        fits = [fit_test_task(app, protocol, paradigm, device, steps, 0, data) for _ in range(2)]
    except Exception as error:  # all that breaks is to be seen at once
        traceback.print_exc()
        return result._replace(failure=f"{type(error).__name__}: {str(error).splitlines()[0][:80]}")
    return result._replace(error=float(fits[1].error or 0), device_seconds=fits[1].seconds)


def table_row(app: str, protocol: str, paradigm: str, one: DeviceOutcome) -> list[str]:
    """A row of the table."""
    low, high = f"{min(one.errors):.3f}", f"{max(one.errors):.3f}"
    numbers = [f"{value:.3f}" for value in (one.error, one.seconds, one.device_seconds)]
    return [app, protocol, paradigm, low if low == high else f"{low} to {high}", *numbers, one.verdict]


def print_row(cells: Sequence[str]) -> None:
    """Print a row of a table in Markdown, at once: of what breaks off the rest is there."""
    print(f"| {' | '.join(cells)} |", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 if anything broke or differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument("--data", type=Path, default=Path("runs/gpu_check"), help="data sets, drawn if not there")
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=3, help="of the CPU's fits")
    parser.add_argument("subjects", nargs="*", metavar="APP[:PROTOCOL]")
    given = parser.parse_args(arguments)
    head = ["application", "observes", "paradigm", "error, CPU", f"error, {given.device}", "s, CPU"]
    print_row([*head, f"s, {given.device}", ""])
    print_row(["---"] * (len(head) + 2))
    verdicts = []
    for (app, protocol), paradigm in itertools.product(select_apps(given.subjects), PARADIGMS):
        data = given.data / app
        if not data.is_dir():
            make_embedded_set(app, count=DRAWN_TASKS, out=data, quiet=True)
        one = compare_devices(app, protocol, paradigm, given.device, given.steps, given.seeds, data)
        print_row(table_row(app, protocol, paradigm, one))
        verdicts.append(one.verdict)
    name = torch.cuda.get_device_name() if given.device == "cuda" and torch.cuda.is_available() else platform.machine()
    counts = f"{verdicts.count('')} of {len(verdicts)} as on the CPU"
    print(f"\n{name}, torch {torch.__version__}, {given.steps} steps: {counts}")
    return int(any(verdicts))


if __name__ == "__main__":
    sys.exit(main())
