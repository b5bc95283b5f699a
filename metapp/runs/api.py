"""The Python API: fit files or data sets, in memory."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from metapp.learning.task import Task
from metapp.options import BadOption
from metapp.runs.checkpoint_selection import attach_checkpoint
from metapp.runs.environment import torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fit_options import FitOptions, fit_options
from metapp.runs.fitting import BadInput, fit_sources
from metapp.runs.inputs.finding import source_of_tensors
from metapp.runs.inputs.run_inputs import are_objects, find_inputs, rename_duplicates, task_digest
from metapp.runs.outputs.run_records import find_fitted_tasks, read_fit_of_file, read_run_records
from metapp.runs.recipe_choice import choose_protocol_and_recipe
from metapp.runs.reporter import say
from metapp.runs.run import Run
from metapp.storage.parameters import read_checked_params

COMMAND_LINE_OPTIONS = ("train", "train_steps", "resume", "export")  # options of folders of fits


def fit(app: str, source: object, *, paradigm: str = "meta", **options: object) -> Fit:
    """Fit one file, a material, a texture, a map, a scene; or one in memory.

    Objects in memory are read as files are, at the same sizes and with the same checks. A picture is one of PIL, or an
    array or tensor [H, W, 3] or gray [H, W], rows from the top: integers of 8 or 16 bits are sRGB, floating-point
    values display values in [0, 1]. Maps of a material are a dictionary of pictures `diffuse`, `normal`, `roughness`,
    `specular`: integers as files hold them, colours sRGB, normals 0..255 for -1..1; floating-point values linear,
    colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of the surface. Functions get float32
    arrays and return arrays or tensors, [N, 3], or gray [N].

    Args:
        app: brdf, texture, svbrdf_stationary, svbrdf_nonstationary, illumination or transport.
        source: an INPUT of `metapp meta APP INPUT`, holding one task; or, in memory,
            of brdf f(wi, wo) -> reflectance, arrays (wi, wo, reflectance) or a BSDF of Mitsuba, as of
            `data_tools.readers.brdf_objects.task_of_object`;
            of texture a picture;
            of svbrdf_stationary a picture, the flash photo; or maps, of which a flash photo is rendered;
            of svbrdf_nonstationary maps, or a picture, the flash photo;
            of illumination linear radiance [H, 2 H, 3], floating point, the middle looks to +z, or a picture, the
            photo of a ball;
            of transport a scene as Mitsuba's `load_dict` takes it, or the text of an XML scene; files that it names
            are looked for in the current folder and in those of scene_root.
        paradigm: general, overfit, finetune, quickft or meta.
        options: as `fit_all` takes them.

    Raises:
        ValueError: a bad file or array, or a file with several tasks; an option that the application does not have.

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
    """Fit files and folders, things in memory, or the test tasks of a data set.

    Args:
        app: the application.
        sources: files and folders, or things in memory, as of `fit`; None: the test tasks of `data`, else of the
            embedded set.
        paradigm: general, overfit, finetune, quickft or meta.
        options: observe, rule, recipe, steps, data, checkpoint, seed, device, batch, and those of the application,
            with the names of the command line.

    Returns:
        The fits.

    Raises:
        ValueError: a bad file or array, no checkpoint; an option that the application does not have.
        FloatingPointError: a fit is not finite.
    """
    if isinstance(sources, str | PathLike | Mapping | np.ndarray | Tensor) or not isinstance(sources or (), Iterable):
        raise ValueError(f"{type(sources).__name__}: one source, expected a list of them; take metapp.fit for one.")
    if sources is not None and not (sources := list(sources)):
        raise ValueError("0 sources, expected a list of one or more; leave it out to fit a data set's test tasks.")
    for name in COMMAND_LINE_OPTIONS:
        if options.get(name):
            raise BadOption(f"{name}: of the command line, where fits are kept in folders; leave it out.")
    try:
        with torch_defaults(
            single=False
        ):  # a default device of the program would take the tensors of what tells inputs apart
            given = sources or []
            if not are_objects(given):
                given = [Path(source) for source in given]
            return _fitted(fit_options(app, paradigm, given, quiet=True, **options))
    except ValueError as error:
        if not os.environ.get("METAPP_TRACEBACK"):
            error.__traceback__ = None  # the message says what was given; frames of metapp would hide it
        raise


def load(place: str | bytes | PathLike[str]) -> Fit:
    """Read a fit back: a file of `Fit.save`, or a folder such as runs/brdf/meta/gold of `metapp meta brdf gold.binary`.

    Its task has data if the input is in its place, unchanged.

    Raises:
        ValueError: no fit, or several; damaged files, parameters of another network than the settings say.

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
        run, name = Run.of_settings(record["settings"]), record["name"]
        parameters = read_checked_params(record, run.app)
        task = find_fitted_tasks(records, run.app, [], None).get(name, Task(name, {}))
        return Fit(run, task, record, parameters)


def _fitted(options: FitOptions) -> list[Fit]:
    """Fits of the inputs that options name."""
    run = Run.of(options)
    with torch_defaults(single=run.app.single_threaded):
        sources, label = find_inputs(run)
        if options.objects:
            tasks = [source.task() for source in sources]
            told = [source_of_tensors(options.app, task.name, task.data) for task in tasks]
            chosen = Run.of(replace(options, observe=choose_protocol_and_recipe(options, told).protocol), told)
            if chosen.app.read_size != run.app.read_size:
                sources, label = find_inputs(chosen)
            run = chosen
        run = attach_checkpoint(run)
        fits, places, settings = [], [], run.settings(label)
        for source, fit in fit_sources(run, sources):
            if isinstance(fit, Fit):
                fit.record["settings"] = settings
                if not options.objects:
                    found = {"source": source.place, "content": task_digest(fit.task)}
                    fit.record |= found | {"origin": run.origin(source.given)}
                fits.append(fit)
                places.append(source.place)
            elif isinstance(fit, Exception):
                if source.named or not isinstance(fit, BadInput):
                    raise fit
                say(f"warning: skipped {fit}")
        if not fits:
            raise ValueError(f"none of the {len(sources)} found could be read.")
        for fit, task in zip(
            fits, rename_duplicates(zip(places, [fit.task for fit in fits], strict=True)), strict=True
        ):
            fit.task = task
        return fits
