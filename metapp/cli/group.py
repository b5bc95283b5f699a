"""Groups of commands that extensions offer, and help of a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from metapp import door

if TYPE_CHECKING:
    from rich.text import Text
    from typer._click import Context, HelpFormatter

LABEL = 19  # columns of an option in help, so that texts of all panels begin at the same one
ORDER = (  # of commands in help: first what a user does first, commands of other packages last
    *("try", "examples", "general", "overfit", "finetune", "quickft", "meta", "evaluate"),
    *("view", "export", "compare", "baseline", "plan", "data", "doctor"),
    # of data, readers by the application
    *("synth", "merl", "bsdf", "gonio", "nbrdf", "images", "flash", "maps", "strips", "materials", "laval"),
    *("cornell", "join", "check", "markers", "rectify", "ball", "vgg"),
)

_type_of = TyperOption.display_type_rich  # help shows that of flags as <bool>, without a setting for it
TyperOption.display_type_rich = lambda self, ctx: None if self.is_flag else _type_of(self, ctx)  # type: ignore[method-assign]


class Group(TyperGroup):
    """A group that lists commands by ORDER, and knows of which extension a command is that is left out."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands."""
        return sorted(self.commands, key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that is named; a usage error names the extension that has it."""
        kinds = (door.Command, door.Format) if args else ()
        for extension in filter(None, (door.switched_off(kind, args[0]) for kind in kinds)):
            raise typer.BadParameter(
                f"'{args[0]}' is a command of the extension {extension}, which {door.WITHOUT} leaves out; unset it."
            )
        return super().resolve_command(ctx, args)


class Command(TyperCommand):
    """A command whose help fits a screen: typer's own gives types, ranges and --help columns and lines of their own."""

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print it."""
        words = [str(param.metavar or param.name) for param in self.params if isinstance(param, TyperArgument)]
        print_help(ctx, self.help or "", " ".join(words), self.params)


def print_help(
    ctx: Context, text: str, words: str, params: Sequence[Any], texts: Mapping[str, str] | None = None
) -> None:
    """Print help of a command.

    Args:
        ctx: of the command.
        text: what it does.
        words: its arguments, for the line of usage.
        params: those to show, in panels.
        texts: their help where it is another than they have, by name.
    """
    from rich.console import Console
    from rich.padding import Padding
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    console, panels = Console(highlight=False), dict[str, Table]()
    usage = f"{ctx.command_path} {words} [OPTIONS]".split()
    console.print("\n ", Text(" ".join(usage)), sep="Usage: ")
    console.print(Padding(Text(text), (1, 1)))
    for param in params:
        title = param.rich_help_panel or ("Arguments" if isinstance(param, TyperArgument) else "Options")
        if title not in panels:
            panels[title] = Table.grid(padding=(0, 2))
            panels[title].add_column(min_width=LABEL, no_wrap=True)
        shown = (texts or {}).get(param.name) or param.help
        panels[title].add_row(_label(ctx, param), Text(f"{shown}{_default(param)}"))
    for title, grid in panels.items():
        console.print(Panel(grid, title=title, title_align="left", border_style="dim"))


def _default(param: Any) -> str:
    """What help says of an option that is not given."""
    if param.required:
        return "" if isinstance(param, TyperArgument) else " Required."
    shown = param.show_default if isinstance(param.show_default, str) else param.default
    says = "default:" in (param.help or "") or param.is_flag or shown in (None, "", ())
    return "" if says else f" Default: {getattr(shown, 'value', shown)}."


def _label(ctx: Context, param: Any) -> Text:
    """An option with what it takes, or an argument."""
    from rich.text import Text

    if isinstance(param, TyperArgument):
        return Text(str(param.metavar), "bold cyan")
    names = ", ".join(sorted(param.opts, key=len))
    kind = param.metavar or param.display_type_rich(ctx)
    return Text.assemble((names, "bold cyan"), *([(f" {kind}", "yellow")] if kind else []))


def add_commands(app: typer.Typer, under: str) -> None:
    """Add the commands that are offered under another one, or, for "", under none."""
    for offer in door.offers(door.Command):
        if offer.under == under:
            add_command(app, door.load(offer.command), offer.name, bare_is_help=offer.bare_is_help)


def add_command(app: typer.Typer, function: Callable[..., object], name: str, *, bare_is_help: bool) -> None:
    """Add a command; for --help the paragraphs of its docstring flow, while indented examples keep their lines."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    app.command(name, cls=Command, no_args_is_help=bare_is_help, help=text)(function)
