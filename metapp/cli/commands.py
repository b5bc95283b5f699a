"""The tree of commands."""

from __future__ import annotations

import functools
from typing import Annotated

import typer

from metapp.cli.apps import app_group
from metapp.cli.data import group as data
from metapp.cli.fit import SUMMARIES, command_of
from metapp.cli.group import Group, add_commands
from metapp.registry import registry
from metapp.runs.reporter import say

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
    for extension, reason in registry().problems.items():
        say(f"warning: extension {extension}: {reason}; it is left out.")


for name, summary in SUMMARIES.items():
    app.add_typer(app_group(functools.partial(command_of, name), summary), name=name)
add_commands(app, "")
app.add_typer(data.app, name="data")
