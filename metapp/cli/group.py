"""Groups of commands that extensions offer, and help of a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer

from metapp.cli import help
from metapp.registry import TRUSTED, WITHOUT, left_out_with, reason_of, registry

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
        name = args[0] if args else ""
        under = f"{self.name} {name}" if self.name == "data" else name
        if extension := left_out_with("commands", under) or (under != name and left_out_with("formats", name)):
            raise typer.BadParameter(
                f"'{name}' is a command of the extension {extension}, which {WITHOUT} leaves out; unset it."
            )
        return super().resolve_command(ctx, args)


def add_commands(app: typer.Typer, under: str) -> None:
    """Add the commands that are offered under another one, or, for "", under none."""
    for words, entry in registry().commands.items():
        group, _, name = words.rpartition(" ")
        if group != under:
            continue
        if isinstance(command := entry.load(), typer.Typer):
            app.add_typer(command, name=name)
        elif function := _usable(words, command):
            needs = any(each.default is each.empty for each in inspect.signature(function).parameters.values())
            add_command(app, function, name, bare_is_help=needs and under != "")


def _usable(words: str, function: Callable[..., object]) -> Callable[..., object] | None:
    """The function of a command; None where typer cannot make one of another package's, which is said as others are."""
    owner = registry().owners[f"commands {words}"]
    if owner in TRUSTED:
        return function
    probe = typer.Typer()
    probe.command()(function)
    try:
        typer.main.get_command(probe)
    except Exception as error:
        registry().problems[f"{words} of {owner}"] = reason_of(error)
        return None
    return function


def add_command(app: typer.Typer, function: Callable[..., object], name: str, *, bare_is_help: bool) -> None:
    """Add a command; for --help the paragraphs of its docstring flow, while indented examples keep their lines."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    app.command(name, cls=help.Command, no_args_is_help=bare_is_help, help=text)(function)
