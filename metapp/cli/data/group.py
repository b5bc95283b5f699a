"""`metapp data`: turn measurements and models into task shards."""

from __future__ import annotations

import typer

from data_tools.formats import formats
from metapp.cli.data.convert import command_of
from metapp.cli.group import Group, add_command, add_commands

app = typer.Typer(cls=Group, no_args_is_help=True, help="Make data sets from files or by drawing them, and check them.")
for name, form in formats().items():
    if form.command:
        add_command(app, command_of(name, form, form.command), name, bare_is_help=True)
add_commands(app, "data")
