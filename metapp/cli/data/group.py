"""`metapp data`: turn measurements and models into task shards."""

from __future__ import annotations

import functools
from collections.abc import Callable

import typer

from data_tools.formats import formats
from metapp.cli import group
from metapp.cli.data.convert import command_of


class Group(group.Group):
    """A group with a command for each format that is converted."""

    under = "data "

    def own(self) -> dict[str, Callable[[], group.Command]]:
        """The conversions, by the format's name."""
        return {name: functools.partial(command_of, name, form) for name, form in formats().items() if form.help}


app = typer.Typer(cls=Group, no_args_is_help=True, help="Make data sets from files or by drawing them, and check them.")
