"""The checkpoint that fits begin at: the one that --checkpoint names, else the one that ships with metapp.

A file that anybody may have written is checked here, and nowhere else, before a fit begins at it: it must belong to the
application, the paradigm or rule, what fits see, and the network. Training a checkpoint is
`metapp.runs.checkpoint_training`.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from metapp.application import Application
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.learning.task import Params
from metapp.networks.field import regrid
from metapp.paradigms import PARADIGMS
from metapp.paradigms.trainings import QUICKFT_ADAM_SETTINGS, trainings_of
from metapp.runs.data_sets.embedded import embedded_folders
from metapp.runs.inputs.finding import FILES_LABEL, MEMORY_FORMAT, data_label
from metapp.runs.inputs.refusals import check_files_of_user
from metapp.runs.reporter import say
from metapp.runs.spec import Spec
from metapp.storage import Document
from metapp.storage.checkpoint_files import load_checkpoint, tensor_digest
from metapp.storage.files import file_digest
from metapp.storage.shipped_checkpoints import (
    FULL_RECIPE_NAME,
    QUICK_RECIPE_NAME,
    checkpoint_folder,
    shipped_checkpoint_path,
)

GENERAL = "general"  # the name of the checkpoint that others may take their encoder from


def read_checkpoint(spec: Spec, app: App, recipe: Recipe) -> MetaParameters:
    """Read the checkpoint of a specification: the one that --checkpoint names, else the one that ships.

    Returns:
        The meta-parameters, on the device of the specification; empty ones if the paradigm reads none.

    Raises:
        ValueError: there is no checkpoint, or it is one for another application, paradigm, observation or network.
    """
    trainings, files = trainings_of(spec.paradigm, app, recipe, spec.rule), checkpoint_files(spec, app, recipe)
    if not files:
        return MetaParameters()
    path, training = files[0], trainings[0]
    phi, header = _load(path, spec, app)
    _require_kind(path, spec, app, [training.name for training in trainings], phi, header)
    tuned = load_checkpoint(files[-1])[0].alpha if len(files) > 1 else {}
    if header.get("checkpoint") == "quickft" or tuned:
        tuned = tuned or phi.alpha
        _require_tuned_adam(files[-1], tuned)
        phi = phi._replace(alpha={})
    elif len(trainings) > 1:
        observed = ["--observe", app.observes] if app.observes else []
        command = shlex.join(["metapp", spec.paradigm, app.name, "--train", *observed])
        say(
            f"{spec.paradigm}: no Adam was tuned for this encoder, so that the recipe's Adam is used; tune one by "
            f"{command}"
        )
    template = training.template(phi)
    phi = _resample_alpha_grids(app, phi, template.alpha)
    try:
        _require_matching_tensors(path, phi, template)
    except ValueError as error:
        quick_folder = shipped_checkpoint_path(app.name, training.name).parent
        if path.parent == quick_folder and spec.recipe != QUICK_RECIPE_NAME:
            raise ValueError(
                f"{str(error).removesuffix('.')}; this checkpoint ships for --recipe {QUICK_RECIPE_NAME}."
            ) from None
        raise
    return phi._replace(alpha=tuned) if tuned else phi


def checkpoint_files(spec: Spec, app: App, recipe: Recipe) -> list[Path]:
    """Return the files of the checkpoint that a specification needs.

    QuickFT takes General's encoder and the Adam that was tuned for it, which is in a file beside it or ships. A QuickFT
    that was trained here has both in one file.

    Returns:
        No file if the paradigm reads none, else one or two.

    Raises:
        ValueError: the folder that --checkpoint names has no such file, or no such checkpoint ships.
    """
    names = [training.name for training in trainings_of(spec.paradigm, app, recipe, spec.rule)]
    if not names:
        return []
    path = _first_file(spec, app, names)
    is_general = len(names) > 1 and load_checkpoint(path)[1].get("checkpoint") == names[0]
    return [path, *(_find_tuned_adam(spec, app, path, names[1]) if is_general else [])]


def _first_file(spec: Spec, app: App, names: Sequence[str]) -> Path:
    """Return the file that --checkpoint names, or the first of some names in the folder that it names, or that ships.

    Raises:
        ValueError: the folder has no such file, or no such checkpoint ships.
    """
    named = spec.checkpoint
    if named and not named.is_dir():
        if not named.is_file():
            raise ValueError(
                f"{named}: no such checkpoint; give --checkpoint an existing .safetensors file, or train one."
            )
        return named
    files = [f"{checkpoint_name(spec.application, app, name)}.safetensors" for name in names]
    if named:
        found = [named / file for file in files if (named / file).is_file()]
        if not found:
            check_files_of_user(named, f"a folder of checkpoints with {files[0]}")
            there = ", ".join(sorted(file.stem for file in named.glob("*.safetensors"))) or "no checkpoints"
            raise ValueError(
                f"{named}: holds {there}, expected {files[0]}; train it with --train, or name another folder."
            )
        return found[0]
    path = _shipped_path(spec, app, names[0])
    if not (path.is_file() and has_shipped_recipe(spec.application, spec.recipe)):
        raise ValueError(
            f"{app.full_name} {names[0]}, recipe {spec.recipe}: no checkpoint ships; train one with --train, or name "
            "one with --checkpoint."
        )
    return path


def checkpoint_digest(spec: Spec, app: App, recipe: Recipe) -> str:
    """Return 12 hexadecimal digits of the content of a specification's checkpoint; "" if the paradigm reads none."""
    files = checkpoint_files(spec, app, recipe)
    return file_digest(files[-1]) if files else ""


