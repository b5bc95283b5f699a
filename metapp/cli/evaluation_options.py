"""Options of `metapp evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from metapp.options import Option
from metapp.registry import registry
from metapp.runs.fit_options import MAX_SEED

ALL_TABLES = "all"
TABLE_FORMATS = ("rich", "markdown", "latex", "csv", "json")


@dataclass(frozen=True)
class EvaluateOptions:
    """The options of `metapp evaluate`."""

    which: Annotated[
        str,
        Option(
            f"Which table: {', '.join([*registry().tables, ALL_TABLES])}; default: results, in a report all.", "NAME"
        ),
    ] = ""
    format: Annotated[str, Option(f"One of {', '.join(TABLE_FORMATS)}.", choices=TABLE_FORMATS)] = "rich"
    no_run: Annotated[bool, Option("Print what there is; measure nothing, say how much is missing.")] = False
    table: Annotated[bool, Option("No effect: tables are always printed.")] = False
    whole: Annotated[bool, Option("Overfit and Finetune on all test tasks, not on three; both protocols.")] = False
    rule: Annotated[str, Option("Meta's learned rule; default: the recipe's.")] = ""
    observe: Annotated[
        str,
        Option(
            "What fits may see, where an application has both: reference or photo; default: reference, with --whole "
            "each."
        ),
    ] = ""
    data: Annotated[Path | None, Option("Folder of task shards; default: the embedded set.")] = None
    checkpoint: Annotated[
        Path | None, Option("Folder of trained checkpoints of one APP; default: those that ship.", "DIR")
    ] = None
    out: Annotated[Path, Option("Where runs are kept.")] = Path("runs")
    recipe: Annotated[str, Option("quick, full, paper, or another of APP; quick for those that lack it.")] = "quick"
    seed: Annotated[int, Option("Seed of all random draws.", low=0, high=MAX_SEED)] = 0
    device: Annotated[str, Option("auto, cpu or cuda.", choices=("auto", "cpu", "cuda"))] = "auto"
    figures: Annotated[Path | None, Option("Draw the figures there, as PNG and PDF.", "DIR")] = None
    report: Annotated[Path | None, Option("Write tables there, as Markdown, and the figures.", "DIR")] = None
    quiet: Annotated[bool, Option("No progress and no pictures.", short="q")] = False
