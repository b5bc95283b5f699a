"""The training of a checkpoint on the training tasks of a data set, and its files, by which a cut-off one goes on.

How phi is learned is decided in `metapp.paradigms.training`; here are the options, the data, the ranks that train
together, progress, and the files that later runs read.
"""

from __future__ import annotations

import os
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Generator, get_num_threads

from metapp.learning.app import App, stack_tasks
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.learning.task import Tasks
from metapp.options import BadOption
from metapp.paradigms import ranks
from metapp.paradigms.training import TrainState, train_phi
from metapp.paradigms.trainings import Training, trainings_of
from metapp.runs.checkpoints import GENERAL, find_in_file, has_shipped_general, read_checkpoint
from metapp.runs.environment import make_folder, software_versions
from metapp.runs.inputs.finding import data_label, training_data_folder
from metapp.runs.reporter import progress, say
from metapp.runs.resolve import app_of, recipe_of
from metapp.runs.spec import RunOptions, Spec
from metapp.storage import Document
from metapp.storage.checkpoint_files import (
    load_training_state,
    read_headers,
    save_training_state,
    tensor_digest,
    write_entry,
)
from metapp.storage.files import content_digest, remove_partial
from metapp.storage.shards import fingerprint, read_data_set

SAVE_INTERVAL_SECONDS = 60.0  # between two training checkpoints, unless METAPP_CHECKPOINT_SECONDS says another time


def train(spec: Spec, options: RunOptions) -> Path:
    """Train the checkpoint that fits need, together with the other ranks if there are any; these end after training.

    Args:
        spec: the specification of the fits, complete but for the digest of the checkpoint.
        options: the options of the command.

    Returns:
        The file, which has the checkpoint as one of its entries. If it had it before, the file is kept as it was as
        `<file>.<entry>.previous.safetensors`.

    Raises:
        BadOption: there is nothing to train.
        ValueError: --checkpoint names neither a General that this training begins at nor a checkpoint of its own kind.
        FloatingPointError: training is not finite.
    """
    with ranks.connect_ranks(torch.device(spec.device)):
        return _train(_Plan.of(spec, options))


class _Plan(NamedTuple):
    """What is trained.

    Attributes:
        spec: the specification of fits that need the checkpoint.
        options: the options of the command.
        app: the network of the fits.
        recipe: the settings.
        training: the training of the last checkpoint that the fits need.
        data: the folder of the training tasks.
        path: the file of the checkpoint, named by the data, the recipe and the seed.
    """

    spec: Spec
    options: RunOptions
    app: App
    recipe: Recipe
    training: Training
    data: Path
    path: Path

    @classmethod
    def of(cls, spec: Spec, options: RunOptions) -> _Plan:
        """Plan the training of the checkpoint that a specification needs.

        Raises:
            BadOption: there is nothing to train.
        """
        recipe, app = recipe_of(spec), app_of(spec)
        trainings = trainings_of(spec.paradigm, app, recipe, spec.rule)
        if not trainings:
            raise BadOption(f"--train: {spec.paradigm} needs no preparation; leave the option out.")
        data = training_data_folder(spec.application, options.data, options.quiet)
        name = f"{data_label(data)}-{spec.recipe}-seed{spec.seed}.safetensors"
        path = options.out / app.name / "checkpoints" / name
        return cls(spec, options, app, recipe, trainings[-1], data, path)

    @property
    def observation(self) -> dict[str, str]:
        """The entry `observe` of the checkpoint's description; {} if fits of all kinds can begin at it.

        General learns nothing of what fits see. It serves fits of all kinds if a recipe of the default has an equal
        network.
        """
        app, application = self.app, self.spec.application
        default_apps = [entry.load().app for entry in application.recipes_observing().values()]
        is_default = app.observes == application.default_observation
        has_default_network = is_default or any(
            app.encoder_settings == other.encoder_settings for other in default_apps
        )
        return {} if self.training.shared_by_observations and has_default_network else app.observation

    @property
    def entry(self) -> str:
        """The name of the checkpoint's entry, such as "general" or "meta-encoder-photo" for fits that see a photo.

        It does not state the application's default.
        """
        observed = self.observation.get("observe", self.spec.application.default_observation)
        is_default = observed == self.spec.application.default_observation
        return self.training.name if is_default else f"{self.training.name}-{observed}"

    def path_of(self, kind: str) -> Path:
        """Return the place of a further file of the training, such as "previous" or "interrupted"."""
        return self.path.with_suffix(f".{self.entry}.{kind}.safetensors")

    def settings(self, general: MetaParameters | None = None, first: str = "") -> Document:
        """Return all that the result of the training depends on, except for rounding: the header of its checkpoint.

        Args:
            general: the General that training begins at; None for none.
            first: the digest of the checkpoint that training goes on from; "" for none.
        """
        return (
            {"app": self.app.name, "checkpoint": self.training.name}
            | {"data": data_label(self.data), "content": fingerprint(self.data)}
            | {"recipe": self.spec.recipe, "recipe_digest": content_digest(repr(self.recipe)), "seed": self.spec.seed}
            | {"steps": self.options.train_steps, "versions": software_versions()}
            | self.observation
            | self.app.recorded_conditions(torch.device(self.spec.device))
            | ({"encoder": tensor_digest(general.encoder)} if general else {})
            | ({"first": first} if first else {})
        )


