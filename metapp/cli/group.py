"""Groups of commands: those that metapp has by itself, and those of the registry, loaded when they are asked for."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer

from metapp.cli import help
from metapp.registry import TRUSTED, WITHOUT, did_you_mean, left_out_with, reason_of, registry

ORDER = (  # of commands in help: first what a user does first, commands of other packages last
    *("try", "examples", "general", "overfit", "finetune", "quickft", "meta", "evaluate"),
    *("view", "export", "compare", "baseline", "plan", "data", "doctor"),
    # of data, readers by the application
    *("synth", "merl", "bsdf", "gonio", "nbrdf", "images", "flash", "maps", "strips", "materials", "laval"),
    *("cornell", "join", "check", "markers", "rectify", "ball", "vgg"),
)
Command = Callable[..., object] | typer.Typer


class Group(help.Group):
    """A group whose commands are in the order of ORDER, each made when it is asked for.

    Attributes:
        under: words before those of its commands in the registry, such as "data ".
    """

    under = ""

    def own(self) -> dict[str, Callable[[], Command]]:
        """Commands that are not of the registry, by name."""
        return {}

    def _commands(self) -> dict[str, Callable[[], Command]]:
        registered = {
            words.removeprefix(self.under): entry.load
            for words, entry in registry().commands.items()
            if words.startswith(self.under) and " " not in words.removeprefix(self.under)
        }
        return registered | self.own()

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands."""
        return sorted(self._commands(), key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))

    def get_command(self, ctx: Any, name: str) -> Any:
        """The command of a name; None where there is none, or typer cannot make it of another package's function."""
        load = self._commands().get(name)
        if load is None:
            return None
        words = f"{self.under}{name}"
        try:
            return made(load(), name, bare_is_help=bool(self.under))
        except Exception as error:
            owner = registry().owners.get(f"commands {words}", TRUSTED[0])
            if owner in TRUSTED:
                raise
            registry().problems[f"{words} of {owner}"] = reason_of(error)
            return None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is named; a usage error names the extension that has it."""
        name = args[0] if args else ""
        if extension := left_out_with("commands", f"{self.under}{name}") or left_out_with("formats", name):
            raise typer.BadParameter(
                f"'{name}' is a command of the extension {extension}, which {WITHOUT} leaves out; unset it."
            )
        if name and not name.startswith("-") and name not in (names := self.list_commands(ctx)):
            usage_error = typer.BadParameter.__mro__[1]  # which typer does not export
            raise usage_error(f"No such command '{name}'.{did_you_mean(name, names)}", ctx)
        return super().resolve_command(ctx, args)


def made(command: Command, name: str, *, bare_is_help: bool) -> Any:
    """The command that typer makes of a function, or of an app of its own.

    For --help the paragraphs of a function's docstring flow, while indented examples keep their lines.
    """
    if isinstance(command, typer.Typer):
        return typer.main.get_group(command)
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    needs = any(each.default is each.empty for each in inspect.signature(command).parameters.values())
    typed = typer.Typer(add_completion=False, context_settings=CONTEXT)
    typed.command(name, cls=help.Command, no_args_is_help=bare_is_help and needs, help=text)(command)
    return typer.main.get_command(typed)


CONTEXT = {"help_option_names": ["-h", "--help"]}
