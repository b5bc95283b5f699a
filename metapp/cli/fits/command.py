"""`metapp general|overfit|finetune|quickft|meta`: fit tasks by one paradigm."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from typer.core import TyperArgument, TyperCommand

from metapp.apps import app_names
from metapp.cli.console import importing
from metapp.cli.fits.options import IGNORED, JSON, OPTIONS, PANELS, declared, own_help, unused
from metapp.cli.fits.run import fit
from metapp.cli.options import option_parameter, plain, signed
from metapp.runs.reporter import say
from metapp.runs.requests.request import Request

if TYPE_CHECKING:
    from rich.text import Text
    from typer._click import Context, HelpFormatter

LABEL = 19  # columns of an option in help, so that texts of all panels begin at the same one
# those that may be given several times
SEVERAL = {"inputs": list[Path] | None, "export": list[str] | None}


class FitCommand(TyperCommand):
    """A command whose help shows what the application that is named uses, or what all use, in four panels."""

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        """Note the application before --help is answered."""
        ctx.meta[__name__] = next((word for word in args if word in app_names()), "")
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print it: typer's own parts arguments from options and gives types, ranges and --help lines of their own."""
        from rich.console import Console
        from rich.padding import Padding
        from rich.panel import Panel
        from rich.table import Table

        name = ctx.meta.get(__name__, "")
        texts, hidden = own_help(name) if name else {}, unused(self.name or "", name)
        params: list[Any] = [param for param in self.params if param.name not in hidden]
        console = Console(highlight=False)
        console.print(f"\n [yellow]Usage:[/] [bold]{ctx.command_path} {name or 'APP'}[/] \\[INPUT]... \\[OPTIONS]")
        console.print(Padding(self.help or "", (1, 1)))
        for title in PANELS:
            grid = Table.grid(padding=(0, 2))
            grid.add_column(min_width=LABEL, no_wrap=True)
            for param in (param for param in params if param.rich_help_panel == title):
                grid.add_row(_label(param), texts.get(param.name, param.help))
            console.print(Panel(grid, title=title, title_align="left", border_style="dim"))
        console.print(Padding(f"Commands to try: [bold]metapp examples{f' {name}' if name else ''}[/]", (0, 1)))


def _label(param: Any) -> Text:
    """An option with what it takes, or an argument."""
    from rich.text import Text

    if isinstance(param, TyperArgument):
        return Text(str(param.metavar), "bold cyan")
    names = ", ".join(sorted(param.opts, key=len))
    return Text.assemble((names, "bold cyan"), *([(f" {param.metavar}", "yellow")] if param.metavar else []))


def make_command(name: str, summary: str) -> Callable[..., None]:
    """The command of one paradigm; they differ in name and help only."""

    def command(json: bool, **options: Any) -> None:
        with importing():
            from metapp.runs.requests.plan import plan
        options["export"] = ",".join(options["export"] or ())
        own = {key: plain(options.pop(key)) for key in own_options}
        values = {key: value for key, value in options.items() if value is not None}
        request = Request(
            paradigm=name, options={key: value for key, value in own.items() if value is not None}, **values
        )
        planned = plan(request)
        for option, remark in IGNORED.get(name, {}).items():
            if getattr(request, option):
                say(f"--{option}: {remark}; the option is ignored.")
        fit(planned, json=json)

    own_options = declared()
    hints, defaults = get_type_hints(Request), {field.name: field.default for field in fields(Request)}
    parameters = []
    for option, shown in OPTIONS.items():
        several = SEVERAL.get(option)
        default = None if several else inspect.Parameter.empty if option == "app" else defaults[option]
        parameters.append(option_parameter(option, default, Annotated[several or hints[option], shown]))
    parameters += [option_parameter(key, None, value) for key, value in own_options.items()]
    parameters.append(option_parameter("json", False, Annotated[bool, JSON]))
    command.__doc__ = summary
    return signed(command, command, parameters)
