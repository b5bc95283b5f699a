"""The commands `metapp data synth` and `metapp data cornell`, which draw synthetic data sets.

Only arguments and help are made here; :mod:`metapp.cli.synthesis`, which imports torch, does the work.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Out, Overwrite, Quiet, Seed, app_words, check_out_folder, expand_options
from metapp.cli.data import print_written_tasks
from metapp.cli.synthesis_options import SHARDS_FORM, CornellOptions, SynthOptions
from metapp.entries import did_you_mean
from metapp.registry import registry


@expand_options(SynthOptions)
def synth(
    options: SynthOptions,
    name: Annotated[
        str,
        typer.Argument(metavar="APP", autocompletion=app_words, help=f"{', '.join(registry().embedded_apps)}."),
    ],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            callback=check_out_folder,
            show_default="the user's cache",
            help="Folder to write to; made if missing.",
        ),
    ] = None,
    seed: Seed = 0,
    form: Annotated[
        str,
        typer.Option(
            "--as",
            metavar="FORM",
            help="shards, the format that metapp reads, or merl, files in DIR/train and DIR/test.",
        ),
    ] = SHARDS_FORM,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
) -> None:
    """Draw an embedded data set: synthetic tasks, equal on every machine."""
    count, set_options = options.count, {key: value for key, value in vars(options).items() if value and key != "count"}
    apps = registry().embedded_apps
    if name not in apps:
        raise typer.BadParameter(
            f"'{name}' has no embedded data set, expected one of {', '.join(apps)}.{did_you_mean(name, apps)}",
            param_hint="APP",
        )
    if form != SHARDS_FORM and set_options:
        flag = f"--{next(iter(set_options))}".replace("_", "-")
        raise typer.BadParameter(
            f"'{form}' with {flag}: expected shards; leave out {flag} or --as {form}.", param_hint="--as"
        )
    from metapp.cli.synthesis import draw_files, draw_shards

    application = registry().applications[name]

    if form == SHARDS_FORM:
        result = draw_shards(application, seed, count, folder, set_options, overwrite=overwrite, quiet=quiet)
    else:
        result = draw_files(application, form, folder, count, seed, overwrite=overwrite, quiet=quiet)
    print_written_tasks(result, quiet, as_json)


synth.__doc__ = "\n\n".join(
    [
        str(synth.__doc__),
        "\n".join(
            [
                "Sets (training + test tasks):",
                *(
                    f"  {name}: {application.synthetic.content}"
                    for name, application in registry().applications.items()
                    if application.synthetic
                ),
            ]
        ),
        "Examples:\n  metapp data synth brdf\n  metapp data synth brdf --count 10 --seed 1 --as merl --out materials",
    ]
)


@expand_options(CornellOptions)
def cornell(
    options: CornellOptions,
    folder: Out,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
) -> None:
    """Draw Cornell boxes and trace their light paths.

    In each are one to five spheres of diffuse, glass or metal material, a mirror on a side wall and an area light on
    the ceiling, all at random places. The samples of a scene are points of primary sample space, drawn in proportion to
    the luminance that their paths carry; a scene takes 2 s. It is also written as a .json file, a dictionary of Mitsuba
    3, beside its shard.

    Examples:
      metapp data cornell --count 20 --seed 7 --out boxes
      metapp data cornell --count 4 --samples 288000 --split test --out boxes
    """
    from metapp.cli.synthesis import draw_cornell_boxes

    result = draw_cornell_boxes(options, folder, seed, overwrite=overwrite, quiet=quiet)
    print_written_tasks(result, quiet, as_json)
