"""Checkpoints: the one that is named, else the one that ships, and checks of its tensors."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

from torch import Generator, Tensor

from metapp.apps import is_first_protocol, recipes_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.networks.field import regridded
from metapp.paradigms import PARADIGMS
from metapp.paradigms.adam import TUNED
from metapp.rules import rule_of
from metapp.runs.inputs.sources import data_folder, data_label
from metapp.runs.recipes import QUICK, shipped_path, ships
from metapp.runs.reporter import say
from metapp.runs.run import Checkpoint, Run
from metapp.storage import Document
from metapp.storage.checkpoints import digest, load_checkpoint, tensor_digest

FOLDER = "checkpoints"  # of what was trained for an application


def with_checkpoint(run: Run) -> Run:
    """The run with the checkpoint that --checkpoint names, a file or a folder of these, else with the one that ships.

    Raises:
        ValueError: there is none, or it is another application's, paradigm's, protocol's or network's.
    """
    needs = run.paradigm.needs
    if not needs:
        return replace(run, checkpoint=Checkpoint(MetaParameters(), "a random initialisation", ""))
    needed, *tuned = needs
    path = _checkpoint_path(run, needed)
    prepared, info = load_checkpoint(path, run.device, _shipped(run, "general"))
    app, name = info.get("app"), info.get("checkpoint")
    if (app, name) != (run.app.name, needed):
        a_rule = isinstance(name, str) and name not in PARADIGMS
        other = app == run.app.name and a_rule and run.paradigm.name == "meta"
        remedy = f"; add --rule {name}" if other else ""
        raise ValueError(f"{path}: a checkpoint of {app} {name}, expected {run.app.name} {needed}{remedy}.")
    _require_protocol(path, run.app, info)
    _require_conditions(path, run.app, prepared, info)
    prepared = on_own_grid(run, prepared)
    try:
        require_fit(path, run, prepared)
    except ValueError as error:
        if path.parent == shipped_path(run.app.name, needed).parent and run.options.recipe != QUICK:
            raise ValueError(f"{str(error).removesuffix('.')}; this one ships for --recipe {QUICK}.") from None
        raise
    checkpoint = Checkpoint(prepared, str(path), digest(path))
    if not run.options.checkpoint:
        note = ", trained on other data, which may hold these tasks" if run.options.data else ""
        checkpoint = checkpoint._replace(source=f"the checkpoint that ships{note}")
    for name in tuned:
        checkpoint = _with_tuning(run, checkpoint, name)
    return replace(run, checkpoint=checkpoint)


def trained_path(run: Run, name: str) -> Path:
    """The path of a checkpoint that is trained on this data."""
    label = data_label(data_folder(run.app, run.options.data, run.options.quiet))
    training = f"{label}-{run.options.recipe}-seed{run.options.seed}"
    return _of_app(run) / FOLDER / training / f"{checkpoint_name(run.app, name)}.safetensors"


def checkpoint_name(app: App, name: str) -> str:
    """A checkpoint's file name without its suffix: with the protocol, unless it is the first.

    General's is without it, too, if the network is one of the first protocol's: it learns nothing of the protocol.
    """
    if is_first_protocol(app):
        return name
    plain = replace(app, protocol="", size=None)
    shared = name == "general" and any(plain == recipe.app for recipe in recipes_of(app.name).values())
    return name if shared else f"{name}-{app.protocol}"


def ships_general(run: Run) -> bool:
    """True if a General ships that training may begin at.

    On a data set of the user's own none may: the shipped one may have seen its test tasks.
    """
    return not run.options.data and _has_shipped(run) and _shipped(run, "general").is_file()


def _of_app(run: Run) -> Path:
    """The folder of all runs of an application."""
    return run.options.out / run.app.name


def _require_protocol(path: Path, app: App, info: Document) -> None:
    """Refuse a checkpoint that was trained under another protocol; General's, which all share, names none."""
    then = info.get("observe", app.protocol)
    if then != app.protocol:
        raise ValueError(
            f"{path}: a checkpoint for --observe {then}, expected one for {app.protocol}; give --observe {then} or "
            "another checkpoint."
        )


def _require_conditions(path: Path, app: App, prepared: MetaParameters, info: Document) -> None:
    """Say that a checkpoint was trained with other features than are at hand; refuse one whose encoder reads them."""
    for key, now in app.conditions().items():
        then = info.get(key, now)
        if then != now and prepared.encoder:
            raise ValueError(f"{path}: its encoder reads {then}; here: {now}; or train one with --train.")
        if then != now:
            say(f"warning: {path.name} was trained with {then}; here: {now}.")


def _with_tuning(run: Run, checkpoint: Checkpoint, name: str) -> Checkpoint:
    """Put the Adam that was tuned for this very encoder into its checkpoint: one beside that, or the one that ships."""
    options, app = run.options, run.app
    encoder = tensor_digest(checkpoint.phi.encoder)
    candidates = [_shipped(run, name)]
    if options.checkpoint:
        folder = options.checkpoint if options.checkpoint.is_dir() else options.checkpoint.parent
        candidates.insert(0, folder / f"{checkpoint_name(app, name)}.safetensors")
    for path in candidates:
        if path.is_file():
            tuned, info = load_checkpoint(path)
            if info.get("encoder") == encoder:
                require_tuned(path, tuned)
                return tuned_by(checkpoint, tuned, path)
    words = ["metapp", name, app.name, "--train"]
    words += ["--observe", app.protocol] if app.protocol else []
    remedy = shlex.join(words + (["--data", str(options.data)] if options.data else []))
    say(f"{name}: no Adam was tuned for this encoder, the recipe's is used; {remedy}")
    return checkpoint


