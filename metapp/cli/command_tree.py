"""The tree of commands of the registry, each imported and made when it is asked for."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from metapp import __version__
from metapp.cli.data import make_convert_command
from metapp.cli.help import HelpCommand, HelpGroup
from metapp.names import app_names, did_you_mean
from metapp.options import BadOption, Converter
from metapp.paradigms import PARADIGMS
from metapp.registry import METAPP_PACKAGE, describe_error, registry
from metapp.runs.fit_options import check_app_name
from metapp.runs.reporter import say

COMMAND_ORDER = (  # of commands in help: first what a user does first, commands of other packages last
    *("try", "examples", *PARADIGMS, "evaluate"),
    *("view", "export", "compare", "baseline", "plan", "data", "doctor"),
    # of data, readers by the application
    *("synth", "merl", "bsdf", "gonio", "nbrdf", "images", "flash", "maps", "strips", "materials", "laval"),
    *("cornell", "join", "check", "markers", "rectify", "ball", "vgg"),
)
TYPER_CONTEXT = {"help_option_names": ["-h", "--help"]}


def make_lazy_group(
    summary: str,
    names: Callable[[], list[str]],
    command: Callable[[str], Any],
    refuse_unknown: Callable[[str], None],
    **more: Any,
) -> typer.Typer:
    """A group of commands, each of which is imported and made when it is asked for.

    Args:
        summary: help of the group.
        names: of commands, in the order of help.
        command: name -> the command; None if there is none.
        refuse_unknown: raises BadOption if a command has no such name.
        more: arguments of typer.
    """

    class Lazy(HelpGroup):
        def list_commands(self, ctx: Any) -> list[str]:
            return names()

        def get_command(self, ctx: Any, name: str) -> Any:
            return command(name)

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            if args and not args[0].startswith("-") and not ctx.resilient_parsing:
                refuse_unknown(args[0])
            return super().resolve_command(ctx, args)

    return typer.Typer(cls=Lazy, no_args_is_help=True, help=summary, **more)


def _registry_group(summary: str, under: str = "", **more: Any) -> typer.Typer:
    """A group of the commands of the registry, those whose names begin with `under`."""

    def names() -> list[str]:
        words = [name.removeprefix(under) for name in registry().commands if name.startswith(under)]
        return sorted((name for name in words if " " not in name), key=_place)

    def refuse_unknown(name: str) -> None:
        if f"{under}{name}" not in registry().commands:
            hint = did_you_mean(name, names())
            if name in app_names():
                hint = f" {name} is an application: metapp meta {name}."
            raise BadOption(f"No such command '{name}'.{hint}")

    def command(name: str) -> Any:
        """None also if typer cannot make a command of another package's function."""
        if f"{under}{name}" not in registry().commands:
            return None
        try:
            return _made(registry().commands[f"{under}{name}"].load(), name, bare_is_help=bool(under))
        except Exception as error:
            owner = registry().owners.get(f"commands {under}{name}", METAPP_PACKAGE)
            if owner == METAPP_PACKAGE:
                raise
            registry().problems[f"{under}{name} of {owner}"] = describe_error(error)
            return None

    return make_lazy_group(summary, names, command, refuse_unknown, **more)


def _place(name: str) -> int:
    return COMMAND_ORDER.index(name) if name in COMMAND_ORDER else len(COMMAND_ORDER)


def _made(command: Any, name: str, *, bare_is_help: bool) -> Any:
    """The command that typer makes of a function, of a converter or of a group.

    For --help the paragraphs of a docstring flow, while indented examples keep their lines.
    """
    if isinstance(command, typer.Typer):
        return typer.main.get_group(command)
    if isinstance(command, type) and issubclass(command, Converter):
        command = make_convert_command(name, command)
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    needs = any(each.default is each.empty for each in inspect.signature(command).parameters.values())
    return _typed(command, name, no_args_is_help=bare_is_help and needs, help=text)


def _typed(function: Callable[..., object], name: str, **more: Any) -> Any:
    typed = typer.Typer(add_completion=False, context_settings=TYPER_CONTEXT)
    typed.command(name, cls=HelpCommand, **more)(function)
    return typer.main.get_command(typed)


def make_app_group(function: Callable[[str], Callable[..., None]], summary: str) -> typer.Typer:
    """A command with a subcommand for each application.

    Args:
        function: name of an application -> function whose parameters typer reads.
        summary: help of the group.
    """

    def command(name: str) -> Any:
        tables = registry()
        if name not in tables.applications:
            return None
        epilog = f"Commands to try: metapp examples {name}" if name in tables.examples else None
        return _typed(function(name), name, help=tables.applications[name].help, epilog=epilog)

    return make_lazy_group(summary, app_names, command, check_app_name)


data_group = _registry_group("Make data sets from files or by drawing them, and check them.", "data ")
app = _registry_group(
    "Fit small neural networks to visual appearance: BRDFs, textures, svBRDFs, illumination, light transport.",
    context_settings=TYPER_CONTEXT,
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"metapp {__version__}")
        raise typer.Exit


@app.callback()
def take_root_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="The version of metapp.")
    ] = False,
) -> None:
    """Take the options that need no command; warn of extensions that cannot be used."""
    for extension, reason in registry().problems.items():
        say(f"warning: extension {extension}: {reason}; it is left out.")
