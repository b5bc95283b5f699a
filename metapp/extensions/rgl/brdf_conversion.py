"""The conversion of measured BRDFs without a fit: MERL tables, RGL files in RGB or with spectra, NBRDF networks.

This is what `metapp export` does with files that are no runs. The module knows readers and writers of formats, but no
applications.
"""

from __future__ import annotations

import math
import shlex
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
from metapp.runs.inputs.refusals import check_files_of_user, check_new_files
from metapp.runs.reporter import progress, say
from metapp.storage.files import error_about_file

CONVERTED_ENDINGS = {  # endings of the files that are written, by the kind of export
    "merl": ".binary",
    "bsdf": rgl.RGL_SUFFIX,
    "bsdf-spectral": f"{rgl.SPECTRAL_ENDING}{rgl.RGL_SUFFIX}",
}
CONVERTED_READERS: tuple[ModuleType, ...] = (rgl, merl, nbrdf_files)


def write_converted(path: Path, kind: str, folder: Path, quiet: bool) -> list[Path]:
    """Convert a measured BRDF, or all of a folder, and write them under their names without _rgb and _spec.

    For MERL tables, RGL files are evaluated by Mitsuba at the centres of the bins. RGL files become RGL files on their
    own grids: spectra become colours in D65, and colours become the smoothest spectra that have them in D65.

    Args:
        path: a MERL table, an RGL file, an NBRDF folder, or a folder of these.
        kind: the format to write, a key of CONVERTED_ENDINGS.
        folder: the folder that files are written into.
        quiet: whether to show no progress.

    Returns:
        The files that were written.

    Raises:
        ValueError: no measured BRDF, a damaged file, two files of one name, an anisotropic material for a MERL table.
        BadOption: a file exists already.
    """
    check_files_of_user(path, "a run, MERL tables, RGL files or NBRDF networks")
    found_sources = [reader.find(path) for reader in CONVERTED_READERS if reader.recognises(path)]
    if not found_sources:
        problem = "another kind" if path.exists() else "no such file"
        remedy = f"fit other measurements: metapp meta brdf {shlex.quote(str(path))} --export {kind}"
        raise ValueError(f"{path}: {problem}, expected a run, MERL tables, RGL files or NBRDF networks; {remedy}.")
    sources_by_target: dict[Path, Path] = {}
    for source in dict.fromkeys(source.path for sources, _ in found_sources for source in sources):
        name = source.stem if source.is_file() else source.resolve().name  # names of folders may have dots
        target = folder / f"{name.removesuffix('_rgb').removesuffix(rgl.SPECTRAL_ENDING)}{CONVERTED_ENDINGS[kind]}"
        if target in sources_by_target:
            raise ValueError(
                f"{target}: both {sources_by_target[target]} and {source} would be written to it, expected names that "
                "differ; export one at a time."
            )
        sources_by_target[target] = source
    check_new_files(sources_by_target)
    # of several readers each one warns of the files of the others
    for line in found_sources[0][1] if len(found_sources) == 1 else ():
        say(f"warning: {line}")
    with progress(kind, len(sources_by_target), quiet=quiet) as bar:
        for target, source in sources_by_target.items():
            convert_brdf(source, kind, target)
            bar.advance(target.name)
    return list(sources_by_target)


def convert_brdf(source: Path, kind: str, target: Path) -> None:
    """Convert a measured BRDF and write it; RGL files that become RGL files keep their grids.

    Args:
        source: a MERL table, an RGL file, or an NBRDF folder.
        kind: the format to write, a key of CONVERTED_ENDINGS.
        target: the file to write.

    Raises:
        ValueError: the source is damaged, or it is an anisotropic material and the format MERL.
    """
    try:
        if kind == "merl":
            evaluate, half_turn = read_evaluator(source), torch.tensor([0, 0, math.pi])
            # a MERL table has one value for a pair of directions and the exchanged pair, where measurements differ
            merl.write_merl(target, tabulate_merl(lambda angles: (evaluate(angles) + evaluate(angles + half_turn)) / 2))
        elif source.suffix.lower() == rgl.RGL_SUFFIX:
            fields = read_tensor_file(source)
            rgl.check_fields(source, fields)
            write_tensor_file(target, fields_in_rgb(fields) if kind == "bsdf" else fields_in_spectra(fields))
        else:
            rgl.write_rgl(target, read_evaluator(source), source.name, spectral=kind != "bsdf")
    except ValueError as error:
        raise error_about_file(error, source) from None


def read_evaluator(source: Path) -> Callable[[Tensor], Tensor]:
    """Read a measured BRDF as a function.

    Returns:
        A function of angles (theta_h, theta_d, phi_d) [..., 3] in rad that returns linear RGB [..., 3] in 1/sr.
    """
    if not source.is_file():
        return partial(nbrdf_files.evaluate_nbrdf, nbrdf_files.read_nbrdf(source))
    if source.suffix.lower() == rgl.RGL_SUFFIX:
        return rgl.read_rgl(source)
    return partial(evaluate_merl, np.ascontiguousarray(merl.read_merl(source), np.float32))
