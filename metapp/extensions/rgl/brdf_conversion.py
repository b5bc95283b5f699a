"""Measured BRDFs from one form into another, without a fit: MERL tables, RGL files in RGB and with spectra, NBRDF."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from data_tools.readers import merl, nbrdf_files
from data_tools.readers.merl import evaluate_merl, tabulate_merl
from metapp.extensions.rgl import rgl
from metapp.extensions.rgl.spectra import fields_in_rgb, fields_in_spectra
from metapp.extensions.rgl.tensor_file import read_tensor_file, write_tensor_file
from metapp.runs.fit_options import check_new_files
from metapp.runs.reporter import progress, say
from metapp.storage.files import error_about_file
from metapp.storage.folders import check_files_of_user

CONVERTED_ENDINGS = {
    "merl": ".binary",
    "bsdf": rgl.RGL_SUFFIX,
    "bsdf-spectral": f"{rgl.SPECTRAL_ENDING}{rgl.RGL_SUFFIX}",
}  # of what is written
CONVERTED_READERS: tuple[ModuleType, ...] = (rgl, merl, nbrdf_files)


def write_converted(path: Path, kind: str, folder: Path, quiet: bool) -> list[Path]:
    """Write a file, or those of a folder, in a form, without the ends _rgb and _spec of RGL names.

    RGL files are evaluated by Mitsuba at the centres of MERL's bins; colours and spectra of RGL files become each
    other on the file's own grid. Spectra that are made of colours are the smoothest of that colour in D65.

    Raises:
        ValueError: none of these, damaged, two of one name, or an anisotropic material for a MERL table.
        BadOption: a file is there already.
    """
    check_files_of_user(path, "a run, MERL tables, RGL files or NBRDF networks")
    found = [reader.find(path) for reader in CONVERTED_READERS if reader.recognises(path)]
    if not found:
        problem = "another kind" if path.exists() else "no such file"
        remedy = f"fit other measurements: metapp meta brdf {path.name} --export merl,bsdf"
        raise ValueError(f"{path}: {problem}, expected a run, MERL tables, RGL files or NBRDF networks; {remedy}.")
    places: dict[Path, Path] = {}  # by the files that they are written to
    for source in dict.fromkeys(source.path for sources, _ in found for source in sources):
        name = source.stem if source.is_file() else source.resolve().name  # which may have dots
        target = folder / f"{name.removesuffix('_rgb').removesuffix(rgl.SPECTRAL_ENDING)}{CONVERTED_ENDINGS[kind]}"
        if target in places:
            raise ValueError(
                f"{target}: of both {places[target]} and {source}, expected names that differ; export one at a time."
            )
        places[target] = source
    check_new_files(places)
    for line in found[0][1] if len(found) == 1 else ():  # else another reader's files
        say(f"warning: {line}")
    with progress(kind, len(places), quiet=quiet) as bar:
        for target, source in places.items():
            convert_brdf(source, kind, target)
            bar.advance(target.name)
    return list(places)


def convert_brdf(source: Path, kind: str, target: Path) -> None:
    """Write a source in a form; of RGL files for RGL files grids stay as they are.

    Raises:
        ValueError: damaged; an anisotropic material for a MERL table.
    """
    try:
        if kind == "merl":
            evaluate, back = read_evaluator(source), torch.tensor([0, 0, math.pi])
            # light and viewer exchanged are the same in a MERL table, and not quite in measurements
            merl.write_merl(target, tabulate_merl(lambda angles: (evaluate(angles) + evaluate(angles + back)) / 2))
        elif source.suffix.lower() == rgl.RGL_SUFFIX:
            fields = read_tensor_file(source)
            rgl.check_fields(source, fields)
            write_tensor_file(target, fields_in_rgb(fields) if kind == "bsdf" else fields_in_spectra(fields))
        else:
            rgl.write_rgl(target, read_evaluator(source), source.name, spectral=kind != "bsdf")
    except ValueError as error:
        raise error_about_file(error, source) from None


def read_evaluator(source: Path) -> Callable[[Tensor], Tensor]:
    """Linear RGB [..., 3] in 1/sr of angles (theta_h, theta_d, phi_d) [..., 3] in rad."""
    if not source.is_file():
        return partial(nbrdf_files.evaluate_nbrdf, nbrdf_files.read_nbrdf(source))
    if source.suffix.lower() == rgl.RGL_SUFFIX:
        return rgl.read_rgl(source)
    return partial(evaluate_merl, np.ascontiguousarray(merl.read_merl(source), np.float32))
