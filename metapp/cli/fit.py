"""`metapp general|overfit|finetune|quickft|meta`: fit tasks by one paradigm."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from data_tools.formats import exports_of, inputs_of, merge_of
from metapp.apps import app_names
from metapp.cli.console import importing, lines_of_input
from metapp.cli.fitting import fit
from metapp.cli.options import Json
from metapp.runs.reporter import say
from metapp.runs.request import Request
from metapp.storage import Document

if TYPE_CHECKING:
    from typer._click import Context, HelpFormatter

RULE_NAMES = (
    "meta-sgd, meta-adam, meta-adam-tied, meta-curvature, meta-encoder, meta-lgd, meta-mean, meta-basis, meta-axes, "
    "ridge"
)
PART_NAMES = "adam, tied, sgd, rates, shared, solve, betas, loss, pace, eps, curvature, network, average, basis"
DEFAULT_RECIPE = "default: full, the best rule and size that ships"
LINES = "- with --json: one a line of standard input, each answered by a line at once."

# what an option or argument of each field of a Request is; names, types and defaults are the field's
OPTIONS: Document = {
    "app": typer.Argument(
        metavar="APP",
        help=f"Application: {', '.join(app_names())}; with its name --help shows its inputs and its own options.",
    ),
    "inputs": typer.Argument(
        metavar="[INPUT]...",
        help=f"What to fit: files of APP or folders of these; without any, the test tasks of --data. {LINES}",
    ),
    "steps": typer.Option(help="Gradient steps instead of the recipe's.", min=0),
    "rule": typer.Option(
        help=f"Meta's rule: {RULE_NAMES}; or parts of rules with + between them, such as adam+curvature+average, of "
        f"{PART_NAMES}; default: the recipe's best."
    ),
    "recipe": typer.Option(help=f"quick, full or paper; an application may have others; {DEFAULT_RECIPE}."),
    "observe": typer.Option(help="What a fit may see: reference (the default) or photo."),
    "budget": typer.Option(
        metavar="TIME",
        help="Take as many of the steps as fit in this time a task, such as 50ms, 2s or 1.5min, of inference.",
    ),
    "train": typer.Option("--train", help="Train the checkpoint on the training tasks first."),
    "train_steps": typer.Option(help="Outer training steps instead of the recipe's.", min=1),
    "checkpoint": typer.Option(
        help="Checkpoint to use; default: trained here, else shipped. With --train its training goes on."
    ),
    "data": typer.Option(help="Folder of task shards; default: the embedded set."),
    "out": typer.Option(help="Where runs and trained checkpoints are kept."),
    "batch": typer.Option(
        metavar="N|auto",
        help="Fit inputs side by side: N, or what proves quick and fits in the memory. What has been fitted is not "
        "fitted again, what fails is listed at the end and stops nothing else; writes gallery.html.",
    ),
    "shard": typer.Option(metavar="I/N", help="Fit every N-th input from the I-th on, of the same run folder."),
    "watch": typer.Option("--watch", help="Rewrite watch.png in the run's folder as steps go by."),
    "export": typer.Option(
        metavar="KIND", help="Write each fit in another form; several times or with commas: in each."
    ),
    "size": typer.Option(
        metavar="HxW",
        help="px of what fits make: textures and maps of stationary svBRDFs to 4096x4096, illumination to 1024x2048; "
        "default: four times the exemplar's, the map's as it is fitted.",
    ),
    "detail": typer.Option(
        metavar="PX",
        min=0,
        help="px a side that photos are read and fitted at, 256 or 512; 0: 256. 512 takes four times as long.",
    ),
    "render": typer.Option(
        metavar="PX",
        min=0,
        max=4096,
        help="Render each scene as well, guided at all bounces, and without a guide in the same time.",
    ),
    "fov": typer.Option(
        metavar="DEGREES",
        min=0,
        max=150,
        help="The camera's field of view along the shorter side; 0: as EXIF says, else 45 for flash photos, and photos "
        "of a ball are taken as from far away.",
    ),
    "exposure": typer.Option(
        metavar="STOPS",
        min=-4,
        max=4,
        help="By how many stops INPUT photos are too bright, negative: too dark; right is where white paper below the "
        "flash would just be white. Colours are scaled by that before fits see them.",
    ),
    "exposures": typer.Option(
        metavar="T,T,...|auto",
        help="Merge INPUT photos of one mirror ball: their exposure times in their order, such as 1/20,1/60; auto: as "
        "EXIF says, else as pixels tell.",
    ),
    "scene_root": typer.Option(
        metavar="DIR",
        exists=True,
        file_okay=False,
        help="A folder beside a scene's own that its meshes, bitmaps, spectra and includes may come from; no plugins.",
    ),
    "seed": typer.Option(help="Seed of all random draws.", min=0, max=2**63 - 1),
    "device": typer.Option(help="auto, cpu or cuda."),
    "quiet": typer.Option("--quiet", "-q", help="No progress bar, no table."),
}
# options that some applications have
OWN = ("observe", "export", "size", "detail", "render", "fov", "exposure", "exposures", "scene_root")


# those that may be given several times
SEVERAL = {"inputs": list[Path] | None, "scene_root": list[Path] | None, "export": list[str] | None}


def exports() -> str:
    """The values of --export, those of applications that have the same ones once."""
    apps: dict[str, list[str]] = {}
    for app in app_names():
        if exports_of(app):
            apps.setdefault(", ".join(exports_of(app)), []).append(app)
    return "; ".join(f"{', '.join(names)}: {forms}" for forms, names in apps.items())


def own_help(name: str) -> dict[str, str]:
    """What help says of arguments and options that differ between applications; of those it lacks, nothing."""
    from metapp.appearance.presentation import Presentation
    from metapp.apps import app_of, presentation_of, protocols_of, recipes_of
    from metapp.runs.checks import details

    recipes, takes = recipes_of(name), {taken for form in inputs_of(name) for taken in form.takes}
    shown = presentation_of(app_of(name, next(iter(recipes.values()))))
    forms = ", ".join(form.inputs for form in inputs_of(name))
    found = {
        "inputs": f"What to fit: {forms}; or folders of these; without any, the test tasks of --data. {LINES}",
        "recipe": f"{', '.join(recipes)}; {DEFAULT_RECIPE}.",
        "observe": OPTIONS["observe"].help if protocols_of(name) else "",
        "export": f"{OPTIONS['export'].help} {', '.join(exports_of(name))}." if exports_of(name) else "",
        "size": OPTIONS["size"].help if type(shown).refusal is not Presentation.refusal else "",
        "detail": OPTIONS["detail"].help if details(name) else "",
        "render": OPTIONS["render"].help if shown.renders else "",
        "fov": OPTIONS["fov"].help if "fov_rad" in takes else "",
        "exposure": OPTIONS["exposure"].help if "exposure" in takes else "",
        "exposures": OPTIONS["exposures"].help if merge_of(name) else "",
        "scene_root": OPTIONS["scene_root"].help if "roots" in takes else "",
    }
    return {key: text for key, text in found.items() if text}


class FitCommand(TyperCommand):
    """A command whose help shows the options of the application that is named, or those that all have."""

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        """Note the application before --help is answered."""
        ctx.meta[__name__] = next((word for word in args if word in app_names()), "")
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Write the help of the command as if it had these options alone."""
        name = ctx.meta.get(__name__, "")
        texts = own_help(name) if name else {}
        command = copy.copy(self)
        command.params = [copy.copy(param) for param in self.params if param.name not in OWN or param.name in texts]
        for param in command.params:
            if param.name in texts:
                param.help = texts[param.name]  # type: ignore[attr-defined]  # of typer's arguments and options
        TyperCommand.format_help(command, ctx, formatter)


