"""The entry of a checkpoint that fits begin at, in the file that --checkpoint names, else in one that ships.

A file that anybody may have written is checked here, and nowhere else, before a fit begins at it: it must belong to the
application, the paradigm or rule, what fits see, and the network. Training a checkpoint is
`metapp.runs.checkpoint_training`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

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
from metapp.runs.reporter import say
from metapp.runs.spec import Spec
from metapp.storage import Document
from metapp.storage.checkpoint_files import read_entry, read_headers
from metapp.storage.shipped_checkpoints import (
    FULL_RECIPE_NAME,
    QUICK_RECIPE_NAME,
    shipped_checkpoint_path,
    usable_shipped_checkpoints,
)

GENERAL = "general"  # the name of the training whose encoder others may begin at


class Entry(NamedTuple):
    """An entry of a checkpoint, before its tensors are read.

    Attributes:
        path: the file.
        name: the name of the entry.
        header: its description.
    """

    path: Path
    name: str
    header: Document


def read_checkpoint(spec: Spec, app: App, recipe: Recipe) -> MetaParameters:
    """Read the checkpoint of a specification: the one that --checkpoint names, else the one that ships.

    Returns:
        The meta-parameters, on the device of the specification; empty ones if the paradigm reads none.

    Raises:
        ValueError: there is no checkpoint, or it is one for another application, paradigm, observation or network.
    """
    trainings, entry = trainings_of(spec.paradigm, app, recipe, spec.rule), find_checkpoint(spec, app, recipe)
    if not entry:
        return MetaParameters()
    phi, _ = read_entry(entry.path, entry.name, spec.device)
    if not phi.theta and not phi.encoder:  # the recipe has the network of another one, whose file holds General
        general = find_entry(spec, app, [GENERAL])
        phi = phi._replace(encoder=read_entry(general.path, general.name, spec.device)[0].encoder)
    _check_conditions(entry, app, phi)
    tuned: Params = {}
    if trainings[-1].takes_encoder_from_general:
        if entry.header["checkpoint"] == trainings[-1].name:
            tuned, phi = phi.alpha, phi._replace(alpha={})
            _require_tuned_adam(entry.path, tuned)
        else:
            observed = f" --observe {app.observes}" if app.observes else ""
            say(
                "quickft: no Adam was tuned for this encoder, so that the recipe's Adam is used; tune one by metapp "
                f"quickft {app.name} --train{observed}"
            )
    template = trainings[0].template(phi)
    phi = _resample_alpha_grids(app, phi, template.alpha)
    try:
        _require_matching_tensors(entry.path, phi, template)
    except ValueError as error:
        if entry.path == shipped_checkpoint_path(app.name) and spec.recipe != QUICK_RECIPE_NAME:
            raise ValueError(
                f"{str(error).removesuffix('.')}; this checkpoint ships for --recipe {QUICK_RECIPE_NAME}."
            ) from None
        raise
    return phi._replace(alpha=tuned) if tuned else phi


def find_checkpoint(spec: Spec, app: App, recipe: Recipe) -> Entry | None:
    """Return the entry at which fits of a specification begin; None if the paradigm reads none.

    QuickFT takes a tuned Adam, which has the encoder that it was tuned for, or else General of the same file.

    Raises:
        ValueError: there is no such entry.
    """
    names = [training.name for training in trainings_of(spec.paradigm, app, recipe, spec.rule)]
    return find_entry(spec, app, names[::-1]) if names else None


def find_entry(spec: Spec, app: App, names: Sequence[str]) -> Entry:
    """Return the first entry that fits can begin at, of the file that --checkpoint names, or of files that ship.

    Args:
        spec: the specification of the fits.
        app: the network of the fits.
        names: the names of the trainings that such an entry may come from, the best first.

    Raises:
        ValueError: --checkpoint names no checkpoint that has such an entry, or none ships.
    """
    if spec.checkpoint:
        entry = find_in_file(spec.checkpoint, app, names)
        if not entry:
            raise ValueError(_describe_other_checkpoint(spec, app, names))
        return entry
    for path in _shipped_files(spec):
        if entry := find_in_file(path, app, names):
            return entry
    raise ValueError(
        f"{app.full_name} {names[-1]}, recipe {spec.recipe}: no checkpoint ships; train one with --train, or name "
        "one with --checkpoint."
    )


def _shipped_files(spec: Spec) -> list[Path]:
    """Return the files that ship in which the recipe of a specification looks for an entry, in this order."""
    ships = has_shipped_recipe(spec.application, spec.recipe)
    return usable_shipped_checkpoints(spec.app, spec.recipe) if ships else []


def find_in_file(path: Path, app: App, names: Sequence[str]) -> Entry | None:
    """Return the first entry of a file that comes from one of some trainings, for what the fits see; None if none does.

    An entry that states what fits see comes before one that serves several kinds of fits, or was written before
    entries stated it.
    """
    headers = read_headers(path)
    for name in names:
        for observed in (app.observes, None):
            for entry, header in headers.items():
                found = (header.get("app"), header.get("checkpoint"), header.get("observe"))
                if found == (app.name, name, observed):
                    return Entry(path, entry, header)
    return None


def _describe_other_checkpoint(spec: Spec, app: App, names: Sequence[str]) -> str:
    """Return the error message about a file that --checkpoint names and that has no entry for the fits."""
    assert spec.checkpoint
    headers = read_headers(spec.checkpoint).values()
    for header in headers:
        if header.get("app") == app.name and header.get("checkpoint") in names:
            observed = header.get("observe")
            return (
                f"{spec.checkpoint}: a checkpoint for --observe {observed}, expected one for {app.observes}; give "
                f"--observe {observed} or another checkpoint."
            )
    found_app = next((header.get("app") for header in headers), None)
    found_names = [str(header.get("checkpoint")) for header in headers]
    rule = next((name for name in found_names if name not in PARADIGMS), "")
    remedy = f"; add --rule {rule}" if found_app == app.name and rule and spec.rule else ""
    return (
        f"{spec.checkpoint}: a checkpoint of {found_app} {', '.join(found_names)}, expected {app.name} "
        f"{names[-1]}{remedy}."
    )


def checkpoint_digest(spec: Spec, app: App, recipe: Recipe) -> str:
    """Return 12 hexadecimal digits of the content of a specification's checkpoint; "" if the paradigm reads none."""
    entry = find_checkpoint(spec, app, recipe)
    return str(entry.header.get("digest", "")) if entry else ""