def _train(plan: _Plan) -> Path:
    """Train a checkpoint, and return its file; see :func:`train`."""
    spec, options, training, path, steps = plan.spec, plan.options, plan.training, plan.path, plan.options.train_steps
    make_folder(options.out)
    make_folder(path.parent)
    if path.is_file():
        read_headers(path)  # a damaged file is refused before anything is trained
    first, first_digest = _read_first_checkpoint(plan)
    general = _provide_general(plan) if not first and training.begins_at_general else None
    tasks = _read_training_tasks(plan)
    header = plan.settings(general, first_digest)
    outer_loop = training.outer_loop
    if outer_loop.steps and steps:
        outer_loop = replace(outer_loop, steps=steps)
    description = {"inner_steps": plan.recipe.steps, "batch": plan.recipe.samples, "training": asdict(outer_loop)}
    # rounding depends on device and threads, so that a training goes on only where these are equal
    settings = header | {"device": spec.device, "threads": get_num_threads()}

    @ranks.on_rank_zero
    def keep_state(state: TrainState) -> None:
        save_training_state(plan.path_of("training"), state._asdict(), settings)

    @ranks.on_rank_zero
    def write(state: TrainState, file: Path, previous: Path | None = None) -> None:
        result = {"validation_error": state.validation, "best_step": state.best_step, "curve": state.curve}
        write_entry(file, plan.entry, state.phi, header | description | result, previous)

    interval_seconds, save_time = _save_interval_seconds(), time.monotonic()
    with ranks.rank_zero_first():  # which puts a damaged file aside
        state = since = _read_interrupted_state(plan, settings)
    with progress(f"train {training.name}", long=True, quiet=options.quiet) as bar:
        rng = Generator(spec.device).manual_seed(spec.seed)
        try:
            for state in train_phi(training, tasks, rng, general=general, first=first, steps=steps, since=since):
                if time.monotonic() - save_time >= interval_seconds:
                    keep_state(state)
                    save_time = time.monotonic()
                if state.note:
                    bar.set_done(state.step, state.total, state.note)
        except (KeyboardInterrupt, ConnectionError) as error:
            if state:
                keep_state(state)
            if isinstance(error, KeyboardInterrupt) and state and state.curve:
                interrupted_path = plan.path_of("interrupted")
                write(state, interrupted_path)
                say(f"validation error {state.validation:.3f}; to use it as it is: --checkpoint {interrupted_path}")
            raise
    assert state is not None
    with ranks.rank_zero_first():  # all ranks go on from the file
        write(state, path, plan.path_of("previous"))
        plan.path_of("training").unlink(missing_ok=True)
    result = f"validation error {state.validation:.3f} at step {state.best_step}"
    say(f"{training.name}: {result}; kept as {plan.entry} in {path}, which fits and tables take by --checkpoint")
    return path


