"""Help of commands: panels of options with their placeholders, one line each where there is room.

typer's own help has columns of types and ranges, which leave half of a terminal to texts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from typer.core import TyperArgument, TyperCommand, TyperGroup

from metapp.options import PANELS

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text
    from typer._click import Context, HelpFormatter

LABEL = 19  # columns of an option, so that texts of all panels begin at the same one
OPTIONS = "Options"  # panel of options that name none


class Command(TyperCommand):
    """A command with this help."""

    def collect_usage_pieces(self, ctx: Context) -> list[str]:
        """Words after the command's name in the line of usage."""
        return [*_places(self), "[OPTIONS]"]

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print usage, the text and the panels of options."""
        console = _begin(self, ctx)
        _options(console, self.get_params(ctx))
        if self.epilog:
            console.print(_padded(self.epilog))


class Group(TyperGroup):
    """A group of commands with this help."""

    def collect_usage_pieces(self, ctx: Context) -> list[str]:
        """Words after the group's name in the line of usage."""
        return ["COMMAND", "[ARGS]..."]

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print usage, the text, options and commands."""
        console = _begin(self, ctx)
        commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        texts = {name: (command.help or "").partition("\n")[0] for name, command in commands.items() if command}
        _panel(console, "Commands", [(_bold(name), text) for name, text in texts.items()])
        _options(console, self.get_params(ctx))


def _begin(command: Any, ctx: Context) -> Console:
    from rich.console import Console

    console = Console(highlight=False)
    words = _escaped(" ".join(command.collect_usage_pieces(ctx)))
    console.print(f"\n [yellow]Usage:[/] [bold]{ctx.command_path}[/] {words.strip()}")
    console.print(_padded(command.help or ""))
    return console


def _padded(text: str) -> RenderableType:
    from rich.padding import Padding
    from rich.text import Text

    return Padding(Text(text.replace("\b\n", "")), (1, 1, 0, 1))


def _options(console: Console, params: list[Any]) -> None:
    """Panels of arguments, then options, that are not hidden."""
    shown = [param for param in params if not getattr(param, "hidden", False) and param.name != "help"]
    panels: dict[str, list[tuple[Text, str]]] = {}
    order = [*PANELS, OPTIONS]
    shown.sort(key=lambda param: (order.index(param.rich_help_panel or OPTIONS), not _is_place(param)))
    for param in shown:
        panels.setdefault(getattr(param, "rich_help_panel", None) or OPTIONS, []).append((_label(param), _text(param)))
    for title, rows in panels.items():
        _panel(console, title, rows)


def _panel(console: Console, title: str, rows: list[tuple[Text, str]]) -> None:
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    grid = Table.grid(padding=(0, 2))
    grid.add_column(min_width=LABEL, no_wrap=True)
    for label, text in rows:
        grid.add_row(label, Text(text))
    console.print(Panel(grid, title=title, title_align="left", border_style="dim"))


def _places(command: Any) -> list[str]:
    return [str(param.metavar or param.name.upper()) for param in command.params if _is_place(param)]


def _is_place(param: Any) -> bool:
    return isinstance(param, TyperArgument)


def _escaped(text: str) -> str:
    return text.replace("[", "\\[")


def _bold(name: str) -> Text:
    from rich.text import Text

    return Text(name, "bold cyan")


def _label(param: Any) -> Text:
    """An option with its placeholder, or an argument."""
    from rich.text import Text

    if _is_place(param):
        return _bold(str(param.metavar or param.name.upper()))
    names = ", ".join(sorted(param.opts, key=len))
    place = param.metavar or ("" if param.is_flag else param.name.upper())
    return Text.assemble((names, "bold cyan"), *([(f" {place}", "yellow")] if place else []))


def _text(param: Any) -> str:
    """The help of an option with its default, or that it must be given."""
    text = param.help or ""
    if param.required and not _is_place(param):
        return f"{text} Required."
    default = getattr(param.default, "value", param.default)
    if isinstance(param.show_default, str):
        return f"{text} Default: {param.show_default}."
    if param.show_default and default is not False and default not in (None, "", (), []) and not callable(default):
        return f"{text} Default: {default}."
    return text
