"""The command `metapp export`: write the fits of a run, or measurements and checkpoints, in another file format.

The file formats are entries of the registry; none is known here by its name.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import FittedData, JsonFlag, Quiet, check_out_folder, export_words
from metapp.cli.console import print_json
from metapp.registry import registry
from metapp.runs.reporter import say


def _describe_kinds() -> str:
    """Return the values of KIND for help: by application, equal ones together, then by files that are no run."""
    apps_by_kinds: dict[str, list[str]] = {}
    for name, application in sorted(registry().applications.items()):
        apps_by_kinds.setdefault(", ".join(registry().exports_of(application)), []).append(name)
    kinds_by_files: dict[str, list[str]] = {}
    for kind, entry in registry().file_exports.items():
        kinds_by_files.setdefault(entry.files, []).append(kind)
    lines = [f"{', '.join(apps)}: {kinds}" for kinds, apps in apps_by_kinds.items() if kinds]
    return "; ".join([*lines, *(f"{files}: {', '.join(kinds)}" for files, kinds in kinds_by_files.items())])


def export_command(
    source: Annotated[
        Path,
        typer.Argument(metavar="RUN", help="Folder of a run, or of runs, whose newest is taken; or a file, see KIND."),
    ],
    form: Annotated[str, typer.Argument(metavar="KIND", autocompletion=export_words, help=f"{_describe_kinds()}.")],
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[INPUT]...",
            help="Original input, for kinds that need it: nbrdf of a ridge fit, surfaces of flash photos. The "
            "embedded data set is found automatically.",
        ),
    ] = None,
    data: FittedData = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            callback=check_out_folder,
            help="Folder to write to; default: a folder named KIND, in the folder of each fit, or here for files.",
        ),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="HxW|N", help="Size of maps and textures, rows x columns.")
    ] = None,
    relief: Annotated[
        float | None,
        typer.Option(metavar="FACTOR", help="Factor on the slopes of normals of svBRDFs; default: the fit's, else 1."),
    ] = None,
    json: JsonFlag = False,
    quiet: Quiet = False,
) -> None:
    """Write the fits of a run, or measured BRDFs and checkpoints without a fit, in another file format.

    Examples:
      metapp export runs/brdf/meta bsdf
      metapp export chm_orange_rgb.bsdf merl
    """
    from metapp.runs.stored_fits import export_fits, holds_fits

    form_options = {name: value for name, value in (("size", size), ("relief", relief)) if value is not None}
    if form in registry().file_exports and not holds_fits(source):
        if inputs or data or form_options:
            raise typer.BadParameter(
                f"{source}: not a run, expected no INPUT and no option but --out; leave out the others."
            )
        folder = out or Path(form)
        files = [*registry().file_exports[form].load()(source, form, folder, quiet)]
        tasks = [file.stem for file in files]
    else:
        if source.is_file() and source.suffix != ".safetensors":
            remedy = f"fit it first: metapp meta APP {shlex.quote(str(source))} --export {form}"
            raise ValueError(f"{source}: a file, expected a run's folder, such as runs/brdf/meta; {remedy}.")
        folder, tasks, files = export_fits(
            source, form, inputs or [], data=data, out=out, options=form_options, quiet=quiet
        )
    if not quiet:
        say(f"written as {form}: {files[0] if len(files) == 1 else folder}")
    if json:
        print_json({"form": form, "out": str(folder), "tasks": tasks})
