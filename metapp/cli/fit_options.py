"""The options of the paradigms, and which of them an application and a paradigm use."""

from __future__ import annotations

import typer

from data_tools.formats import exports_of, inputs_of
from metapp.apps import app_names
from metapp.cli import completion
from metapp.cli.names import DEVICES, PART_NAMES, RULE_NAMES, known_of
from metapp.storage import Document

PANELS = INPUT, FIT, OUTPUT, MACHINE = ("Input", "Fit", "Output", "Machine")
WITHOUT = "without any, the test tasks of --data; -: one a line of standard input, with --json a line of answer each"
# what an option or argument of each field of a Request is; names, types and defaults are the field's
OPTIONS: Document = {
    "app": typer.Argument(
        autocompletion=completion.applications,
        metavar="APP",
        rich_help_panel=INPUT,
        help=f"{', '.join(app_names())}; with its name --help shows its own options.",
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
        help="What a fit may see: reference (the default) or photo, which INPUT photos need.",
    ),
    "detail": typer.Option(
        metavar="PX",
        min=0,
        rich_help_panel=INPUT,
        help="Side that photos are read and fitted at: 256 (the default) or 512, which takes four times as long.",
    ),
    "fov": typer.Option(
        metavar="DEGREES",
        min=0,
        max=150,
        rich_help_panel=INPUT,
        help="The camera's field of view along the shorter side; default: as EXIF says, else 45 for flash photos, and "
        "balls are seen from far away.",
    ),
    "exposure": typer.Option(
        metavar="STOPS",
        min=-4,
        max=4,
        rich_help_panel=INPUT,
        help="How much too bright photos are (negative: too dark); right is where white paper just clips.",
    ),
    "exposures": typer.Option(
        metavar="T,T,...",
        rich_help_panel=INPUT,
        help="Merge INPUT photos of one mirror ball: their exposure times, such as 1/20,1/60, or auto.",
    ),
    "scene_root": typer.Option(
        metavar="DIR",
        exists=True,
        file_okay=False,
        rich_help_panel=INPUT,
        help="Another folder that files of a scene may come from; may be given several times.",
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
        help=f"{', '.join(RULE_NAMES)}; or parts with + between them: {', '.join(PART_NAMES)}; default: the recipe's.",
    ),
    "steps": typer.Option(metavar="N", min=0, rich_help_panel=FIT, help="Gradient steps instead of the recipe's."),
    "budget": typer.Option(
        metavar="TIME", rich_help_panel=FIT, help="As many of the steps as fit in this time a task: 50ms, 2s, 1.5min."
    ),
    "checkpoint": typer.Option(
        metavar="FILE", rich_help_panel=FIT, help="What fits begin at; default: trained here, else shipped."
    ),
    "train": typer.Option(
        "--train", rich_help_panel=FIT, help="Train first, on the training tasks of --data; goes on with --checkpoint."
    ),
    "train_steps": typer.Option(
        metavar="N", min=1, rich_help_panel=FIT, help="Outer training steps instead of the recipe's."
    ),
    "seed": typer.Option(
        metavar="N", min=0, max=2**63 - 1, rich_help_panel=FIT, help="Of all random draws; default: 0."
    ),
    "out": typer.Option(
        metavar="DIR", rich_help_panel=OUTPUT, help="Where runs and trained checkpoints are kept; default: runs."
    ),
    "export": typer.Option(
        autocompletion=completion.exports,
        metavar="KIND",
        rich_help_panel=OUTPUT,
        help="Write each fit in other forms, with commas between them.",
    ),
    "size": typer.Option(
        metavar="HxW",
        rich_help_panel=OUTPUT,
        help="px of what fits make: textures and maps to 4096x4096, environment maps to 1024x2048.",
    ),
    "render": typer.Option(
        metavar="PX",
        min=0,
        max=4096,
        rich_help_panel=OUTPUT,
        help="Render each scene as well, guided, and without a guide in the same time.",
    ),
    "watch": typer.Option(
        "--watch", rich_help_panel=OUTPUT, help="Rewrite watch.png as steps go by, and serve a page that shows them."
    ),
    "quiet": typer.Option("--quiet", "-q", rich_help_panel=OUTPUT, help="No progress bar, no table."),
    "device": typer.Option(
        autocompletion=completion.devices,
        metavar="NAME",
        rich_help_panel=MACHINE,
        help=f"{', '.join(DEVICES)}; default: auto.",
    ),
    "batch": typer.Option(
        metavar="N|auto",
        rich_help_panel=MACHINE,
        help="Fit so many inputs side by side, into one run that goes on where it was; what fails is listed at the "
        "end; writes gallery.html.",
    ),
    "shard": typer.Option(
        metavar="I/N", rich_help_panel=MACHINE, help="Fit every N-th input from the I-th on, of the same run folder."
    ),
}
JSON = typer.Option("--json", rich_help_panel=OUTPUT, help="One JSON object as last line of standard output.")
# options that some applications have
OWN = ("observe", "export", "size", "detail", "render", "fov", "exposure", "exposures", "scene_root")
NO_RULE = {"rule": "only meta has learned rules"}
# what a paradigm does not use, and why: scripts over all paradigms give all the same options, so it is ignored
IGNORED: dict[str, dict[str, str]] = {
    "general": {**NO_RULE, "steps": "general takes none"},
    "overfit": {**NO_RULE, "checkpoint": "overfit begins at random"},
    "finetune": NO_RULE,
    "quickft": NO_RULE,
}
# what help leaves out as well: General has no steps to take, Overfit nothing to train
POINTLESS = {"general": ("budget", "watch"), "overfit": ("train", "train_steps")}


def exports() -> str:
    """The values of --export, those of applications that have the same ones once."""
    apps: dict[str, list[str]] = {}
    for app in app_names():
        if exports_of(app):
            apps.setdefault(", ".join(exports_of(app)), []).append(app)
    return "; ".join(f"{', '.join(names)}: {forms}" for forms, names in apps.items())


def own_help(name: str) -> dict[str, str]:
    """What help says of arguments and options that differ between applications; of those it lacks, nothing."""
    known, takes = known_of(name), {taken for form in inputs_of(name) for taken in form.takes}
    forms = ", ".join(form.inputs for form in inputs_of(name))
    taken = {"fov": "fov_rad", "exposure": "exposure", "scene_root": "roots"}
    own = [*known.options, *(option for option, key in taken.items() if key in takes)]
    texts = {option: OPTIONS[option].help for option in own}
    if known.observe:
        texts["observe"] = OPTIONS["observe"].help
    if exports_of(name):
        texts["export"] = f"{', '.join(exports_of(name))}; several with commas between them."
    texts["inputs"] = f"What to fit: {forms}; or folders of these; {WITHOUT}."
    texts["recipe"] = f"{', '.join(known.recipes)}; default: full, the best that ships."
    return texts


def unused(paradigm: str, app: str) -> set[str]:
    """Options that help of a paradigm leaves out, of one application or, for "", of all."""
    by_app = {"app"} | (set(OWN) - own_help(app).keys()) if app else set(OWN)
    return by_app | IGNORED.get(paradigm, {}).keys() | set(POINTLESS.get(paradigm, ()))