def describe_checkpoint(spec: Spec, app: App, recipe: Recipe) -> str:
    """Return where the fits of a complete specification begin, in words."""
    if not spec.digest:
        return "a random initialisation"
    if spec.checkpoint:
        return str(checkpoint_files(spec, app, recipe)[0])
    labels = (FILES_LABEL, MEMORY_FORMAT, *map(data_label, embedded_folders(spec.application)))
    note = "" if spec.data in labels else ", trained on other data, which may hold these tasks"
    return f"the checkpoint that ships{note}"


def checkpoint_name(application: Application, app: App, name: str) -> str:
    """Return a checkpoint's file name without its suffix, such as "general" or "meta-photo".

    The name ends with what fits see unless that is the application's default. General learns nothing of it, so that its
    name has no such ending either if a recipe of the default has an equal network.

    Args:
        application: the application.
        app: the network of the fits, and what they see.
        name: the name of the checkpoint's training.
    """
    if app.observes == application.default_observation:
        return name
    first_apps = (entry.load().app for entry in application.recipes_observing().values())
    is_shared = name == GENERAL and any(app.encoder_settings == first_app.encoder_settings for first_app in first_apps)
    return name if is_shared else f"{name}-{app.observes}"


def has_shipped_checkpoint(spec: Spec, app: App, name: str) -> bool:
    """Return whether a checkpoint ships that the training of another one may begin at."""
    return has_shipped_recipe(spec.application, spec.recipe) and _shipped_path(spec, app, name).is_file()


def has_shipped_recipe(application: Application, recipe: str) -> bool:
    """Return whether checkpoints ship by which a recipe can fit.

    The recipe "full" needs none for itself where its application has the network of the recipe "quick".
    """
    has_checkpoints = recipe == QUICK_RECIPE_NAME or checkpoint_folder(application.name, recipe).is_dir()
    if has_checkpoints or recipe != FULL_RECIPE_NAME:
        return has_checkpoints
    recipes = application.recipes_observing()
    return bool(recipes[FULL_RECIPE_NAME].load().app == recipes[QUICK_RECIPE_NAME].load().app)


def usual_recipe(application: Application) -> str:
    """Return the recipe of a fit that names none: "full" (the best rule and size) if it ships, else "quick"."""
    has_full = FULL_RECIPE_NAME in application.recipes_observing()
    return FULL_RECIPE_NAME if has_full and has_shipped_recipe(application, FULL_RECIPE_NAME) else QUICK_RECIPE_NAME


def _load(path: Path, spec: Spec, app: App) -> tuple[MetaParameters, Document]:
    """Read a file of a checkpoint, with the encoder of the shipped General if its description names that one."""
    return load_checkpoint(path, spec.device, _shipped_path(spec, app, GENERAL))


def _shipped_path(spec: Spec, app: App, name: str) -> Path:
    return shipped_checkpoint_path(app.name, checkpoint_name(spec.application, app, name), spec.recipe)


def _require_kind(
    path: Path, spec: Spec, app: App, names: Sequence[str], phi: MetaParameters, header: Document
) -> None:
    """Refuse a checkpoint for another application, paradigm or rule, for fits that see other things, or other features.

    A file of General may not say what fits see, since it serves several kinds of fits. A checkpoint without an encoder
    that was trained under other conditions gets a warning only.

    Args:
        path: the file of the checkpoint.
        spec: the specification of fits that need it.
        app: the network of these fits.
        names: the names of checkpoints that they can read.
        phi: the parameters in the file.
        header: the description in the file.
    """
    found_app, name = header.get("app"), header.get("checkpoint")
    if found_app != app.name or name not in names:
        is_rule = isinstance(name, str) and name not in PARADIGMS
        remedy = f"; add --rule {name}" if found_app == app.name and is_rule and spec.rule else ""
        raise ValueError(f"{path}: a checkpoint of {found_app} {name}, expected {app.name} {names[0]}{remedy}.")
    # a file without an entry was written before there was one, or holds for all observations
    observed = header.get("observe", app.observes)
    if observed != app.observes:
        raise ValueError(
            f"{path}: a checkpoint for --observe {observed}, expected one for {app.observes}; give --observe "
            f"{observed} or another checkpoint."
        )
    for key, condition in app.recorded_conditions().items():
        trained_condition = header.get(key, condition)
        if trained_condition != condition and phi.encoder:
            raise ValueError(  # what is here comes first: a condition may say how to get what is missing
                f"{app.name}: {key} here: {condition}, expected {trained_condition}, which the encoder of {path} "
                "reads; or give another checkpoint, or train one with --train."
            )
        if trained_condition != condition:
            say(f"warning: {path.name} was trained with {trained_condition}, but this run has {condition}.")


