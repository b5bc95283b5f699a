"""The checkpoint that fits begin at: the one that --checkpoint names, else the one that ships with metapp.

A file that anybody may have written is checked before a fit begins at it: it must belong to the application, the
paradigm or rule, what fits see, and the network. Training a checkpoint is `metapp.runs.checkpoint_training`.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import NamedTuple

from metapp.application import Application
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.networks.field import regrid
from metapp.paradigms import PARADIGMS
from metapp.paradigms.adam import QUICKFT_ADAM_SETTINGS
from metapp.paradigms.paradigm import CheckpointTraining
from metapp.runs.choice import Choice, has_shipped_recipe
from metapp.runs.inputs.refusals import check_files_of_user
from metapp.runs.inputs.run_inputs import data_label, training_data_folder
from metapp.runs.reporter import say
from metapp.storage import Document
from metapp.storage.checkpoint_files import load_checkpoint, tensor_digest
from metapp.storage.files import file_digest
from metapp.storage.shipped_checkpoints import QUICK_RECIPE_NAME, shipped_checkpoint_path


class Checkpoint(NamedTuple):
    """The checkpoint that fits begin at.

    Attributes:
        phi: the meta-parameters.
        source: the place that they were read from, in words.
        digest: 12 hexadecimal digits of the file's content; "" if the paradigm needs no checkpoint.
    """

    phi: MetaParameters
    source: str
    digest: str


def find_checkpoint(choice: Choice) -> Checkpoint:
    """Read the checkpoint of a choice: the one that --checkpoint names, else the one that ships.

    Raises:
        ValueError: there is no checkpoint, or it is one for another application, paradigm, observation or network.
    """
    trainings = choice.paradigm.trainings
    if not trainings:
        return Checkpoint(MetaParameters(), "a random initialisation", "")
    training, *tunings = trainings
    path, options = _checkpoint_path(choice, training), choice.options
    phi, header = load_checkpoint(path, choice.device, _shipped_path(choice, training.general))
    _require_kind(path, choice, training, phi, header)
    template = training.template(phi)
    phi = resample_alpha_grids(choice.app, phi, template.alpha)
    try:
        require_matching_tensors(path, phi, template)
    except ValueError as error:
        quick_folder = shipped_checkpoint_path(choice.app.name, training.name).parent
        if path.parent == quick_folder and options.recipe != QUICK_RECIPE_NAME:
            raise ValueError(
                f"{str(error).removesuffix('.')}; this checkpoint ships for --recipe {QUICK_RECIPE_NAME}."
            ) from None
        raise
    source = str(path)
    if not options.checkpoint:
        note = ", trained on other data, which may hold these tasks" if options.data else ""
        source = f"the checkpoint that ships{note}"
    checkpoint = Checkpoint(phi, source, file_digest(path))
    for tuning in tunings:
        checkpoint = _add_tuned_adam(choice, checkpoint, tuning)
    return checkpoint


def trained_checkpoint_path(choice: Choice, training: CheckpointTraining) -> Path:
    """Return the path of the checkpoint that --train writes: its folder names the data, the recipe and the seed."""
    label = data_label(training_data_folder(choice.application, choice.options.data, choice.options.quiet))
    options = choice.options
    folder = options.out / choice.app.name / "checkpoints" / f"{label}-{options.recipe}-seed{options.seed}"
    return folder / f"{checkpoint_name(choice.application, choice.app, training)}.safetensors"


def checkpoint_name(application: Application, app: App, training: CheckpointTraining) -> str:
    """Return a checkpoint's file name without its suffix, such as "general" or "meta-photo".

    The name ends with what fits see unless that is the application's default. General learns nothing of it, so that its
    name has no such ending either if a recipe of the default has an equal network.
    """
    name = training.name
    if app.observes == application.default_observation:
        return name
    first_apps = (entry.load().app for entry in application.recipes_observing().values())
    is_shared = training.shared_by_observations and any(
        app.encoder_settings == first_app.encoder_settings for first_app in first_apps
    )
    return name if is_shared else f"{name}-{app.observes}"


def has_shipped_checkpoint(choice: Choice, training: CheckpointTraining) -> bool:
    """Return whether a checkpoint ships that training may begin at.

    Training on a data set of the user must not begin at one: the shipped checkpoint may have seen its test tasks.
    """
    return not choice.options.data and _has_shipped_recipe(choice) and _shipped_path(choice, training).is_file()


def _require_kind(
    path: Path, choice: Choice, training: CheckpointTraining, phi: MetaParameters, header: Document
) -> None:
    """Refuse a checkpoint for another application, paradigm or rule, for fits that see other things, or other features.

    A file of General may not say what fits see, since it serves several kinds of fits. A checkpoint without an encoder
    that was trained under other conditions gets a warning only.

    Args:
        path: the file of the checkpoint.
        choice: the choice of fits that need it.
        training: the training of the checkpoint that fits need.
        phi: the parameters in the file.
        header: the description in the file.
    """
    app, found_app, name = choice.app, header.get("app"), header.get("checkpoint")
    if (found_app, name) != (app.name, training.name):
        is_rule = isinstance(name, str) and name not in PARADIGMS
        remedy = (
            f"; add --rule {name}" if found_app == app.name and is_rule and choice.paradigm.has_learned_rule else ""
        )
        raise ValueError(f"{path}: a checkpoint of {found_app} {name}, expected {app.name} {training.name}{remedy}.")
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


def _add_tuned_adam(choice: Choice, checkpoint: Checkpoint, tuning: CheckpointTraining) -> Checkpoint:
    """Add to General's checkpoint the Adam that was tuned for this very encoder.

    It is read from a file beside the checkpoint that the user named, else from the one that ships.

    Args:
        choice: the choice of fits that need a tuned Adam.
        checkpoint: General's.
        tuning: the search for an Adam whose result is wanted.
    """
    options, app = choice.options, choice.app
    encoder = tensor_digest(checkpoint.phi.encoder)
    candidates = [_shipped_path(choice, tuning)]
    if options.checkpoint:
        folder = options.checkpoint if options.checkpoint.is_dir() else options.checkpoint.parent
        candidates.insert(0, folder / f"{checkpoint_name(choice.application, app, tuning)}.safetensors")
    for path in candidates:
        if path.is_file():
            tuned, header = load_checkpoint(path)
            if header.get("encoder") == encoder:
                require_tuned_adam(path, tuned)
                return merge_tuned_adam(checkpoint, tuned, path)
    words = ["metapp", tuning.name, app.name, "--train"]
    words += ["--observe", app.observes] if app.observes else []
    command = shlex.join(words + (["--data", str(options.data)] if options.data else []))
    say(f"{tuning.name}: no Adam was tuned for this encoder, so that the recipe's Adam is used; tune one by {command}")
    return checkpoint


def merge_tuned_adam(general: Checkpoint, tuned: MetaParameters, path: Path) -> Checkpoint:
    """Return General's checkpoint with the Adam that was tuned for it, read from the file `path`."""
    return Checkpoint(general.phi._replace(alpha=tuned.alpha), f"{general.source}, tuned Adam", file_digest(path))