def make_command(name: str, summary: str) -> Callable[..., None]:
    """The command of one paradigm; they differ in name and help only."""

    def command(json: bool, **options: Any) -> None:
        with importing():
            from metapp.runs.plan import plan
        options["export"] = ",".join(options["export"] or ())
        request = Request(paradigm=name, **{key: value for key, value in options.items() if value is not None})
        lines = request.inputs == [Path("-")]
        if lines and (not json or request.batch or request.shard or request.render or request.exposures):
            others = "no --batch, --shard, --render, --exposures"
            raise typer.BadParameter(f"-: give --json, by which lines are answered, {others}.")
        planned = plan(request)
        for remark, unused in (
            ("--rule: only meta has learned rules", request.rule and name != "meta"),
            ("--steps: general takes none", request.steps and name == "general"),
            ("--checkpoint: overfit begins at random", request.checkpoint and name == "overfit"),
        ):
            if unused:  # scripts over all paradigms give all the same options
                say(f"{remark}; the option is ignored.")
        some = (replace(request, inputs=(Path(line),)) for line in lines_of_input()) if lines else None
        fit(planned, some, json=json)

    hints = get_type_hints(Request)
    parameters = []
    for field in fields(Request):
        if field.name in OPTIONS:
            several = SEVERAL.get(field.name)
            kind: Any = several or hints[field.name]
            annotation = Annotated[kind, OPTIONS[field.name]]
            default = None if several else inspect.Parameter.empty if field.name == "app" else field.default
            keyword = inspect.Parameter.KEYWORD_ONLY
            parameters.append(inspect.Parameter(field.name, keyword, default=default, annotation=annotation))
    parameters.append(inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Json))
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__doc__ = summary
    return command
