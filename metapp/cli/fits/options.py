"""The options of the paradigms, and those of them that an application and a paradigm use."""

from __future__ import annotations

import typer

from data_tools.formats import exports_of, inputs_of
from metapp import door
from metapp.apps import app_names, protocols_of
from metapp.cli import completion
from metapp.cli.options import annotated
from metapp.learning.names import rule_names
from metapp.runs.requests.options import all_options, options_of
from metapp.storage import Document

PANELS = INPUT, FIT, OUTPUT = ("Input", "Fit", "Output")
WITHOUT = "default: the test tasks of --data"
# of each field of a Request; names, types and defaults are the field's
OPTIONS: Document = {
    "app": typer.Argument(
        autocompletion=completion.applications,
        metavar="APP",
        rich_help_panel=INPUT,
        help=f"{', '.join(app_names())}; APP --help shows the options of that application.",
    ),
    "inputs": typer.Argument(
        metavar="[INPUT]...", rich_help_panel=INPUT, help=f"What to fit: files of APP or folders of these; {WITHOUT}."
    ),
    "data": typer.Option(
        metavar="DIR", rich_help_panel=INPUT, help="Folder of task shards; default: the embedded set."
    ),
    "observe": typer.Option(
        autocompletion=completion.observations,
        metavar="NAME",
        rich_help_panel=INPUT,
        help="What fits see: reference (ground truth, the default) or photo (photos alone; required for INPUT photos).",
    ),
    "recipe": typer.Option(
        autocompletion=completion.recipes,
        metavar="NAME",
        rich_help_panel=FIT,
        help="quick, full or paper; an application may have others; default: full, the best that ships.",
    ),
    "rule": typer.Option(
        autocompletion=completion.rules,
        metavar="NAME",
        rich_help_panel=FIT,
        help=f"{', '.join(rule_names())}; or parts joined by +, such as adam+curvature; default: the recipe's.",
    ),
    "steps": typer.Option(metavar="N", min=0, rich_help_panel=FIT, help="Gradient steps; default: the recipe's."),
    "checkpoint": typer.Option(
        metavar="FILE",
        rich_help_panel=FIT,
        help="Checkpoint, or a folder of these; default: what ships.",
    ),
    "train": typer.Option(
        "--train",
        rich_help_panel=FIT,
        help="Train first, on --data, from --checkpoint if given.",
    ),
    "train_steps": typer.Option(
        metavar="N", min=1, rich_help_panel=FIT, help="Outer training steps; default: the recipe's."
    ),
    "seed": typer.Option(metavar="N", min=0, max=2**63 - 1, rich_help_panel=FIT, help="Random seed; default: 0."),
    "out": typer.Option(
        metavar="DIR", rich_help_panel=OUTPUT, help="Folder for runs and trained checkpoints; default: runs."
    ),
    "export": typer.Option(
        autocompletion=completion.exports,
        metavar="KIND",
        rich_help_panel=OUTPUT,
        help="Also write each fit in these file formats, separated by commas.",
    ),
    "quiet": typer.Option("--quiet", "-q", rich_help_panel=OUTPUT, help="No progress bar, no table."),
    "device": typer.Option(
        autocompletion=completion.devices,
        metavar="NAME",
        rich_help_panel=FIT,
        help=f"{', '.join(completion.DEVICES)}; default: auto.",
    ),
    "batch": typer.Option(
        metavar="N",
        min=1,
        rich_help_panel=FIT,
        help="Fit N inputs in parallel; resume a run; list failures.",
    ),
}
JSON = typer.Option("--json", rich_help_panel=OUTPUT, help="Print one JSON object, the last line of output.")
NO_RULE = {"rule": "only meta has learned rules"}
# what a paradigm does not use, and why: scripts over all paradigms give all the same options, so it is ignored
IGNORED: dict[str, dict[str, str]] = {
    "general": {**NO_RULE, "steps": "general takes none"},
    "overfit": {**NO_RULE, "checkpoint": "overfit begins at random"},
    "finetune": NO_RULE,
    "quickft": NO_RULE,
}
# what help leaves out as well: Overfit has nothing to train
POINTLESS = {"overfit": ("train", "train_steps")}


def exports() -> str:
    """The values of --export, those of applications that have the same ones once."""
    apps: dict[str, list[str]] = {}
    for app in app_names():
        if exports_of(app):
            apps.setdefault(", ".join(exports_of(app)), []).append(app)
    return "; ".join(f"{', '.join(names)}: {forms}" for forms, names in apps.items())


def declared() -> dict[str, object]:
    """The options that extensions declare, by name, as typer takes them; None where they are not given."""
    return {name: annotated(option, given=True, panel=option.panel) for name, option in all_options().items()}


def own_help(name: str) -> dict[str, str]:
    """Help of arguments and options that differ between applications; of those it lacks, nothing."""
    texts = {option.name: option.help for option, _ in options_of(name)}
    forms = ", ".join(form.inputs for form in inputs_of(name))
    if protocols_of(name):
        texts["observe"] = OPTIONS["observe"].help
    if exports_of(name):
        texts["export"] = f"{', '.join(exports_of(name))}; several separated by commas."
    texts["inputs"] = f"What to fit: {forms}; or folders of these; {WITHOUT}." if forms else f"No file; {WITHOUT}."
    offered = dict.fromkeys(offer.name for offer in door.offers_of(door.Recipe, name))
    texts["recipe"] = f"{', '.join(offered)}; default: full, the best that ships."
    return texts


def unused(paradigm: str, app: str) -> set[str]:
    """Options that help of a paradigm leaves out, of one application or, for "", of all."""
    varying = {"observe", "export", *all_options()}
    by_app = {"app"} | (varying - own_help(app).keys()) if app else varying
    return by_app | IGNORED.get(paradigm, {}).keys() | {*POINTLESS.get(paradigm, ())}
