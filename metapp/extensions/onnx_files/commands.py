"""`metapp export-model`: General as a file for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json, Overwrite, check_new, takes
from metapp.runs.reporter import say

APP = "svbrdf_nonstationary"


@dataclass(frozen=True)
class Options:
    """The options of the command."""

    app: Annotated[str, typer.Argument(metavar="APP", autocompletion=lambda: [APP], help=f"{APP}.")]
    recipe: Annotated[str, typer.Option(metavar="NAME", help="A recipe of photographs, as of metapp general.")] = "full"
    checkpoint: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="General's; default: the one that ships.")
    ] = None
    out: Annotated[Path, typer.Option(dir_okay=False, help="The file to write.")] = Path("material.onnx")
    overwrite: Overwrite = False
    json: Json = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No messages.")] = False


@takes(Options)
def export_model(options: Options) -> None:
    """Write General of flash photographs as an ONNX model: one photograph in, the maps of its material out.

    Input photo, sRGB 0 to 1, [1, 3, H, W]; outputs diffuse, specular, roughness, normal. Units, licences, the recipe
    and the checkpoint's digest are in the file's metadata. Large weights are in half precision.

    Example:
      metapp export-model svbrdf_nonstationary --out material.onnx
    """
    from metapp.apps import class_of
    from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
    from metapp.extensions.onnx_files.models import OPSET, require
    from metapp.extensions.onnx_files.photographs import FEATURES, STEP, write_photographs
    from metapp.runs.checkpoints.finding import find_checkpoint
    from metapp.runs.requests.plan import plan
    from metapp.runs.requests.request import Request

    if options.app != APP:
        class_of(options.app)
        raise typer.BadParameter(f"'{options.app}': expected {APP}, whose General makes maps of one photograph.")
    check_new(options.out, options.overwrite)
    require()
    request = Request(APP, "general", recipe=options.recipe, observe="photo", checkpoint=options.checkpoint, quiet=True)
    found = find_checkpoint(plan(request))
    app, checkpoint = found.app, found.checkpoint
    assert isinstance(app, SvbrdfNonstationary)
    assert checkpoint is not None
    about = {"made_by": "metapp export-model", "recipe": options.recipe, "checkpoint": checkpoint.digest}
    about |= {"license": "MIT"}
    if app.conditions():
        about |= {"features": FEATURES, "license": f"MIT; of the features: {FEATURES}"}
    any_size = write_photographs(app, checkpoint.prepared.encoder, about, options.out)
    side = app.field.height
    takes_sizes = f"photos whose sides are multiples of {STEP} px" if any_size else f"photos of {side} x {side} px"
    size = options.out.stat().st_size
    if not options.quiet:
        say(f"{options.out}: {size / 1e6:.1f} MB, opset {OPSET}, takes {takes_sizes}")
    if options.json:
        print_json({"path": str(options.out), "bytes": size, "opset": OPSET, "any_size": any_size})
