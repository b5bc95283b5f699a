"""The tree of commands."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Annotated

import typer

from metapp.cli import group
from metapp.cli.apps import app_group
from metapp.cli.fit import SUMMARIES, command_of
from metapp.registry import registry
from metapp.runs.reporter import say


class Commands(group.Group):
    """All commands; those of the paradigms and of `metapp data` are metapp's own."""

    def own(self) -> dict[str, Callable[[], group.Command]]:
        """Groups of commands, by name."""
        paradigms = {
            name: functools.partial(app_group, functools.partial(command_of, name), summary)
            for name, summary in SUMMARIES.items()
        }
        return {**paradigms, "data": _data}


def _data() -> typer.Typer:
    from metapp.cli.data.group import app

    return app


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    context_settings=group.CONTEXT,
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