def _find_tuned_adam(spec: Spec, app: App, general: Path, name: str) -> list[Path]:
    """Find the file of the Adam that was tuned for the encoder of a General, beside it or among those that ship.

    Args:
        spec: the specification.
        app: the network of its fits.
        general: the file of General that the user named.
        name: the name of the checkpoint that has the Adam.

    Returns:
        The file; [] if no Adam was tuned for this encoder.
    """
    encoder = tensor_digest(load_checkpoint(general)[0].encoder)
    beside = general.with_name(f"{checkpoint_name(spec.application, app, name)}.safetensors")
    for path in (beside, _shipped_path(spec, app, name)):
        if path.is_file() and _load(path, spec, app)[1].get("encoder") == encoder:
            return [path]
    return []


def _resample_alpha_grids(app: App, phi: MetaParameters, fresh: Params) -> MetaParameters:
    """Resample learned hyperparameters on a grid to the grid of an application's network.

    They may have been learned on a coarser grid, by another recipe of an equal network.

    Args:
        app: the application.
        phi: the meta-parameters of a file; hyperparameters on a grid are [K, C, H, W], with K steps.
        fresh: untrained hyperparameters on the application's grid, [K, C, H, W].

    Returns:
        The meta-parameters with resampled hyperparameters; all other tensors are as in the file.
    """
    alpha = dict(phi.alpha)
    for key, untrained in fresh.items():
        value = alpha.get(key, untrained)
        if value.ndim == untrained.ndim == 4 and value.shape[1] == untrained.shape[1] and min(value.shape) > 0:
            alpha[key] = regrid(value, *untrained.shape[2:], periodic=app.is_periodic)
    return phi._replace(alpha={key: alpha[key] for key in phi.alpha})


def _require_matching_tensors(path: Path, phi: MetaParameters, template: MetaParameters) -> None:
    """Refuse a checkpoint whose tensors have other names or shapes than the application and its rule need.

    Args:
        path: the file of the checkpoint, which messages name.
        phi: the meta-parameters in the file.
        template: untrained meta-parameters with the names and shapes that fits read.

    Raises:
        ValueError: a tensor is missing or has another shape; the message names it.
    """
    _require_tensors(path, "alpha", phi.alpha, template.alpha, steps=True)
    if template.theta:
        _require_tensors(path, "theta", phi.theta, template.theta)
    else:
        _require_tensors(path, "encoder", phi.encoder, template.encoder)


def _require_tuned_adam(path: Path, alpha: Params) -> None:
    """Refuse a file of a tuned Adam whose hyperparameters are not one number for each setting of an Adam.

    Raises:
        ValueError: a setting is missing or no single number, or there is another one.
    """
    if set(alpha) != set(QUICKFT_ADAM_SETTINGS) or any(value.numel() != 1 for value in alpha.values()):
        raise ValueError(
            f"{path}: holds {', '.join(sorted(alpha)) or 'no settings'}, expected one number each for "
            f"{', '.join(QUICKFT_ADAM_SETTINGS)}; tune again with metapp quickft APP --train."
        )


def _require_tensors(path: Path, part: str, params: Params, expected: Params, *, steps: bool = False) -> None:
    """Refuse a part of a checkpoint that lacks a tensor, has a further one, or one of another shape.

    Args:
        path: the file of the checkpoint.
        part: the name of the part: alpha, theta or encoder.
        params: the tensors in the file.
        expected: tensors with the expected names and shapes.
        steps: whether the first axis is one of steps, which may have any length.
    """

    def describe_shape(tensors: Params, key: str) -> str:
        if key not in tensors:
            return "missing"
        sizes = list(map(str, tensors[key].shape))
        sizes[:1] = ["steps"] if steps and sizes and key in params and key in expected else sizes[:1]
        return f"({', '.join(sizes)})"

    for key in sorted(expected | params, key=lambda key: key not in expected):
        shape, expected_shape = describe_shape(params, key), describe_shape(expected, key)
        if shape != expected_shape:
            remedy = "give a checkpoint of this application, rule and recipe, or train one with --train"
            raise ValueError(f"{path}: {part} {key} is {shape}, expected {expected_shape}; {remedy}.")
