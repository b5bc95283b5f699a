"""The tree of commands, as the registry has it; a command is imported and made when it is asked for.

So `metapp --help` imports neither torch nor an extension's code, and a broken extension breaks no other command.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typing_extensions import override

from metapp import __version__
from metapp.application import Application
from metapp.cli.data import make_convert_command
from metapp.cli.help import HelpCommand, HelpGroup
from metapp.entries import describe_error, did_you_mean
from metapp.options import BadOption, Converter
from metapp.registry import METAPP_PACKAGE, registry
from metapp.runs.reporter import say
from metapp.runs.spec import application_named

TYPER_CONTEXT = {"help_option_names": ["-h", "--help"]}


def make_lazy_group(
    summary: str,
    names: Callable[[], list[str]],
    command: Callable[[str], Any],
    refuse_unknown: Callable[[str], object],
    **more: Any,
) -> typer.Typer:
    """Make a group of commands, each of which is imported and made when it is asked for.

    Args:
        summary: the help of the group.
        names: returns the names of the commands, in the order of help.
        command: name -> the command, or None if there is none.
        refuse_unknown: raises BadOption if no command has a name.
        more: further arguments of `typer.Typer`.
    """

    class LazyGroup(HelpGroup):
        @override
        def list_commands(self, ctx: Any) -> list[str]:
            return names()

        @override
        def get_command(self, ctx: Any, name: str) -> Any:
            return command(name)

        @override
        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            if args and not args[0].startswith("-") and not ctx.resilient_parsing:
                refuse_unknown(args[0])
            return super().resolve_command(ctx, args)

    return typer.Typer(cls=LazyGroup, no_args_is_help=True, help=summary, **more)


def _registry_group(summary: str, prefix: str = "", **more: Any) -> typer.Typer:
    """Make the group of those commands of the registry whose names begin with a prefix.

    Args:
        summary: the help of the group.
        prefix: the beginning of the names, such as "data ", which the group's own commands lack.
        more: further arguments of `typer.Typer`.
    """

    def names() -> list[str]:
        words = [name.removeprefix(prefix) for name in registry().commands if name.startswith(prefix)]
        return sorted(
            (word for word in words if " " not in word),
            key=lambda word: registry().commands[f"{prefix}{word}"].position,
        )

    def refuse_unknown(name: str) -> None:
        if f"{prefix}{name}" not in registry().commands:
            hint = did_you_mean(name, names())
            if name in registry().applications:
                hint = f" {name} is an application: metapp meta {name}."
            raise BadOption(f"No such command '{name}'.{hint}")

    def command(name: str) -> Any:
        """Return the command of this name; None also if typer cannot make one of another package's function."""
        if f"{prefix}{name}" not in registry().commands:
            return None
        try:
            return _make_command(registry().commands[f"{prefix}{name}"].load(), name, bare_is_help=bool(prefix))
        except Exception as error:
            owner = registry().owner("commands", f"{prefix}{name}")
            if owner == METAPP_PACKAGE:
                raise
            registry().problems[f"{prefix}{name} of {owner}"] = describe_error(error)
            return None

    return make_lazy_group(summary, names, command, refuse_unknown, **more)


def _make_command(command: Any, name: str, *, bare_is_help: bool) -> Any:
    """Make the command of what the registry has: a function, a converter, or a group as it is.

    Paragraphs of a docstring flow in --help, while indented examples keep their lines.

    Args:
        command: the function, the converter or the group.
        name: the name of the command.
        bare_is_help: whether the command prints its help where it needs arguments and gets none.
    """
    if isinstance(command, typer.Typer):
        return typer.main.get_group(command)
    if isinstance(command, type) and issubclass(command, Converter):
        command = make_convert_command(name, command)
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    text = "\n\n".join(paragraph if "\n  " in paragraph else paragraph.replace("\n", " ") for paragraph in paragraphs)
    parameters = inspect.signature(command).parameters.values()
    has_required = any(parameter.default is parameter.empty for parameter in parameters)
    return _make_typer_command(command, name, no_args_is_help=bare_is_help and has_required, help=text)


def _make_typer_command(function: Callable[..., object], name: str, **more: Any) -> Any:
    """Make a command of a function by typer."""
    group = typer.Typer(add_completion=False, context_settings=TYPER_CONTEXT)
    group.command(name, cls=HelpCommand, **more)(function)
    return typer.main.get_command(group)


def make_app_group(function: Callable[[Application], Callable[..., None]], summary: str) -> typer.Typer:
    """Make a command with a subcommand for each application.

    Args:
        function: application -> function whose parameters typer reads.
        summary: the help of the group.
    """

    def command(name: str) -> Any:
        application = registry().applications.get(name)
        if application is None:
            return None
        epilog = f"Commands to try: metapp examples {name}" if application.examples else None
        return _make_typer_command(function(application), name, help=application.help, epilog=epilog)

    return make_lazy_group(summary, lambda: sorted(registry().applications), command, application_named)


data_group = _registry_group("Make data sets from files or by drawing them, and check them.", "data ")
app = _registry_group(
    "Fit small neural networks to visual appearance: BRDFs, textures, svBRDFs, illumination, light transport.",
    context_settings=TYPER_CONTEXT,
)


def _print_version(is_requested: bool) -> None:
    """Print the version and end the command, if the option is given."""
    if is_requested:
        typer.echo(f"metapp {__version__}")
        raise typer.Exit


@app.callback()
def take_root_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version of metapp and exit."),
    ] = False,
) -> None:
    """Take the options of `metapp` itself, and warn of extensions that cannot be used."""
    for extension, reason in registry().problems.items():
        say(f"warning: extension {extension}: {reason}; it is left out.")