def describe_checkpoint(spec: Spec) -> str:
    """Return where the fits of a complete specification begin, in words."""
    if not spec.digest:
        return "a random initialisation"
    if spec.checkpoint:
        return str(spec.checkpoint)
    labels = (FILES_LABEL, MEMORY_FORMAT, *map(data_label, embedded_folders(spec.application)))
    note = "" if spec.data in labels else ", trained on other data, which may hold these tasks"
    return f"the checkpoint that ships{note}"


def has_shipped_general(spec: Spec, app: App) -> bool:
    """Return whether a General ships that the training of another checkpoint may begin at."""
    return any(find_in_file(path, app, [GENERAL]) for path in _shipped_files(spec))


def has_shipped_recipe(application: Application, recipe: str) -> bool:
    """Return whether checkpoints ship by which a recipe can fit.

    The recipe "full" needs none for itself where its application has the network of the recipe "quick".
    """
    has_checkpoints = recipe == QUICK_RECIPE_NAME or shipped_checkpoint_path(application.name, recipe).is_file()
    if has_checkpoints or recipe != FULL_RECIPE_NAME:
        return has_checkpoints
    recipes = application.recipes_observing()
    return bool(recipes[FULL_RECIPE_NAME].load().app == recipes[QUICK_RECIPE_NAME].load().app)


def usual_recipe(application: Application) -> str:
    """Return the recipe of a fit that names none: "full" (the best rule and size) if it ships, else "quick"."""
    has_full = FULL_RECIPE_NAME in application.recipes_observing()
    return FULL_RECIPE_NAME if has_full and has_shipped_recipe(application, FULL_RECIPE_NAME) else QUICK_RECIPE_NAME


def _check_conditions(entry: Entry, app: App, phi: MetaParameters) -> None:
    """Compare the conditions that a checkpoint was trained under with those of fits, such as features.

    A checkpoint without an encoder that was trained under other conditions gets a warning only.

    Args:
        entry: the entry of the checkpoint.
        app: the network of the fits.
        phi: the meta-parameters of the entry.

    Raises:
        ValueError: its encoder reads other features.
    """
    for key, condition in app.recorded_conditions().items():
        trained_condition = entry.header.get(key, condition)
        if trained_condition != condition and phi.encoder:
            raise ValueError(  # what is here comes first: a condition may say how to get what is missing
                f"{app.name}: {key} here: {condition}, expected {trained_condition}, which the encoder of {entry.path} "
                "reads; or give another checkpoint, or train one with --train."
            )
        if trained_condition != condition:
            place = f"{entry.name} of {entry.path.name}"
            say(f"warning: {place} was trained with {trained_condition}, but this run has {condition}.")


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
