"""Checkpoints: the one that is named, else the one that ships, and checks of its tensors."""

from __future__ import annotations

import shlex
from dataclasses import fields, replace
from pathlib import Path

from metapp.apps import full_name, is_first_protocol, recipes_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.rules.network import is_periodic
from metapp.learning.task import Params
from metapp.networks.field import regrid
from metapp.paradigms import PARADIGMS
from metapp.paradigms.adam import QUICKFT_ADAM_SETTINGS
from metapp.paradigms.paradigm import Preparation
from metapp.runs.default_recipe import has_shipped_recipe
from metapp.runs.inputs.run_inputs import data_label, training_data_folder
from metapp.runs.reporter import say
from metapp.runs.run import Checkpoint, Run
from metapp.storage import Document
from metapp.storage.checkpoint_files import content_digest, load_checkpoint, tensor_digest
from metapp.storage.folders import PathKind, path_kind, path_refusal
from metapp.storage.shipped_checkpoints import QUICK_RECIPE_NAME, shipped_checkpoint_path


def attach_checkpoint(run: Run) -> Run:
    """The run with the checkpoint that --checkpoint names, a file or a folder of these, else with the one that ships.

    Raises:
        ValueError: there is none, or it is another application's, paradigm's, protocol's or network's.
    """
    preparations = run.paradigm.preparations
    if not preparations:
        return replace(run, checkpoint=Checkpoint(MetaParameters(), "a random initialisation", ""))
    needed, *tunings = preparations
    path, options = _checkpoint_path(run, needed), run.options
    phi, header = load_checkpoint(path, run.device, _shipped(run, needed.general))
    _require_kind(path, run, needed, phi, header)
    template = needed.template(phi)
    phi = resample_alpha_grids(run.app, phi, template.alpha)
    try:
        require_matching_tensors(path, phi, template)
    except ValueError as error:
        if (
            path.parent == shipped_checkpoint_path(run.app.name, needed.name).parent
            and options.recipe != QUICK_RECIPE_NAME
        ):
            raise ValueError(
                f"{str(error).removesuffix('.')}; this one ships for --recipe {QUICK_RECIPE_NAME}."
            ) from None
        raise
    source = str(path)
    if not options.checkpoint:
        note = ", trained on other data, which may hold these tasks" if options.data else ""
        source = f"the checkpoint that ships{note}"
    checkpoint = Checkpoint(phi, source, content_digest(path))
    for tuning in tunings:
        checkpoint = _with_tuning(run, checkpoint, tuning)
    return replace(run, checkpoint=checkpoint)


def trained_checkpoint_path(run: Run, preparation: Preparation) -> Path:
    """Return the path of a checkpoint that is trained on this data."""
    label = data_label(training_data_folder(run.app, run.options.data, run.options.quiet))
    folder = run.options.out / run.app.name / "checkpoints" / f"{label}-{run.options.recipe}-seed{run.options.seed}"
    return folder / f"{checkpoint_name(run.app, preparation)}.safetensors"


def checkpoint_name(app: App, preparation: Preparation) -> str:
    """Return a checkpoint's file name without its suffix: with the protocol, unless it is the first.

    General's is without it, too, if the network is one of the first protocol's: it learns nothing of the protocol.
    """
    name = preparation.name
    if is_first_protocol(app):
        return name
    others = (recipe.app for recipe in recipes_of(app.name).values())
    shared = preparation.shared_by_protocols and any(_sizes(app) == _sizes(other) for other in others)
    return name if shared else f"{name}-{app.protocol}"


def _sizes(app: App) -> tuple[object, ...]:
    """Return the kind of an application's network and all its fields but the protocol."""
    return type(app.network), *(getattr(app, field.name) for field in fields(app) if field.name != "protocol")


def has_shipped_checkpoint(run: Run, preparation: Preparation) -> bool:
    """Return whether a checkpoint ships that training may begin at.

    On a data set of the user's own none may: the shipped one may have seen its test tasks.
    """
    return not run.options.data and _ships(run) and _shipped(run, preparation).is_file()


def _require_kind(path: Path, run: Run, needed: Preparation, phi: MetaParameters, header: Document) -> None:
    """Refuse a checkpoint of another application, paradigm, rule or protocol, and one whose encoder reads other things.

    General's, which all protocols share, names none. Other features, which no encoder reads, are said.
    """
    app, of, name = run.app, header.get("app"), header.get("checkpoint")
    if (of, name) != (app.name, needed.name):
        a_rule = isinstance(name, str) and name not in PARADIGMS
        remedy = f"; add --rule {name}" if of == app.name and a_rule and run.paradigm.has_learned_rule else ""
        raise ValueError(f"{path}: a checkpoint of {of} {name}, expected {app.name} {needed.name}{remedy}.")
    protocol = header.get("observe", app.protocol)
    if protocol != app.protocol:
        raise ValueError(
            f"{path}: a checkpoint for --observe {protocol}, expected one for {app.protocol}; give --observe "
            f"{protocol} or another checkpoint."
        )
    for key, now in app.conditions().items():
        then = header.get(key, now)
        if then != now and phi.encoder:
            raise ValueError(f"{path}: its encoder reads {then}; here: {now}; or train one with --train.")
        if then != now:
            say(f"warning: {path.name} was trained with {then}; here: {now}.")


