"""The rule study: every update rule trained alike with a few outer steps; `make bench-rules` runs it, in hours.

The named rules, and compositions that add or leave out a part, are trained from the same General by the application's
own recipe, with --train-steps outer steps instead of the recipe's, at each of several numbers of gradient steps, beside
a QuickFT whose Adam is searched at that number. Trainings and fits are kept under --out: an interrupted study resumes
in the middle of a training.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib import rc_context

from benchmarks.rule_figure import rules
from benchmarks.rule_study import Design
from benchmarks.rule_table import RULES, Studied
from metapp.cli.console import run
from metapp.cli.show import show
from metapp.evaluation.cell import run_cells
from metapp.evaluation.style import STYLE, save
from metapp.evaluation.subject import Subject
from metapp.runs.requests.naming import name_of
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options of the study."""
    parser = argparse.ArgumentParser(prog="bench_rules", description=__doc__)
    parser.add_argument("apps", nargs="*", default=["brdf"], metavar="APP", help="applications; default: brdf")
    parser.add_argument("--steps", type=int, nargs="+", default=[5, 10, 20, 40], help="numbers of gradient steps")
    parser.add_argument("--train-steps", type=int, default=500, help="outer steps of each training")
    parser.add_argument("--seeds", type=int, default=3, help="seeds of training, from --seed on")
    parser.add_argument("--seed", type=int, default=0, help="first seed of training and fits")
    parser.add_argument("--rule", default="", help="study this rule alone; default: all")
    parser.add_argument("--initialisation", choices=("random", "mean", "encoder"), default="encoder")
    parser.add_argument("--data", type=Path, help="folder of task shards; default: the embedded set")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="folder of runs")
    parser.add_argument("--format", choices=("rich", "markdown", "latex", "csv", "json"), default="markdown")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train and fit what has no record yet, print the table, draw the figure of each application."""
    chosen = options(arguments)
    design = Design(chosen.train_steps, chosen.steps, chosen.seeds, chosen.initialisation, chosen.rule)
    common = {name: getattr(chosen, name) for name in ("data", "out", "seed", "quiet")}
    plans = [plan(Request(app, "general", recipe="quick", **common)) for app in chosen.apps]
    subjects: list[Subject] = [Studied(one, design) for one in plans]
    run_cells([cell for subject in subjects for cell in RULES.cells(subject)], quiet=chosen.quiet)
    show([RULES], subjects, chosen.format)
    for subject in subjects:
        with rc_context(STYLE):
            drawn = rules(subject)
        if drawn:
            file = save(drawn.figure, chosen.out / "figures" / f"{name_of(subject.app)}-rules.png")
            print(f"{file}: figure", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(run(main))
