"""The page that --help prints: usage, text, and panels of commands and options.

Commands are known here as typer makes them; metapp's own tables are not.
"""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text
from typer.core import TyperArgument

from metapp.cli.arguments import value_placeholder
from metapp.options import PANELS

LABEL_CHARACTERS = 19  # least width of the names of options, so that the texts of most panels are aligned
# titles of panels; OPTIONS_PANEL holds the options that state no panel of their own
COMMANDS_PANEL, OPTIONS_PANEL = "Commands", "Options"


def print_help(command: Any, ctx: Any, commands: list[tuple[str, str]]) -> None:
    """Print usage, text and panels of a command.

    Args:
        command: the command, as typer made it.
        ctx: the command's context.
        commands: names of the commands below it, each with the first line of its help.
    """
    console = Console(highlight=False)
    usage = " ".join(command.collect_usage_pieces(ctx))
    console.print(Text.assemble("\n ", ("Usage:", "yellow"), " ", (ctx.command_path, "bold"), f" {usage}"))
    console.print(Padding(Text((command.help or "").replace("\b\n", "")), (1, 1, 0, 1)))
    panels: dict[str, list[tuple[str, str, str]]] = {name: [] for name in (COMMANDS_PANEL, *PANELS, OPTIONS_PANEL)}
    panels[COMMANDS_PANEL] = [(name, "", text) for name, text in commands]
    for param in sorted(command.get_params(ctx), key=lambda param: not isinstance(param, TyperArgument)):
        if isinstance(param, TyperArgument):
            panels[param.rich_help_panel or OPTIONS_PANEL].append((value_placeholder(param), "", param.help or ""))
        elif not param.hidden and param.name != "help":
            names = ", ".join([*sorted(param.opts, key=len), *param.secondary_opts])
            placeholder = "" if param.is_flag else f" {value_placeholder(param)}"
            panels[param.rich_help_panel or OPTIONS_PANEL].append(
                (names, placeholder, f"{param.help or ''}{_describe_default(param)}")
            )
    for title, rows in panels.items():
        table = Table.grid(padding=(0, 2))
        table.add_column(min_width=LABEL_CHARACTERS, no_wrap=True)
        for names, placeholder, text in rows:
            table.add_row(Text.assemble((names, "bold cyan"), (placeholder, "yellow")), Text(text))
        if rows:
            console.print(Panel(table, title=title, title_align="left", border_style="dim"))
    if command.epilog:
        console.print(Padding(Text(command.epilog), (1, 1, 0, 1)))


def _describe_default(param: Any) -> str:
    """Return a sentence on the default of an option, or that it must be given; "" if neither is to be said."""
    default = getattr(param.default, "value", param.default)
    if param.required:
        return " Required."
    if isinstance(param.show_default, str):
        return f" Default: {param.show_default}."
    is_shown = param.show_default and not isinstance(default, bool) and not callable(default)
    return f" Default: {default}." if is_shown and default not in (None, "", (), []) else ""
