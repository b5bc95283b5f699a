"""Helpers for tests of `metapp evaluate`: short fits, commands in this process, and the runs that tables show."""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metapp.apps.brdf.recipes import RECIPES
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.style import FIGURE_STYLE
from metapp.runs.spec import parse_fit_options
from tests.small_spheres import shrink_spheres


@contextlib.contextmanager
def few_steps() -> Iterator[None]:
    """Shorten Overfit, Finetune and the further steps after Meta, and have figures drawn with few pixels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(RECIPES, "quick", replace(RECIPES["quick"], overfit_steps=40, finetune_steps=5))
        patch.setattr("metapp.evaluation.tables.convergence.FURTHER_STEPS", (2, 4))
        patch.setitem(FIGURE_STYLE, "savefig.dpi", 40)
        shrink_spheres(patch)
        yield


def run_metapp(*arguments: str | Path) -> int:
    """Run `metapp <arguments>` in this process and return the exit code, where no test reads what it prints."""
    from metapp.cli.command_process import run_command
    from metapp.cli.command_tree import app

    return int(run_command(lambda: app([str(argument) for argument in arguments], standalone_mode=False)))


def evaluation_run_of(data: Path, runs: Path) -> EvaluationRun:
    """Return the evaluation of a BRDF data set, with the runs that a folder holds."""
    planned = parse_fit_options("brdf", "general", recipe="quick", data=data, out=runs, device="cpu", quiet=True)
    return EvaluationRun(*planned, is_measuring=True)


def table_rows(evaluation_run: EvaluationRun, name: str) -> list[dict[str, Any]]:
    """Return the rows of a table by its name."""
    return evaluation_run.table(name).rows
