"""The tree of commands of the registry, each imported and made when it is asked for."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from metapp.cli.help import Command, Group
from metapp.options import Converter
from metapp.registry import SHIPPED, app_names, did_you_mean, reason_of, registry
from metapp.runs.options import check_name
from metapp.runs.reporter import say

ORDER = (  # of commands in help: first what a user does first, commands of other packages last
    *("try", "examples", "general", "overfit", "finetune", "quickft", "meta", "evaluate"),
    *("view", "export", "compare", "baseline", "plan", "data", "doctor"),
    # of data, readers by the application
    *("synth", "merl", "bsdf", "gonio", "nbrdf", "images", "flash", "maps", "strips", "materials", "laval"),
    *("cornell", "join", "check", "markers", "rectify", "ball", "vgg"),
)
CONTEXT = {"help_option_names": ["-h", "--help"]}


class Commands(Group):
    """Commands of the registry.

    Attributes:
        under: the words before their names, such as "data ".
    """

    under = ""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands, in the order of ORDER."""
        names = [words.removeprefix(self.under) for words in registry().commands if words.startswith(self.under)]
        return sorted(
            (name for name in names if " " not in name),
            key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER),
        )

    def get_command(self, ctx: Any, name: str) -> Any:
        """The command of a name; None if there is none, or typer cannot make it of another package's function."""
        entry = registry().commands.get(f"{self.under}{name}")
        if entry is None:
            return None
        try:
            return _made(entry.load(), name, bare_is_help=bool(self.under))
        except Exception as error:
            owner = registry().owners.get(f"commands {self.under}{name}", SHIPPED)
            if owner == SHIPPED:
                raise
            registry().problems[f"{self.under}{name} of {owner}"] = reason_of(error)
            return None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is named; a usage error names a command alike."""
        name = args[0] if args else ""
        if name and not name.startswith("-") and f"{self.under}{name}" not in registry().commands:
            hint = did_you_mean(name, self.list_commands(ctx))
            if name in app_names():
                hint = f" {name} is an application: metapp meta {name}."
            usage_error = typer.BadParameter.__mro__[1]  # which typer does not export
            raise usage_error(f"No such command '{name}'.{hint}", ctx)
        return super().resolve_command(ctx, args)


class DataCommands(Commands):
    """Commands of `metapp data`."""

    under = "data "


def _made(command: Any, name: str, *, bare_is_help: bool) -> Any:
    """The command that typer makes of a function, of a converter or of a group.

    For --help the paragraphs of a docstring flow, while indented examples keep their lines.
    """
    if isinstance(command, typer.Typer):
        return typer.main.get_group(command)
    if isinstance(command, type) and issubclass(command, Converter):
        from metapp.cli.data import convert_by

        command = convert_by(name, command)
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    needs = any(each.default is each.empty for each in inspect.signature(command).parameters.values())
    return _typed(command, name, no_args_is_help=bare_is_help and needs, help=text)


def _typed(function: Callable[..., object], name: str, **more: Any) -> Any:
    typed = typer.Typer(add_completion=False, context_settings=CONTEXT)
    typed.command(name, cls=Command, **more)(function)
    return typer.main.get_command(typed)


def app_group(function: Callable[[str], Callable[..., None]], summary: str) -> typer.Typer:
    """A command with a subcommand for each application, made when it is asked for.

    Args:
        function: name of an application -> function whose parameters typer reads.
        summary: help of the group.
    """

    class Apps(Group):
        def list_commands(self, ctx: Any) -> list[str]:
            return app_names()

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            if args and not args[0].startswith("-"):
                check_name(args[0])  # which lists the applications
            return super().resolve_command(ctx, args)

        def get_command(self, ctx: Any, name: str) -> Any:
            tables = registry()
            if name not in tables.applications:
                return None
            epilog = f"Commands to try: metapp examples {name}" if name in tables.examples else None
            return _typed(function(name), name, help=tables.applications[name].help, epilog=epilog)

    return typer.Typer(cls=Apps, no_args_is_help=True, help=summary)


data = typer.Typer(
    cls=DataCommands, no_args_is_help=True, help="Make data sets from files or by drawing them, and check them."
)
app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    context_settings=CONTEXT,
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
