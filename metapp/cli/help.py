"""Help of commands: panels of options with their placeholders, one line each if there is room.

typer's own help has columns of types and ranges, which leave half of a terminal to texts.
"""

from __future__ import annotations

import os
from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperGroup

from metapp.cli.arguments import value_placeholder
from metapp.options import BadOption


class HelpCommand(TyperCommand):
    """A command with this help, which takes no file for an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse a name of a file that begins with a dash, which would be read as an option."""
        names = {name: param for param in self.get_params(ctx) for name in (*param.opts, *param.secondary_opts)}
        before = ""
        for word in args[: args.index("--")] if "--" in args else args:
            flag = names.get(before)
            is_value = flag is not None and not getattr(flag, "is_flag", True)
            before = word
            if word.startswith("-") and word not in names and not is_value and os.path.lexists(word):
                raise BadOption(f"{word}: a file whose name begins with a dash, read as options; write ./{word}.")
        result: list[str] = super().parse_args(ctx, args)
        return result

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Words after the command's name in the line of usage."""
        return [*(value_placeholder(param) for param in self.params if isinstance(param, TyperArgument)), "[OPTIONS]"]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print usage, the text and the panels of options."""
        _print(self, ctx, [])


class HelpGroup(TyperGroup):
    """A group of commands with this help."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Words after the group's name in the line of usage."""
        return ["COMMAND", "[ARGS]..."]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print usage, the text, commands and options."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        _print(self, ctx, [(name, (each.help or "").partition("\n")[0]) for name, each in commands if each])


def _print(command: Any, ctx: Any, commands: list[tuple[str, str]]) -> None:
    """Print the help of a command; rich is imported here, since commands that work need little of it."""
    from metapp.cli.help_page import print_help

    print_help(command, ctx, commands)
