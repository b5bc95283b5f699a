"""The Python API: functions that fit files, objects in memory and data sets, and that read fits back.

They return fits and write no folder of a run: `metapp.runs.keeping` does that for the command line.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from metapp.options import BadOption, options_by_name
from metapp.runs.environment import torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fitting import fit_each, make_fitters, say_doubts
from metapp.runs.inputs.finding import find
from metapp.runs.reporter import say
from metapp.runs.resolve import resolve
from metapp.runs.spec import RunOptions, Spec, parse_fit_options
from metapp.runs.stored_fits import read_known_fit, read_run

PROGRAM_OPTIONS = ("data", "batch", "quiet")  # of commands, which programs have, too; programs see no progress


def fit(app: str, source: object, *, paradigm: str = "meta", **options: object) -> Fit:
    """Fit one input: a file of a material, a texture, an environment map or a scene, or such an input in memory.

    Objects in memory are read as files are, at the same sizes and with the same checks. A picture is one of PIL, or an
    array or a tensor [H, W, 3] or grey [H, W], with rows from the top: integers of 8 or 16 bits are sRGB,
    floating-point numbers are display values in [0, 1]. Maps of a material are a dictionary of pictures `diffuse`,
    `normal`, `roughness` and `specular`. If they are integers, they are as files hold them: colours in sRGB, normals
    with 0..255 for -1..1. If they are floating-point numbers, they are linear: colours and roughness in [0, 1], normals
    unit vectors with x right, y up and z out of the surface. Functions get float32 arrays and return arrays or tensors
    [N, 3], or grey [N].

    Args:
        app: brdf, texture, svbrdf_stationary, svbrdf_nonstationary, illumination or transport.
        source: an INPUT of `metapp meta APP INPUT` that holds one task, or an object in memory. Objects are,
            for brdf, a function f(wi, wo) -> reflectance, arrays (wi, wo, reflectance) or a BSDF of Mitsuba, see
            :func:`data_tools.readers.brdf_objects.task_of_object`;
            for texture, a picture;
            for svbrdf_stationary, a picture (the flash photo), or maps, of which a flash photo is rendered;
            for svbrdf_nonstationary, maps, or a picture (the flash photo);
            for illumination, linear radiance [H, 2 H, 3] in floating point, whose middle looks to +z, or a picture
            (the photo of a ball);
            for transport, a scene as Mitsuba's `load_dict` takes it, or the text of an XML scene, which may name files
            in the current folder and in the folders of scene_root.
        paradigm: general, overfit, finetune, quickft or meta.
        options: further options by name, see :func:`fit_all`.

    Returns:
        The fit.

    Raises:
        ValueError: a file or an array is bad, a file holds several tasks, or the application does not have an option.

    >>> import metapp
    >>> fit = metapp.fit("brdf", lambda wi, wo: np.full((len(wi), 3), 0.3 / np.pi))
    >>> fit.settings["steps"], fit(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.6, 0.8]])).shape
    (10, (1, 3))
    """
    fits = fit_all(app, [source], paradigm=paradigm, **options)
    if len(fits) != 1:
        raise ValueError(f"{source}: {len(fits)} tasks, expected one; take metapp.fit_all for several.")
    return fits[0]


def fit_all(
    app: str,
    sources: Sequence[Any] | None = None,
    *,
    paradigm: str = "meta",
    **options: object,
) -> list[Fit]:
    """Fit files and folders, objects in memory, or the test tasks of a data set.

    Args:
        app: the name of the application.
        sources: files and folders, or objects in memory, see :func:`fit`. None stands for the test tasks of the data
            set `data`, and of the embedded set if there is no `data`.
        paradigm: general, overfit, finetune, quickft or meta.
        options: observe, rule, recipe, steps, data, checkpoint, seed, device and batch, and the application's own
            options, by the names that they have on the command line.

    Returns:
        The fits of all sources that could be read.

    Raises:
        ValueError: a file or an array is bad, there is no checkpoint, or the application does not have an option.
        FloatingPointError: a fit is not finite.
    """
    if isinstance(sources, str | PathLike | Mapping | np.ndarray | Tensor) or not isinstance(sources or (), Iterable):
        raise ValueError(f"{type(sources).__name__}: one source, expected a list of them; take metapp.fit for one.")
    if sources is not None and not (sources := list(sources)):
        raise ValueError("0 sources, expected a list of one or more; leave it out to fit a data set's test tasks.")
    for name in options_by_name(RunOptions).keys() - set(PROGRAM_OPTIONS):
        if options.get(name):
            raise BadOption(f"{name}: an option of the command line, which keeps fits in folders; leave it out.")
    try:
        # tensors tell inputs apart; they must not be made on a default device that the program has set
        with torch_defaults(single=False):
            return _fit_things(*parse_fit_options(app, paradigm, **options), sources or ())
    except ValueError as error:
        if not os.environ.get("METAPP_TRACEBACK"):
            error.__traceback__ = None  # the message says what was given; frames of metapp would hide it
        raise


def load(place: str | bytes | PathLike[str]) -> Fit:
    """Read a fit back from a file that `Fit.save` wrote, or from a folder such as runs/brdf/meta/gold of a command.

    The task of the fit has data only if its input is still in its place and has not changed.

    Raises:
        ValueError: there is no fit or there are several, files are damaged, or the parameters are those of another
            network than the settings describe.

    >>> import metapp, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = metapp.fit("brdf", lambda wi, wo: np.full((len(wi), 3), 0.1)).save(f"{folder}/gray.safetensors")
    ...     metapp.load(file).settings["steps"]
    10
    """
    path = Path(os.fsdecode(place))
    with torch_defaults(single=False):
        fits = [read_known_fit(path)] if path.is_file() else read_run(path).fits
    if len(fits) != 1:
        raise ValueError(f"{path}: {len(fits)} fits, expected the folder of one task; take one inside it.")
    (fit,) = fits
    _ = fit.parameters  # read and checked now, so that a damaged file is told of here
    return fit


def _fit_things(spec: Spec, options: RunOptions, things: Sequence[object]) -> list[Fit]:
    """Fit what a program names; a bad file that was found in a folder is left out with a warning."""
    inputs = find(spec, things, options.data)
    specs, lines = resolve(spec, inputs)
    for line in lines:
        say(line)
    fits: dict[int, Fit] = {}
    for one, result in fit_each(make_fitters(specs), inputs, batch=options.batch):
        if isinstance(result, Fit):
            say_doubts(result)
            fits[id(one)] = result
        elif result.fails_run:
            raise result.error
        else:
            say(f"warning: skipped {result.reason}")
    if not fits:
        raise ValueError(f"none of the {len(inputs)} found could be read.")
    return [fits[id(one)] for one in inputs if id(one) in fits]
