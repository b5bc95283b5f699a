"""Commands and groups of typer that print their help by :mod:`metapp.cli.help_page`.

typer's own help has columns of types and ranges, which leave half of a terminal to the texts.
"""

from __future__ import annotations

import os
from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperGroup
from typing_extensions import override

from metapp.cli.arguments import value_placeholder
from metapp.options import BadOption


class HelpCommand(TyperCommand):
    """A command that prints the help page, and that never takes the name of a file for an option."""

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse empty words, and the name of a file that begins with a dash, which would be read as an option.

        A shell makes an empty word of a variable that is not set; it would be read as the current folder.
        """
        for before, word in zip(["", *args], args, strict=False):
            if not word or (word.startswith("--") and word.endswith("=")):
                place = f" after {before or word}" if before or word else ""
                raise BadOption(
                    f"an empty word{place}, expected a file or a value; is a variable of the shell not set?"
                )
        names = {name: param for param in self.get_params(ctx) for name in (*param.opts, *param.secondary_opts)}
        previous = ""
        for word in args[: args.index("--")] if "--" in args else args:
            option = names.get(previous)
            is_value = option is not None and not getattr(option, "is_flag", True)
            previous = word
            if word.startswith("-") and word not in names and not is_value and os.path.lexists(word):
                raise BadOption(
                    f"{word}: a file whose name begins with a dash, which would be read as options; write ./{word}."
                )
        result: list[str] = super().parse_args(ctx, args)
        return result

    @override
    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        return [*(value_placeholder(param) for param in self.params if isinstance(param, TyperArgument)), "[OPTIONS]"]

    @override
    def format_help(self, ctx: Any, formatter: Any) -> None:
        _print_help(self, ctx, [])


class HelpGroup(TyperGroup):
    """A group of commands that prints the help page."""

    @override
    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        return ["COMMAND", "[ARGS]..."]

    @override
    def format_help(self, ctx: Any, formatter: Any) -> None:
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        _print_help(
            self, ctx, [(name, (command.help or "").partition("\n")[0]) for name, command in commands if command]
        )


def _print_help(command: Any, ctx: Any, commands: list[tuple[str, str]]) -> None:
    """Print the help of a command; rich is imported here, since commands that work need little of it."""
    from metapp.cli.help_page import print_help

    print_help(command, ctx, commands)
