"""What tests of `metapp evaluate` share: few steps, commands, and what a table is of."""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metapp.apps.brdf.recipes import RECIPES
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.style import FIGURE_STYLE
from metapp.runs.fit_options import fit_options
from metapp.runs.run import Run
from tests.small_spheres import shrink_spheres


@contextlib.contextmanager
def few_steps() -> Iterator[None]:
    """Few steps of Overfit and Finetune, and of what comes after Meta; figures of few pixels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(RECIPES, "quick", replace(RECIPES["quick"], overfit_steps=40, finetune_steps=5))
        patch.setattr("metapp.evaluation.tables.convergence.FURTHER_STEPS", (2, 4))
        patch.setitem(FIGURE_STYLE, "savefig.dpi", 40)
        shrink_spheres(patch)
        yield


def call(*arguments: str | Path) -> int:
    """`metapp <arguments>`, where no test is to see what it prints."""
    from metapp.cli import console
    from metapp.cli.command_tree import app

    return int(console.run_command(lambda: app([str(each) for each in arguments], standalone_mode=False)))


def subject_of(data: Path, runs: Path) -> EvaluationRun:
    """A data set with all that has been run of it."""
    planned = Run.from_options(
        fit_options("brdf", "general", recipe="quick", data=data, out=runs, device="cpu", quiet=True)
    )
    return EvaluationRun(planned, is_measuring=True)


def rows(subject: EvaluationRun, name: str) -> list[dict[str, Any]]:
    return subject.table(name).rows
