"""The tree of commands."""

from __future__ import annotations

from typing import Annotated

import typer

from metapp import door
from metapp.cli.data import group as data
from metapp.cli.fits.command import FitCommand, make_command
from metapp.cli.group import Group, add_commands
from metapp.runs.reporter import say

SUMMARIES = {
    "general": "One forward pass of an encoder trained over all tasks.",
    "overfit": "Train on each task alone, from a random initialisation.",
    "finetune": "A tenth of Overfit's steps, from General's result.",
    "quickft": "As many Adam steps as Meta takes, from General's result.",
    "meta": "A few steps of a learned rule from a learned initialisation.",
}

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Fit small neural networks to visual appearance: BRDFs, textures, svBRDFs, illumination, light transport.",
)


def _version(asked: bool) -> None:
    if asked:
        from metapp import __version__

        typer.echo(f"metapp {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="The version of metapp.")
    ] = False,
) -> None:
    """Take the options that need no command; warn of extensions that cannot be used."""
    for line in door.problems():
        say(f"warning: {line}")


for name, summary in SUMMARIES.items():
    app.command(name, cls=FitCommand)(make_command(name, summary))
add_commands(app, "")
app.add_typer(data.app, name="data")
