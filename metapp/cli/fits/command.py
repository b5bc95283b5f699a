"""`metapp general|overfit|finetune|quickft|meta`: fit tasks by one paradigm."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from metapp.apps import app_names
from metapp.cli.console import importing
from metapp.cli.fits.options import IGNORED, JSON, OPTIONS, PANELS, declared, own_help, unused
from metapp.cli.fits.run import fit
from metapp.cli.group import print_help
from metapp.cli.options import option_parameter, plain, signed
from metapp.runs.reporter import say
from metapp.runs.requests.request import Request

if TYPE_CHECKING:
    from typer._click import Context, HelpFormatter

# those that may be given several times
SEVERAL = {"inputs": list[Path] | None, "export": list[str] | None}


class FitCommand(TyperCommand):
    """A command whose help shows what the application that is named uses, or what all use, in three panels."""

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        """Note the application before --help is answered."""
        ctx.meta[__name__] = next((word for word in args if word in app_names()), "")
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print it, with the commands to try."""
        name = ctx.meta.get(__name__, "")
        texts, hidden = own_help(name) if name else {}, unused(self.name or "", name)
        params: list[Any] = [param for param in self.params if param.name not in hidden]
        params.sort(key=lambda param: PANELS.index(param.rich_help_panel))
        print_help(ctx, self.help or "", f"{name or 'APP'} [INPUT]...", params, texts)
        typer.echo(f" Commands to try: metapp examples{f' {name}' if name else ''}")


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
