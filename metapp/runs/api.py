"""The Python API: functions that fit files, objects in memory and data sets, and that read fits back.

They return fits and write no folder of a run: `metapp.runs.execution` does that for the command line.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from metapp.learning.task import Task
from metapp.options import BadOption
from metapp.runs.choice import choose, choose_as_recorded, find_and_choose
from metapp.runs.environment import torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fit_options import FitOptions, fit_options
from metapp.runs.fitter import BadInput, Fitter, fit_inputs
from metapp.runs.inputs.finding import source_of_tensors
from metapp.runs.inputs.run_inputs import are_objects, find_inputs, rename_duplicates
from metapp.runs.outputs.run_records import find_fitted_tasks, read_fit_of_file, read_run_records
from metapp.runs.reporter import say
from metapp.storage.parameters import read_checked_params

# Options that only fits in folders have, which the command line keeps and a Python program does not
COMMAND_LINE_OPTIONS = ("train", "train_steps", "resume", "export")


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
    for name in COMMAND_LINE_OPTIONS:
        if options.get(name):
            raise BadOption(f"{name}: an option of the command line, which keeps fits in folders; leave it out.")
    try:
        # tensors tell inputs apart; they must not be made on a default device that the program has set
        with torch_defaults(single=False):
            inputs = sources or []
            if not are_objects(inputs):
                inputs = [Path(place) for place in inputs]
            return _fit_named_inputs(fit_options(app, paradigm, inputs, quiet=True, **options))
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
        records = [read_fit_of_file(path)] if path.is_file() else read_run_records(path).records
        if len(records) != 1:
            raise ValueError(f"{path}: {len(records)} fits, expected the folder of one task; take one inside it.")
        (record,) = records
        choice = choose_as_recorded(record.settings)
        parameters = read_checked_params(record, choice.app)
        task = find_fitted_tasks(records, [], None).get(record.name, Task(record.name, {}))
        return Fit(choice, task, record, parameters)


def _fit_named_inputs(options: FitOptions) -> list[Fit]:
    """Fit the inputs that options name; a bad file that was found in a folder is left out with a warning."""
    choice = find_and_choose(options)
    with torch_defaults(single=choice.app.small_tensors):
        inputs, label = find_inputs(choice)
        if options.objects:
            # what objects hold is known once they are read, and the size to which they are read once the recipe is
            first_size = choice.app.read_size
            tasks = [run_input.read_task() for run_input in inputs]
            choice = choose(options, [source_of_tensors(options.application, task.name, task.data) for task in tasks])
            for line in choice.reasons:
                say(line)
            if choice.app.read_size != first_size:
                inputs, label = find_inputs(choice)
        fits, places = [], []
        for run_input, fit in fit_inputs(Fitter.of(choice, label), inputs):
            if isinstance(fit, Fit):
                fits.append(fit)
                places.append(run_input.place)
            elif run_input.is_named or not isinstance(fit, BadInput):
                raise fit
            else:
                say(f"warning: skipped {fit}")
        if not fits:
            raise ValueError(f"none of the {len(inputs)} found could be read.")
        for fit, task in zip(
            fits, rename_duplicates(zip(places, [fit.task for fit in fits], strict=True)), strict=True
        ):
            fit.task = task
        return fits
