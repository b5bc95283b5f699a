"""Options of `metapp evaluate`.

They are apart from the work, so that help and completion import nothing large to read them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from metapp.options import Option
from metapp.registry import registry
from metapp.runs.spec import MAX_SEED

ALL_TABLES = "all"  # value of --which that stands for every table
TABLE_FORMATS = ("rich", "markdown", "latex", "csv", "json")


@dataclass(frozen=True)
class EvaluateOptions:
    """The options of `metapp evaluate`."""

    which: Annotated[
        str,
        Option(
            f"Table to print: {', '.join([*registry().tables, ALL_TABLES])}; default: results, or all with --report.",
            "NAME",
        ),
    ] = ""
    format: Annotated[str, Option(f"Format of tables: {', '.join(TABLE_FORMATS)}.", choices=TABLE_FORMATS)] = "rich"
    no_run: Annotated[bool, Option("Run no fits: use existing records only, and say how many are missing.")] = False
    table: Annotated[bool, Option("This option has no effect: tables are always printed.")] = False
    whole: Annotated[
        bool, Option("Measure Overfit and Finetune on all test tasks, not on a few of them; take both protocols.")
    ] = False
    rule: Annotated[str, Option("Meta's learned rule; default: the recipe's.")] = ""
    observe: Annotated[
        str,
        Option(
            "Protocol, what fits see where an application has both: reference or photo; default: reference, with "
            "--whole both."
        ),
    ] = ""
    data: Annotated[Path | None, Option("Folder of a data set; default: the embedded data set.")] = None
    checkpoint: Annotated[
        Path | None, Option("File of trained checkpoints of one APP; default: those that ship.", "FILE")
    ] = None
    out: Annotated[Path, Option("Folder of the table's runs, which a repeated command goes on with.")] = Path(
        "runs/evaluate"
    )
    recipe: Annotated[str, Option("Recipe: quick, full, paper, or another of APP; an APP without it takes quick.")] = (
        "quick"
    )
    seed: Annotated[int, Option("Seed of all random draws.", low=0, high=MAX_SEED)] = 0
    device: Annotated[str, Option("auto, cpu or cuda.", choices=("auto", "cpu", "cuda"))] = "auto"
    figures: Annotated[Path | None, Option("Also draw the figures, as PNG and PDF, into this folder.", "DIR")] = None
    report: Annotated[
        Path | None, Option("Also write a report, tables in Markdown and figures, into this folder.", "DIR")
    ] = None
    quiet: Annotated[bool, Option("Print no progress and draw no pictures.", short="q")] = False