def _checkpoint_path(choice: Choice, training: CheckpointTraining) -> Path:
    """Return the file of the checkpoint that fits need: the one that --checkpoint names, else the one that ships.

    Raises:
        ValueError: the folder that --checkpoint names has no such file, or no such checkpoint ships.
    """
    named_path = choice.options.checkpoint
    if named_path and named_path.is_dir():
        path = named_path / f"{checkpoint_name(choice.application, choice.app, training)}.safetensors"
        if not path.is_file():
            check_files_of_user(named_path, f"a folder of checkpoints with {path.name}")
            names = ", ".join(sorted(file.stem for file in named_path.glob("*.safetensors"))) or "no checkpoints"
            raise ValueError(
                f"{named_path}: holds {names}, expected {path.name}; train it with --train, or name another folder."
            )
        return path
    if named_path:
        return named_path
    path = _shipped_path(choice, training)
    if path.is_file() and _has_shipped_recipe(choice):
        return path
    raise ValueError(
        f"{choice.app.full_name} {training.name}, recipe {choice.options.recipe}: no checkpoint ships; train one with "
        "--train, or name one with --checkpoint."
    )


def _has_shipped_recipe(choice: Choice) -> bool:
    return has_shipped_recipe(choice.application, choice.options.recipe)


def _shipped_path(choice: Choice, training: CheckpointTraining) -> Path:
    return shipped_checkpoint_path(
        choice.app.name, checkpoint_name(choice.application, choice.app, training), choice.options.recipe
    )


def resample_alpha_grids(app: App, phi: MetaParameters, fresh: Params) -> MetaParameters:
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


def require_matching_tensors(path: Path, phi: MetaParameters, template: MetaParameters) -> None:
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


def require_tuned_adam(path: Path, tuned: MetaParameters) -> None:
    """Refuse a file of a tuned Adam whose hyperparameters are not one number for each setting of an Adam.

    Raises:
        ValueError: a setting is missing or no single number, or there is another one.
    """
    if set(tuned.alpha) != set(QUICKFT_ADAM_SETTINGS) or any(value.numel() != 1 for value in tuned.alpha.values()):
        raise ValueError(
            f"{path}: holds {', '.join(sorted(tuned.alpha)) or 'no settings'}, expected one number each for "
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
