"""The options of the paradigms, and which of them an application and a paradigm use."""

from __future__ import annotations

import typer

from data_tools.formats import exports_of, inputs_of
from metapp.apps import app_names
from metapp.cli import completion
from metapp.cli.names import DEVICES, PART_NAMES, RULE_NAMES, known_of
from metapp.storage import Document

PANELS = INPUT, FIT, OUTPUT, MACHINE = ("Input", "Fit", "Output", "Machine")
WITHOUT = "default: the test tasks of --data; - (with --json): paths on standard input, one JSON line printed for each"
# what an option or argument of each field of a Request is; names, types and defaults are the field's
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
    "detail": typer.Option(
        metavar="PX",
        min=0,
        rich_help_panel=INPUT,
        help="Resolution at which photos are read and fitted: 256 (the default) or 512, which is four times as slow.",
    ),
    "fov": typer.Option(
        metavar="DEGREES",
        min=0,
        max=150,
        rich_help_panel=INPUT,
        help="Camera field of view along the shorter side; default: from EXIF, else 45 for flash photos and a distant "
        "camera for balls.",
    ),
    "exposure": typer.Option(
        metavar="STOPS",
        min=-4,
        max=4,
        rich_help_panel=INPUT,
        help="Stops by which photos are too bright (negative: too dark); at 0, white paper below the flash just clips.",
    ),
    "exposures": typer.Option(
        metavar="T,T,...",
        rich_help_panel=INPUT,
        help="Exposure times of INPUT photos of one mirror ball, which are merged: such as 1/20,1/60, or auto.",
    ),
    "scene_root": typer.Option(
        metavar="DIR",
        exists=True,
        file_okay=False,
        rich_help_panel=INPUT,
        help="Additional folder from which a scene may load files; may be given several times.",
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
        help=f"{', '.join(RULE_NAMES)}; or parts joined by +: {', '.join(PART_NAMES)}; default: the recipe's.",
    ),
    "steps": typer.Option(metavar="N", min=0, rich_help_panel=FIT, help="Gradient steps; default: the recipe's."),
    "budget": typer.Option(
        metavar="TIME",
        rich_help_panel=FIT,
        help="Time limit per fit (50ms, 2s, 1.5min): as many of the steps as it allows.",
    ),
    "checkpoint": typer.Option(
        metavar="FILE",
        rich_help_panel=FIT,
        help="Initialisation from this checkpoint; default: trained here, else shipped.",
    ),
    "train": typer.Option(
        "--train",
        rich_help_panel=FIT,
        help="Train first, on the training tasks of --data, from --checkpoint if given.",
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
    "size": typer.Option(
        metavar="HxW",
        rich_help_panel=OUTPUT,
        help="Output size in pixels: textures and maps up to 4096x4096, environment maps up to 1024x2048.",
    ),
    "render": typer.Option(
        metavar="PX",
        min=0,
        max=4096,
        rich_help_panel=OUTPUT,
        help="Also render each scene at this size, with path guiding and without it in equal time.",
    ),
    "watch": typer.Option(
        "--watch", rich_help_panel=OUTPUT, help="Show the fit while it runs: update watch.png and serve a page."
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
        help="Fit N inputs in parallel in one run; the same command again resumes it; failures are listed at the end; "
        "writes gallery.html.",
    ),
    "shard": typer.Option(
        metavar="I/N",
        rich_help_panel=MACHINE,
        help="Fit every N-th input from the I-th on; all shards share one run folder.",
    ),
}
JSON = typer.Option("--json", rich_help_panel=OUTPUT, help="Print one JSON object as the last line of standard output.")
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
        texts["export"] = f"{', '.join(exports_of(name))}; several separated by commas."
    texts["inputs"] = f"What to fit: {forms}; or folders of these; {WITHOUT}."
    texts["recipe"] = f"{', '.join(known.recipes)}; default: full, the best that ships."
    return texts


def unused(paradigm: str, app: str) -> set[str]:
    """Options that help of a paradigm leaves out, of one application or, for "", of all."""
    by_app = {"app"} | (set(OWN) - own_help(app).keys()) if app else set(OWN)
    return by_app | IGNORED.get(paradigm, {}).keys() | set(POINTLESS.get(paradigm, ()))