def _with_tuning(run: Run, checkpoint: Checkpoint, tuning: Preparation) -> Checkpoint:
    """Put the Adam that was tuned for this very encoder into its checkpoint: one beside that, or the one that ships."""
    options, app = run.options, run.app
    encoder = tensor_digest(checkpoint.phi.encoder)
    candidates = [_shipped(run, tuning)]
    if options.checkpoint:
        folder = options.checkpoint if options.checkpoint.is_dir() else options.checkpoint.parent
        candidates.insert(0, folder / f"{checkpoint_name(app, tuning)}.safetensors")
    for path in candidates:
        if path.is_file():
            tuned, info = load_checkpoint(path)
            if info.get("encoder") == encoder:
                require_tuned_adam(path, tuned)
                return merge_tuned_adam(checkpoint, tuned, path)
    words = ["metapp", tuning.name, app.name, "--train"]
    words += ["--observe", app.protocol] if app.protocol else []
    remedy = shlex.join(words + (["--data", str(options.data)] if options.data else []))
    say(f"{tuning.name}: no Adam was tuned for this encoder, the recipe's is used; {remedy}")
    return checkpoint


def merge_tuned_adam(general: Checkpoint, tuned: MetaParameters, path: Path) -> Checkpoint:
    """General's checkpoint with an Adam that was tuned for it."""
    return Checkpoint(general.phi._replace(alpha=tuned.alpha), f"{general.source}, tuned Adam", content_digest(path))


def _checkpoint_path(run: Run, needed: Preparation) -> Path:
    given = run.options.checkpoint
    if given and given.is_dir():
        path = given / f"{checkpoint_name(run.app, needed)}.safetensors"
        if not path.is_file():
            if path_kind(given) is not PathKind.FILES:
                raise ValueError(path_refusal(given, f"a folder of checkpoints with {path.name}"))
            held = ", ".join(sorted(file.stem for file in given.glob("*.safetensors"))) or "no checkpoints"
            raise ValueError(
                f"{given}: holds {held}, expected {path.name}; train it with --train, or name another one."
            )
        return path
    if given:
        return given
    path = _shipped(run, needed)
    if path.is_file() and _ships(run):
        return path
    raise ValueError(
        f"{full_name(run.app)} {needed.name}, recipe {run.options.recipe}: no checkpoint ships; train one with "
        "--train, or name one with --checkpoint."
    )


def _ships(run: Run) -> bool:
    return has_shipped_recipe(run.app.name, run.options.recipe)


def _shipped(run: Run, preparation: Preparation) -> Path:
    return shipped_checkpoint_path(run.app.name, checkpoint_name(run.app, preparation), run.options.recipe)


def resample_alpha_grids(app: App, phi: MetaParameters, fresh: Params) -> MetaParameters:
    """Return phi whose hyperparameters on a grid, [K, channels, rows, columns], are on the application's own grid.

    They may have been learned on a coarser one, by another recipe of the same network.

    Args:
        app: the application.
        phi: as its file holds it.
        fresh: untrained hyperparameters, on the application's grid.
    """
    alpha = dict(phi.alpha)
    for key, wanted in fresh.items():
        value = alpha.get(key, wanted)
        if value.ndim == wanted.ndim == 4 and value.shape[1] == wanted.shape[1] and min(value.shape) > 0:
            alpha[key] = regrid(value, *wanted.shape[2:], periodic=is_periodic(app))
    return phi._replace(alpha={key: alpha[key] for key in phi.alpha})


def require_matching_tensors(path: Path, phi: MetaParameters, template: MetaParameters) -> None:
    """Refuse tensors that are not this application's, or not this rule's.

    Args:
        path: of the checkpoint.
        phi: as its file holds it.
        template: untrained parameters of the names and shapes that fits read.

    Raises:
        ValueError: a tensor is missing or has another shape; names it.
    """
    _require(path, "alpha", phi.alpha, template.alpha, steps=True)
    if template.theta:
        _require(path, "theta", phi.theta, template.theta)
    else:
        _require(path, "encoder", phi.encoder, template.encoder)


def require_tuned_adam(path: Path, prepared: MetaParameters) -> None:
    """Refuse other hyperparameters than the settings of one Adam.

    Raises:
        ValueError: one is missing, or no number.
    """
    if set(prepared.alpha) != set(QUICKFT_ADAM_SETTINGS) or any(
        value.numel() != 1 for value in prepared.alpha.values()
    ):
        raise ValueError(
            f"{path}: holds {', '.join(sorted(prepared.alpha)) or 'no settings'}, expected one number each for "
            f"{', '.join(QUICKFT_ADAM_SETTINGS)}; tune again with metapp quickft APP --train."
        )


def _require(path: Path, part: str, held: Params, expected: Params, *, steps: bool = False) -> None:
    """Refuse a part of a checkpoint that lacks a tensor or has another; `steps`: the first axis may have any length."""

    def shape_of(params: Params, key: str) -> str:
        if key not in params:
            return "missing"
        sizes = list(map(str, params[key].shape))
        sizes[:1] = ["steps"] if steps and sizes and key in held and key in expected else sizes[:1]
        return f"({', '.join(sizes)})"

    for key in sorted(expected | held, key=lambda key: key not in expected):
        found, wanted = shape_of(held, key), shape_of(expected, key)
        if found != wanted:
            remedy = "give a checkpoint of this application, rule and recipe, or train one with --train"
            raise ValueError(f"{path}: {part} {key} is {found}, expected {wanted}; {remedy}.")
