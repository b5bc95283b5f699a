"""Groups of commands that extensions offer, and help of a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer

from metapp import door
from metapp.cli import help

ORDER = (  # of commands in help: first what a user does first, commands of other packages last
    *("try", "examples", "general", "overfit", "finetune", "quickft", "meta", "evaluate"),
    *("view", "export", "compare", "baseline", "plan", "data", "doctor"),
    # of data, readers by the application
    *("synth", "merl", "bsdf", "gonio", "nbrdf", "images", "flash", "maps", "strips", "materials", "laval"),
    *("cornell", "join", "check", "markers", "rectify", "ball", "vgg"),
)


class Group(help.Group):
    """A group that lists commands by ORDER, and knows of which extension a command is that is left out."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands."""
        return sorted(self.commands, key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is named; a usage error names the extension that has it."""
        kinds = (door.Command, door.Format) if args else ()
        for extension in filter(None, (door.switched_off(kind, args[0]) for kind in kinds)):
            raise typer.BadParameter(
                f"'{args[0]}' is a command of the extension {extension}, which {door.WITHOUT} leaves out; unset it."
            )
        return super().resolve_command(ctx, args)


def add_commands(app: typer.Typer, under: str) -> None:
    """Add the commands that are offered under another one, or, for "", under none."""
    for offer in door.offers(door.Command):
        if offer.under == under:
            command = door.load(offer.command)
            if isinstance(command, typer.Typer):
                app.add_typer(command, name=offer.name)
            else:
                add_command(app, command, offer.name, bare_is_help=offer.bare_is_help)


def add_command(app: typer.Typer, function: Callable[..., object], name: str, *, bare_is_help: bool) -> None:
    """Add a command; for --help the paragraphs of its docstring flow, while indented examples keep their lines."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    app.command(name, cls=help.Command, no_args_is_help=bare_is_help, help=text)(function)
