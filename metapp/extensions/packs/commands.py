"""`metapp pack` and `metapp unpack`: the fits of a run as one small file, and back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.options import FittedData, Json, Overwrite, RunPath, check_new, takes
from metapp.runs.reporter import number, say

if TYPE_CHECKING:
    from metapp.extensions.packs.pack import Packed

MadeBy = Annotated[Path | None, typer.Option(help="Checkpoint of the fits; default: the shipped one.")]


@dataclass(frozen=True)
class PackOptions:
    """Of `metapp pack`."""

    run: RunPath
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[INPUT]...", help="Original input, if it has moved."),
    ] = None
    data: FittedData = None
    out_file: Annotated[
        Path | None, typer.Option("--out", dir_okay=False, help="File to write; default: fits.pack in RUN.")
    ] = None
    bits: Annotated[
        int | None,
        typer.Option(
            min=2, max=16, help="Bits per number; default: the fewest that raise the mean error by 1 % at most."
        ),
    ] = None
    checkpoint: MadeBy = None
    overwrite: Overwrite = False
    json: Json = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no message.")] = False


@takes(PackOptions)
def pack_command(options: PackOptions) -> None:
    """Write the fits of a run as one small file: their quantised difference from the checkpoint.

    Example: metapp pack RUN --out materials.pack
    """
    from metapp.extensions.packs.pack import pack

    check_new(options.out_file, options.overwrite)
    done = pack(
        options.run,
        options.out_file,
        options.bits,
        options.inputs or [],
        data=options.data,
        checkpoint=options.checkpoint,
        quiet=options.quiet,
    )
    _tell(done, done.file, json=options.json, quiet=options.quiet)


def unpack_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File written by metapp pack.")],
    out_folder: Annotated[
        Path | None,
        typer.Option("--out", file_okay=False, help="Run folder to write; default: FILE without its suffix."),
    ] = None,
    checkpoint: MadeBy = None,
    overwrite: Overwrite = False,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No message.")] = False,
) -> None:
    """Write the run folder of a pack, for metapp export, metapp compare and import metapp.mitsuba.

    Example: metapp unpack materials.pack --out runs/materials
    """
    from metapp.extensions.packs.pack import unpack

    done = unpack(file, out_folder, checkpoint, overwrite=overwrite)
    _tell(done, done.out, json=json, quiet=quiet)


def _tell(done: Packed, made: str, *, json: bool, quiet: bool) -> None:
    """Sizes and errors, and where what was made is."""
    if not quiet:
        mean = done.size / len(done.tasks)
        say(f"{len(done.tasks)} fits, {done.bits} bits a number: {done.size:,} bytes, {mean:,.0f} a fit")
        if done.after is not None:
            before, after = (number(error, ".4g") for error in (done.before, done.after))
            say(f"mean error {after}, of the fits {before}")
        say(made)
    if json:
        print_json(done._asdict())
