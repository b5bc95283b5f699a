"""`metapp export-model`: General as a file for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from metapp.cli.console import print_json
from metapp.cli.options import Json, Overwrite, check_new, takes
from metapp.runs.reporter import progress, say
from metapp.storage import Document

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
    page: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            file_okay=False,
            help="A page, too, that makes maps of photos in a browser, offline.",
        ),
    ] = None
    overwrite: Overwrite = False
    json: Json = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No messages.")] = False


@takes(Options)
def export_model(options: Options) -> None:
    """Write General of flash photographs as an ONNX model: one photograph in, the maps of its material out.

    Input photo, sRGB 0 to 1, [1, 3, H, W]; outputs diffuse, specular, roughness, normal. Units, licences, the recipe
    and the checkpoint's digest are in the file's metadata. Large weights are in half precision.

    --page adds a folder whose index.html opens from disk, by onnxruntime-web, which is fetched from the npm registry
    once (33 MB) and kept in the cache. Everything the page needs lies in the folder; photos stay in the browser.

    Examples:
      metapp export-model svbrdf_nonstationary --out material.onnx
      metapp export-model svbrdf_nonstationary --page maps
    """
    from metapp.apps import class_of
    from metapp.extensions.onnx_files.models import OPSET, require

    if options.app != APP:
        class_of(options.app)
        raise typer.BadParameter(f"'{options.app}': expected {APP}, whose General makes maps of one photograph.")
    check_new(options.out, options.overwrite)
    check_new(options.page and options.page / "index.html", options.overwrite)
    require()
    parts = _runtime(options.quiet) if options.page else {}
    written, size = _written(options), options.out.stat().st_size
    document: Document = {"path": str(options.out), "bytes": size, "opset": OPSET}
    document["any_size"] = written.step is not None
    sizes = f"whose sides are multiples of {written.step}" if written.step else f"of {written.side} x {written.side}"
    if not options.quiet:
        say(f"{options.out}: {size / 1e6:.1f} MB, opset {OPSET}, takes photos {sizes} px")
    if options.page:
        document |= _page(options.page, options.out, parts, written, quiet=options.quiet)
    if options.json:
        print_json(document)


class Written(NamedTuple):
    """What a model takes.

    Attributes:
        side: of photos in px.
        step: what sides may be multiples of instead, if anything.
        features: whether it reads those of VGG-16.
    """

    side: int
    step: int | None
    features: bool


def _written(options: Options) -> Written:
    """Write the model."""
    from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
    from metapp.extensions.onnx_files.photographs import FEATURES, STEP, write_photographs
    from metapp.runs.checkpoints.finding import find_checkpoint
    from metapp.runs.requests.plan import plan
    from metapp.runs.requests.request import Request

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
    return Written(app.network.height, STEP if any_size else None, "features" in about)


def _runtime(quiet: bool) -> dict[str, bytes]:
    from metapp.extensions.onnx_files.runtime import VERSION, runtime

    with progress(f"onnxruntime-web {VERSION}", quiet=quiet) as bar:
        return runtime(lambda done, total: bar.at(done // 10**6, total and total // 10**6, "MB from npm"))


def _page(folder: Path, model: Path, parts: dict[str, bytes], written: Written, *, quiet: bool) -> Document:
    """Write the page; what there is to say of it."""
    from metapp.extensions.onnx_files.page import SIDES, write_folder
    from metapp.storage.files import read_bytes

    sides = SIDES if written.step else (written.side,)
    total = write_folder(folder, read_bytes(model), parts, sides, features=written.features)
    file = folder / "index.html"
    if not quiet:
        say(f"{file}: {total / 1e6:.1f} MB with what lies beside it; open it in a browser")
    return {"page": str(file), "page_bytes": total}
