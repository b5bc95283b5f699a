"""The command `metapp evaluate`: the paper's tables and figures, from records; fits without a record are run first.

Only arguments and help are made here; :mod:`metapp.cli.evaluation_output`, which imports torch, does the work.
"""

from __future__ import annotations

from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Overwrite, app_words, check_new_file, expand_options
from metapp.cli.evaluation_options import ALL_TABLES, EvaluateOptions
from metapp.entries import did_you_mean
from metapp.registry import registry

AppsArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="[APP]...", autocompletion=app_words, help="Applications; default: all."),
]


@expand_options(EvaluateOptions)
def evaluate_command(
    options: EvaluateOptions, apps: AppsArgument = None, json: JsonFlag = False, overwrite: Overwrite = False
) -> None:
    """Print tables of errors and times beside the paper's figures; fits that are missing are run first.

    Example: metapp evaluate brdf --which quickft
    """
    names, which = [*registry().tables], options.which or "results"
    if which not in (*names, ALL_TABLES):
        expected = f"expected one of {', '.join([*names, ALL_TABLES])}.{did_you_mean(which, [*names, ALL_TABLES])}"
        raise typer.BadParameter(f"--which '{which}': {expected}")
    for folder in filter(None, (options.figures, options.report)):
        for file in (*folder.glob("*-*.p[nd][gf]"), *folder.glob("index.md")):
            check_new_file(file, overwrite)
    from metapp.cli.evaluation_output import evaluate

    evaluate(options, apps or [], which, "json" if json else options.format)
