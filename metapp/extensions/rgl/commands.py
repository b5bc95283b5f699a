"""`metapp data convert`: measured BRDFs from one form into another, without a fit."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.data.convert import Out, Quiet
from metapp.cli.options import Json, Overwrite, check_new
from metapp.runs.reporter import progress, say


class Kind(enum.StrEnum):
    """What is written."""

    MERL = "merl"
    BSDF = "bsdf"
    SPECTRAL = "bsdf-spectral"


def convert(
    paths: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help="MERL tables, RGL files, NBRDF networks; folders of them.")
    ],
    kind: Annotated[
        Kind,
        typer.Option(
            "--to",
            help="merl: NAME.binary; bsdf: NAME.bsdf for RGB variants of Mitsuba; bsdf-spectral: NAME_spec.bsdf for "
            "spectral ones.",
        ),
    ],
    folder: Out,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert measured BRDFs to MERL tables or RGL files, without a fit.

    RGL files are evaluated by Mitsuba at the centres of MERL's bins; colours and spectra of RGL files become each
    other on the file's own grid. Spectra that are made of colours are the smoothest of that colour in D65. Mitsuba's
    `measured` takes colours in RGB variants alone, and spectra in spectral variants alone.
    Samples of a goniometer are fitted first: metapp meta brdf paint.csv --export bsdf,bsdf-spectral,merl.

    Examples:
      metapp data convert chm_orange_rgb.bsdf --to merl --out merl
      metapp data convert felt_spec.bsdf --to bsdf --out rgb
      metapp data convert gold.binary --to bsdf-spectral --out rgl
    """
    from metapp.extensions.rgl import convert as forms

    sources, skipped = forms.find(paths)
    targets = forms.targets(sources, kind.value, folder)
    for target in targets:
        check_new(target, overwrite)
    for line in skipped:
        say(f"warning: {line}")
    with progress("convert", len(targets), quiet=quiet) as bar:
        for target, source in targets.items():
            forms.convert(source, kind.value, target)
            bar.advance(target.name)
    if not quiet:
        say(f"{kind.value}: {len(targets)} file{'' if len(targets) == 1 else 's'} in {folder}")
    if as_json:
        files = [{"source": str(source), "file": str(target)} for target, source in targets.items()]
        print_json({"to": kind.value, "out": str(folder), "files": files})
