"""Commands of which each application has its own: `metapp meta APP`, `metapp baseline APP`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer

from metapp.apps import app_names, application_of
from metapp.cli.help import Command, Group
from metapp.runs.options import check_name

if TYPE_CHECKING:
    from typer._click import Context


def app_group(function: Callable[[str], Callable[..., None]], summary: str) -> typer.Typer:
    """A command with a subcommand for each application, made when it is asked for.

    Args:
        function: name of an application -> function whose parameters typer reads.
        summary: help of the group.
    """

    class Apps(Group):
        def list_commands(self, ctx: Context) -> list[str]:
            return app_names()

        def resolve_command(self, ctx: Context, args: list[str]) -> Any:
            if args and not args[0].startswith("-"):
                check_name(args[0])  # which lists the applications
            return super().resolve_command(ctx, args)

        def get_command(self, ctx: Context, name: str) -> Any:
            if name not in app_names():
                return None
            typed = typer.Typer(add_completion=False)
            text, epilog = application_of(name).help, f"Commands to try: metapp examples {name}"
            typed.command(name, cls=Command, help=text, epilog=epilog)(function(name))
            return typer.main.get_command(typed)

    return typer.Typer(cls=Apps, no_args_is_help=True, help=summary)