def _read_interrupted_state(plan: _Plan, settings: Document) -> TrainState | None:
    """Return the state of a training of equal settings that was cut off; None if there is none.

    Args:
        plan: what is trained.
        settings: all that the training depends on.
    """
    path = plan.path_of("training")
    remove_partial(path.parent)
    state = None
    try:
        if fields := load_training_state(path, settings, plan.spec.device):
            state = TrainState(**fields)
            step = f"step {state.step:,} of {state.total:,}" if state.moments else f"{state.step} Adams of the search"
            say(f"going on from {step} (training checkpoint {path})")
    except ValueError as error:
        say(f"{error}; training from the beginning")
    return state


def _save_interval_seconds() -> float:
    """Return the time between two training checkpoints, in seconds: METAPP_CHECKPOINT_SECONDS if that is set."""
    text = os.environ.get("METAPP_CHECKPOINT_SECONDS", "")
    try:
        return float(text) if text else SAVE_INTERVAL_SECONDS
    except ValueError:
        raise ValueError(f"METAPP_CHECKPOINT_SECONDS: '{text}', expected a number of seconds.") from None


def _read_training_tasks(plan: _Plan) -> Tasks:
    """Read the training tasks of the data set, and say how many there are."""
    app = plan.app
    tasks = stack_tasks(app, read_data_set(plan.data, "train", app.name, app.tensors), plan.spec.device)
    data = f"{len(tasks)} tasks of {plan.data.name}, every eighth for validation"
    say(f"training {app.full_name} {plan.training.name} on {data}")
    return tasks


def _read_first_checkpoint(plan: _Plan) -> tuple[MetaParameters | None, str]:
    """Read the checkpoint of its own kind that a training goes on from.

    Returns:
        The checkpoint and its digest; None and "" if --checkpoint is not set, or names a file that has no such
        checkpoint, but a General for the training to begin at.
    """
    spec, app, training = plan.spec, plan.app, plan.training
    if not spec.checkpoint:
        return None, ""
    own, general = (find_in_file(spec.checkpoint, app, [name]) for name in (training.name, GENERAL))
    if training.begins_at_general and general and (training.takes_encoder_from_general or not own):
        return None, ""
    if training.takes_encoder_from_general:
        raise ValueError(
            f"{spec.checkpoint}: expected the General that an Adam is searched for; name its file, or leave it out."
        )
    phi = read_checkpoint(spec, app, plan.recipe)
    assert own
    say(f"going on from {spec.checkpoint}")
    return phi, str(own.header.get("digest", ""))


def _provide_general(plan: _Plan) -> MetaParameters:
    """Return the General that a training begins at, trained first if there is none.

    It is the one that --checkpoint names, else the one that ships, else one that is trained now for as many steps as
    this training takes. A finished training of equal settings is not repeated. A shipped General is not taken for a
    data set of the user's: it may have seen its test tasks.

    Raises:
        ValueError: a General of other settings is in the way; it is not replaced.
    """
    spec = replace(plan.spec, paradigm=GENERAL)
    ships = not plan.options.data and has_shipped_general(spec, plan.app)
    if not spec.checkpoint and not ships:
        general_plan = plan._replace(spec=spec, training=trainings_of(GENERAL, plan.app, plan.recipe)[0])
        path, steps = plan.path, plan.options.train_steps
        header = read_headers(path).get(general_plan.entry) if path.is_file() else None
        if header is None:
            say(f"no General ships for this data: training it first{f', {steps} steps' if steps else ''}.")
            _train(general_plan)
        elif not general_plan.settings().items() <= header.items():
            raise ValueError(
                f"{path}: has a General that was trained by other settings; begin at it with --checkpoint {path}, or "
                "move the file to train another one."
            )
        spec = replace(spec, checkpoint=path)
    phi = read_checkpoint(spec, plan.app, plan.recipe)
    say(f"General: {spec.checkpoint or 'the checkpoint that ships'}")
    return phi
