"""Help of commands: panels of options with their placeholders, one line each if there is room.

typer's own help has columns of types and ranges, which leave half of a terminal to texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from typer.core import TyperArgument, TyperCommand, TyperGroup

from metapp.options import PANELS

if TYPE_CHECKING:
    from rich.text import Text

LABEL = 19  # columns of an option, so that texts of all panels begin at the same one
COMMANDS, OPTIONS = "Commands", "Options"  # panels; the second is of options that name none
NAME = "bold cyan"


class Command(TyperCommand):
    """A command with this help."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Words after the command's name in the line of usage."""
        return [*(_place(param) for param in self.params if isinstance(param, TyperArgument)), "[OPTIONS]"]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print usage, the text and the panels of options."""
        _print(self, ctx, {})


class Group(TyperGroup):
    """A group of commands with this help."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Words after the group's name in the line of usage."""
        return ["COMMAND", "[ARGS]..."]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print usage, the text, options and commands."""
        _print(self, ctx, {name: self.get_command(ctx, name) for name in self.list_commands(ctx)})


def _print(command: Any, ctx: Any, commands: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.padding import Padding
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    words = " ".join(command.collect_usage_pieces(ctx)).replace("[", "\\[")
    console.print(f"\n [yellow]Usage:[/] [bold]{ctx.command_path}[/] {words}")
    console.print(Padding(Text((command.help or "").replace("\b\n", "")), (1, 1, 0, 1)))
    panels: dict[str, list[tuple[Text, str]]] = {}
    for name, each in commands.items():
        if each:
            panels.setdefault(COMMANDS, []).append((Text(name, NAME), (each.help or "").partition("\n")[0]))
    order = [*PANELS, OPTIONS]
    shown = [param for param in command.get_params(ctx) if not getattr(param, "hidden", False) and param.name != "help"]
    shown.sort(key=lambda param: (order.index(param.rich_help_panel or OPTIONS), not isinstance(param, TyperArgument)))
    for param in shown:
        panels.setdefault(param.rich_help_panel or OPTIONS, []).append((_label(param), _text(param)))
    for title, rows in panels.items():
        grid = Table.grid(padding=(0, 2))
        grid.add_column(min_width=LABEL, no_wrap=True)
        for label, text in rows:
            grid.add_row(label, Text(text))
        console.print(Panel(grid, title=title, title_align="left", border_style="dim"))
    if command.epilog:
        console.print(Padding(Text(command.epilog), (1, 1, 0, 1)))


def _place(param: Any) -> str:
    return str(param.metavar or param.name.upper())


def _label(param: Any) -> Text:
    """An option with its placeholder, or an argument."""
    from rich.text import Text

    if isinstance(param, TyperArgument):
        return Text(_place(param), NAME)
    names = ", ".join([*sorted(param.opts, key=len), *param.secondary_opts])
    return Text.assemble((names, NAME), *([] if param.is_flag else [(f" {_place(param)}", "yellow")]))


def _text(param: Any) -> str:
    """The help of an option with its default, or that it must be given."""
    text = param.help or ""
    if param.required and not isinstance(param, TyperArgument):
        return f"{text} Required."
    default = getattr(param.default, "value", param.default)
    if isinstance(param.show_default, str):
        return f"{text} Default: {param.show_default}."
    if (
        param.show_default
        and default not in (None, "", (), [])
        and not isinstance(default, bool)
        and not callable(default)
    ):
        return f"{text} Default: {default}."
    return text
