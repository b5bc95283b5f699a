"""Help of commands: panels of options with their placeholders, one line each if there is room.

typer's own help has columns of types and ranges, which leave half of a terminal to texts.
"""

from __future__ import annotations

import os
from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperGroup

from metapp.options import PANELS, BadOption

LABEL = 19  # columns of an option, so that texts of all panels begin at the same one
COMMANDS, OPTIONS = "Commands", "Options"  # panels; the second is of options that name none


class Command(TyperCommand):
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
        return [*(_place(param) for param in self.params if isinstance(param, TyperArgument)), "[OPTIONS]"]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print usage, the text and the panels of options."""
        _print(self, ctx, [])


class Group(TyperGroup):
    """A group of commands with this help."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Words after the group's name in the line of usage."""
        return ["COMMAND", "[ARGS]..."]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print usage, the text, commands and options."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        _print(self, ctx, [(name, (each.help or "").partition("\n")[0]) for name, each in commands if each])


def _print(command: Any, ctx: Any, commands: list[tuple[str, str]]) -> None:
    from rich.console import Console
    from rich.padding import Padding
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    usage = " ".join(command.collect_usage_pieces(ctx))
    console.print(Text.assemble("\n ", ("Usage:", "yellow"), " ", (ctx.command_path, "bold"), f" {usage}"))
    console.print(Padding(Text((command.help or "").replace("\b\n", "")), (1, 1, 0, 1)))
    panels: dict[str, list[tuple[str, str, str]]] = {name: [] for name in (COMMANDS, *PANELS, OPTIONS)}
    panels[COMMANDS] = [(name, "", text) for name, text in commands]
    for param in sorted(command.get_params(ctx), key=lambda param: not isinstance(param, TyperArgument)):
        if isinstance(param, TyperArgument):
            panels[param.rich_help_panel or OPTIONS].append((_place(param), "", param.help or ""))
        elif not param.hidden and param.name != "help":
            names = ", ".join([*sorted(param.opts, key=len), *param.secondary_opts])
            place = "" if param.is_flag else f" {_place(param)}"
            panels[param.rich_help_panel or OPTIONS].append((names, place, f"{param.help or ''}{_default(param)}"))
    for title, rows in panels.items():
        grid = Table.grid(padding=(0, 2))
        grid.add_column(min_width=LABEL, no_wrap=True)
        for names, place, text in rows:
            grid.add_row(Text.assemble((names, "bold cyan"), (place, "yellow")), Text(text))
        if rows:
            console.print(Panel(grid, title=title, title_align="left", border_style="dim"))
    if command.epilog:
        console.print(Padding(Text(command.epilog), (1, 1, 0, 1)))


def _place(param: Any) -> str:
    return str(param.metavar or param.name.upper())


def _default(param: Any) -> str:
    """A sentence about the default of an option, or that it must be given."""
    default = getattr(param.default, "value", param.default)
    if param.required:
        return " Required."
    if isinstance(param.show_default, str):
        return f" Default: {param.show_default}."
    is_shown = param.show_default and not isinstance(default, bool) and not callable(default)
    return f" Default: {default}." if is_shown and default not in (None, "", (), []) else ""