def tuned_by(general: Checkpoint, tuned: MetaParameters, path: Path) -> Checkpoint:
    """General's checkpoint with an Adam that was tuned for it."""
    return Checkpoint(general.phi._replace(alpha=tuned.alpha), f"{general.source}, tuned Adam", digest(path))


def _checkpoint_path(run: Run, name: str) -> Path:
    given = run.options.checkpoint
    if given and given.is_dir():
        path = given / f"{checkpoint_name(run.app, name)}.safetensors"
        if not path.is_file():
            held = ", ".join(sorted(file.stem for file in given.glob("*.safetensors"))) or "no checkpoints"
            raise ValueError(
                f"{given}: holds {held}, expected {path.name}; train it with --train, or name another one."
            )
        return path
    if given:
        return given
    path = _shipped(run, name)
    if path.is_file() and _has_shipped(run):
        return path
    raise ValueError(
        f"{run.app.full_name} {name}, recipe {run.options.recipe}: no checkpoint ships; train one with --train, or "
        "name one with --checkpoint."
    )


def _has_shipped(run: Run) -> bool:
    return ships(run.app.name, run.options.recipe, run.options.observe)


def _shipped(run: Run, name: str) -> Path:
    return shipped_path(run.app.name, checkpoint_name(run.app, name), run.options.recipe, run.options.observe)


def on_own_grid(run: Run, prepared: MetaParameters) -> MetaParameters:
    """A checkpoint of Meta whose hyperparameters on a grid, [K, channels, rows, columns], are on the application's own.

    They may have been learned on a coarser one: those of another recipe of the same network.
    """
    if run.paradigm.name != "meta":
        return prepared
    wanted = _fresh_alpha(run)
    alpha = {
        key: regridded(value, *wanted[key].shape[2:], periodic=run.app.periodic)
        if key in wanted and _is_on_a_grid(value, wanted[key])
        else value
        for key, value in prepared.alpha.items()
    }
    return prepared._replace(alpha=alpha)


def _is_on_a_grid(value: Tensor, wanted: Tensor) -> bool:
    return value.ndim == wanted.ndim == 4 and value.shape[1] == wanted.shape[1] and min(value.shape) > 0


def _fresh_alpha(run: Run) -> Params:
    """The rule's hyperparameters before training, of the shapes that a checkpoint's must have."""
    recipe = run.recipe
    network = {key: value[0] for key, value in run.app.init(Generator().manual_seed(0), 1).items()}
    first = recipe.training(run.paradigm.rule_name).first
    return rule_of(run.paradigm.rule_name).alpha(run.app, network, recipe.steps, first)


def require_fit(path: Path, run: Run, prepared: MetaParameters) -> None:
    """Refuse tensors that are not this application's, or not this rule's.

    Raises:
        ValueError: a tensor is missing or has another shape; names it.
    """
    app, rng = run.app, Generator().manual_seed(0)
    network = {key: value[0] for key, value in app.init(rng, 1).items()}
    if run.paradigm.name == "meta":
        _require(path, "alpha", prepared.alpha, _fresh_alpha(run), steps=True)
    else:
        _require(path, "alpha", prepared.alpha, {})
    if prepared.encoder or run.paradigm.name != "meta":
        _require(path, "encoder", prepared.encoder, app.init_encoder(rng))
    else:
        _require(path, "theta", prepared.theta, network)


def require_tuned(path: Path, prepared: MetaParameters) -> None:
    """Refuse other hyperparameters than the settings of one Adam.

    Raises:
        ValueError: one is missing, or no number.
    """
    if set(prepared.alpha) != set(TUNED) or any(value.numel() != 1 for value in prepared.alpha.values()):
        raise ValueError(
            f"{path}: holds {', '.join(sorted(prepared.alpha)) or 'no settings'}, expected one number each for "
            f"{', '.join(TUNED)}; tune again with metapp quickft APP --train."
        )


def _require(path: Path, part: str, held: Params, expected: Params, *, steps: bool = False) -> None:
    """Refuse a part of a checkpoint that lacks a tensor or has another; `steps`: the first axis may have any length."""
    remedy = "give a checkpoint of this application, rule and recipe, or train one with --train"
    for key in sorted(expected | held, key=lambda key: key not in expected):
        shapes: list[tuple[int | str, ...] | None] = [
            tuple(of[key].shape) if key in of else None for of in (held, expected)
        ]
        if steps and all(shapes):
            shapes = [shape and ("steps", *shape[1:]) for shape in shapes]
        if shapes[0] != shapes[1]:
            has, wants = (_shape_text(shape) for shape in shapes)
            raise ValueError(f"{path}: {part} {key} is {has}, expected {wants}; {remedy}.")


def _shape_text(shape: tuple[int | str, ...] | None) -> str:
    return "missing" if shape is None else f"({', '.join(map(str, shape))})"
