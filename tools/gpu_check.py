"""Fit every application by every paradigm on a GPU and on the CPU: errors and seconds as a Markdown table.

gpu_check.py [--device cuda] [--data DIR] [--steps N] [--seeds N] [APP[:PROTOCOL]...]

Each fit takes a few steps on one drawn task. Devices draw different random numbers, so a GPU's error must lie among the
CPU's errors by several seeds. It may lie outside by as much as these scatter, or by MIN_ERROR_TOLERANCE of the largest.
`--device cpu` is a dry run.
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
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.runs.data_sets.embedded import make_embedded_set

DRAWN_TASKS = 5  # tasks that are drawn for each application; the test task among them is fitted
# share of an error by which devices may differ: noise that textures are made of depends on the device, not on the seed
MIN_ERROR_TOLERANCE = 0.15


class DeviceOutcome(NamedTuple):
    """Fits of one application by one paradigm on the CPU and on a device.

    Attributes:
        errors: the errors on the CPU, one per seed.
        seconds: the least seconds of a fit on the CPU.
        error: the error on the device.
        device_seconds: the seconds of a fit on the device.
        failure: why the device could not fit; "" if it could.
    """

    errors: list[float]
    seconds: float
    error: float = float("nan")
    device_seconds: float = float("nan")
    failure: str = ""

    @property
    def verdict(self) -> str:
        """Empty if the device's error lies where the CPU's errors lie, else "differs", or the failure."""
        if self.failure:
            return self.failure
        low, high = min(self.errors), max(self.errors)
        tolerance = max(high - low, MIN_ERROR_TOLERANCE * abs(high))
        return "" if low - tolerance <= self.error <= high + tolerance else "differs"


def select_apps(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of an application and what its fits see: those named as APP or APP:OBSERVED, or all."""
    applications = sorted(registry().applications.items())
    pairs = [(app, observed) for app, application in applications for observed in (application.observations or ("",))]
    known_names = {name for app, observed in pairs for name in (app, f"{app}:{observed}")}
    if unknown_names := sorted(set(names) - known_names):
        raise SystemExit(f"{', '.join(unknown_names)}: expected names among {', '.join(sorted(known_names))}.")
    return [pair for pair in pairs if not names or pair[0] in names or ":".join(pair) in names]


def fit_test_task(app: str, observed: str, paradigm: str, device: str, steps: int, seed: int, data: Path) -> metapp.Fit:
    """Fit the test task of a data set."""
    options: dict[str, Any] = {} if paradigm == "general" else {"steps": steps}
    (fit,) = metapp.fit_all(app, paradigm=paradigm, observe=observed, data=data, device=device, seed=seed, **options)
    return fit


def compare_devices(
    app: str, observed: str, paradigm: str, device: str, steps: int, seeds: int, data: Path
) -> DeviceOutcome:
    """Fit on the CPU, then twice on the device; the second is timed, since the first call of a kernel loads it."""
    cpu_fits = [fit_test_task(app, observed, paradigm, "cpu", steps, seed, data) for seed in range(seeds)]
    outcome = DeviceOutcome([float(fit.error or 0) for fit in cpu_fits], min(fit.seconds or 0.0 for fit in cpu_fits))
    try:
        device_fits = [fit_test_task(app, observed, paradigm, device, steps, 0, data) for _ in range(2)]
    except Exception as error:  # one run shows all that breaks
        traceback.print_exc()
        return outcome._replace(failure=f"{type(error).__name__}: {str(error).splitlines()[0][:80]}")
    return outcome._replace(error=float(device_fits[1].error or 0), device_seconds=device_fits[1].seconds or 0.0)


def table_row(app: str, observed: str, paradigm: str, outcome: DeviceOutcome) -> list[str]:
    """Return the cells of a row of the table."""
    low, high = f"{min(outcome.errors):.3f}", f"{max(outcome.errors):.3f}"
    numbers = [f"{value:.3f}" for value in (outcome.error, outcome.seconds, outcome.device_seconds)]
    return [app, observed, paradigm, low if low == high else f"{low} to {high}", *numbers, outcome.verdict]


def print_row(cells: Sequence[str]) -> None:
    """Print a row of a Markdown table at once, so that a run that breaks off leaves the rows before."""
    print(f"| {' | '.join(cells)} |", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, and return 1 if a fit failed or a device differs, else 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument(
        "--data", type=Path, default=Path("runs/gpu_check"), help="folder of data sets, which are drawn if missing"
    )
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds of fits on the CPU")
    parser.add_argument("subjects", nargs="*", metavar="APP[:OBSERVED]")
    options = parser.parse_args(arguments)
    header = ["application", "observes", "paradigm", "error, CPU", f"error, {options.device}", "s, CPU"]
    print_row([*header, f"s, {options.device}", ""])
    print_row(["---"] * (len(header) + 2))
    verdicts = []
    for (app, observed), paradigm in itertools.product(select_apps(options.subjects), PARADIGMS):
        data = options.data / app
        if not data.is_dir():
            make_embedded_set(registry().applications[app], count=DRAWN_TASKS, out=data, quiet=True)
        outcome = compare_devices(app, observed, paradigm, options.device, options.steps, options.seeds, data)
        print_row(table_row(app, observed, paradigm, outcome))
        verdicts.append(outcome.verdict)
    device_name = (
        torch.cuda.get_device_name() if options.device == "cuda" and torch.cuda.is_available() else platform.machine()
    )
    verdict_count = f"{verdicts.count('')} of {len(verdicts)} as on the CPU"
    print(f"\n{device_name}, torch {torch.__version__}, {options.steps} steps: {verdict_count}")
    return int(any(verdicts))


if __name__ == "__main__":
    sys.exit(main())
