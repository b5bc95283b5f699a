"""The training of a checkpoint on the training tasks of a data set, and its files, by which a cut-off one goes on.

How phi is learned is decided in `metapp.paradigms.training`; here are the options, the data, the ranks that train
together, progress, and the files that later runs read.
"""

from __future__ import annotations

import os
import time
from dataclasses import asdict, replace
from pathlib import Path

from torch import Generator, get_num_threads

from metapp.learning.app import stack_tasks
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Tasks
from metapp.options import BadOption
from metapp.paradigms import ranks
from metapp.paradigms.paradigm import CheckpointTraining
from metapp.paradigms.training import TrainState, train_phi
from metapp.runs.checkpoint_selection import (
    Checkpoint,
    find_checkpoint,
    has_shipped_checkpoint,
    merge_tuned_adam,
    trained_checkpoint_path,
)
from metapp.runs.choice import Choice
from metapp.runs.environment import make_folder, software_versions
from metapp.runs.inputs.run_inputs import data_label, training_data_folder
from metapp.runs.reporter import progress, say
from metapp.storage import Document
from metapp.storage.checkpoint_files import (
    load_checkpoint,
    load_training_state,
    save_checkpoint,
    save_training_state,
    tensor_digest,
)
from metapp.storage.files import content_digest, remove_partial
from metapp.storage.shards import fingerprint, read_data_set

SAVE_INTERVAL_SECONDS = 60.0  # between two training checkpoints, unless METAPP_CHECKPOINT_SECONDS says another time


def train_and_load(choice: Choice) -> Checkpoint:
    """Train the checkpoint that fits need, and read it; ranks but the first end after training."""
    with ranks.connect_ranks(choice.device):
        path, general = train_checkpoint(choice)
    # the trained file holds no encoder, and its General may be the one that ships, which lies in another folder
    if general and choice.paradigm.trainings[-1].takes_encoder_from_general:
        return merge_tuned_adam(general, load_checkpoint(path)[0], path)
    trained = replace(choice, options=replace(choice.options, checkpoint=path))
    return find_checkpoint(trained)


def train_checkpoint(choice: Choice) -> tuple[Path, Checkpoint | None]:
    """Train the checkpoint that the paradigm needs, together with the other ranks if there are any.

    Returns:
        The file of the checkpoint, and the General that training began at, None if it began at none. A checkpoint that
        is replaced is kept as `<name>.previous.safetensors`.

    Raises:
        BadOption: there is nothing to train, or --checkpoint names a folder.
        ValueError: --checkpoint names neither a General that this training begins at nor a checkpoint of its own kind.
    """
    training, options, steps = _last_training(choice), choice.options, choice.options.train_steps
    path = trained_checkpoint_path(choice, training)
    make_folder(options.out)
    make_folder(path.parent)
    first = _read_first_checkpoint(choice, training)
    general = _provide_general(choice, training) if not first and training.begins_at_general else None
    general_phi = general.phi if general else None
    tasks = _read_training_tasks(choice, training)
    header = _training_settings(choice, training, general_phi, first)
    outer_loop = training.outer_loop
    if outer_loop.steps and steps:
        outer_loop = replace(outer_loop, steps=steps)
    description = {"inner_steps": choice.recipe.steps, "batch": choice.recipe.samples, "training": asdict(outer_loop)}
    # rounding depends on device and threads, so that a training goes on only where these are equal
    settings = header | {"device": str(choice.device), "threads": get_num_threads()}

    @ranks.on_rank_zero
    def keep_state(state: TrainState) -> None:
        save_training_state(_training_path(path), state._asdict(), settings)

    @ranks.on_rank_zero
    def write(state: TrainState, file: Path, previous: Path | None = None) -> None:
        # QuickFT's file holds no encoder: the file of General has the one that QuickFT was tuned for
        phi = state.phi._replace(encoder={}) if training.takes_encoder_from_general else state.phi
        result = {"validation_error": state.validation, "best_step": state.best_step, "curve": state.curve}
        save_checkpoint(file, phi, header | description | result, previous)

    interval_seconds, save_time = _save_interval_seconds(), time.monotonic()
    with ranks.rank_zero_first():  # which puts a damaged file aside
        state = since = _read_interrupted_state(path, settings, choice)
    with progress(f"train {training.name}", long=True, quiet=options.quiet) as bar:
        rng, phi = Generator(choice.device).manual_seed(options.seed), first and first.phi
        try:
            for state in train_phi(training, tasks, rng, general=general_phi, first=phi, steps=steps, since=since):
                if time.monotonic() - save_time >= interval_seconds:
                    keep_state(state)
                    save_time = time.monotonic()
                if state.note:
                    bar.set_done(state.step, state.total, state.note)
        except (KeyboardInterrupt, ConnectionError) as error:
            if state:
                keep_state(state)
            if isinstance(error, KeyboardInterrupt) and state and state.curve:
                interrupted_path = path.with_suffix(".interrupted.safetensors")
                write(state, interrupted_path)
                say(f"validation error {state.validation:.3f}; to use it as it is: --checkpoint {interrupted_path}")
            raise
    assert state is not None
    with ranks.rank_zero_first():  # all ranks go on from the file
        write(state, path, _previous_path(path))
        _training_path(path).unlink(missing_ok=True)
    result = f"validation error {state.validation:.3f} at step {state.best_step}"
    say(f"{training.name}: {result}; kept as {path}, which fits and tables use with --checkpoint {path.parent}")
    return path, general


def _read_interrupted_state(path: Path, settings: Document, choice: Choice) -> TrainState | None:
    """Return the state of a training of equal settings that was cut off; None if there is none.

    Args:
        path: the file of the finished checkpoint.
        settings: all that the training depends on.
        choice: the choice of what is trained.
    """
    remove_partial(path.parent)
    state = None
    try:
        if fields := load_training_state(_training_path(path), settings, choice.device):
            state = TrainState(**fields)
            step = f"step {state.step:,} of {state.total:,}" if state.moments else f"{state.step} Adams of the search"
            say(f"going on from {step} (training checkpoint {_training_path(path)})")
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


def _training_path(path: Path) -> Path:
    """Return the file that holds the state of a checkpoint's training while it runs."""
    return path.with_suffix(".training.safetensors")


def _read_training_tasks(choice: Choice, training: CheckpointTraining) -> Tasks:
    """Read the training tasks of the data set, and say how many there are."""
    app, folder = choice.app, training_data_folder(choice.application, choice.options.data, choice.options.quiet)
    tasks = stack_tasks(app, read_data_set(folder, "train", app.name, app.tensors), choice.device)
    data = f"{len(tasks)} tasks of {folder.name}, every eighth for validation"
    say(f"training {app.full_name} {training.name} on {data}")
    return tasks


def _read_first_checkpoint(choice: Choice, training: CheckpointTraining) -> Checkpoint | None:
    """Read the checkpoint of its own kind that a training goes on from.

    Returns:
        The checkpoint; None if --checkpoint is not set, or names a General for the training to begin at.
    """
    path = choice.options.checkpoint
    general = training.general.name
    if not path or (training.begins_at_general and load_checkpoint(path)[1].get("checkpoint") == general):
        return None
    if training.takes_encoder_from_general:
        raise ValueError(f"{path}: expected the General that an Adam is searched for; name its file, or leave it out.")
    checkpoint = find_checkpoint(choice)
    say(f"going on from {checkpoint.source}")
    return checkpoint


def _previous_path(path: Path) -> Path:
    """Return the file in which a checkpoint that is replaced is kept."""
    return path.with_suffix(".previous.safetensors")


def _provide_general(choice: Choice, training: CheckpointTraining) -> Checkpoint:
    """Return the General that a training begins at, trained first if there is none.

    It is the one that --checkpoint names, else the one that ships, else one that is trained now for as many steps as
    this training takes. A finished training of equal settings is not repeated.

    Raises:
        ValueError: the file of a General of other settings is in the way; it is not replaced.
    """
    general = training.general
    options = replace(choice.options, paradigm=general.paradigm.name)
    choice = replace(choice, options=options, paradigm=general.paradigm)
    if not options.checkpoint and not has_shipped_checkpoint(choice, general):
        path, steps = trained_checkpoint_path(choice, general), options.train_steps
        if not path.is_file():
            say(f"no General ships for this data: training it first{f', {steps} steps' if steps else ''}.")
            train_checkpoint(choice)
        elif not _training_settings(choice, general).items() <= load_checkpoint(path)[1].items():
            raise ValueError(
                f"{path}: a General that was trained by other settings; begin at it with --checkpoint {path}, or move "
                "it to train another one."
            )
        choice = replace(choice, options=replace(options, checkpoint=path))
    checkpoint = find_checkpoint(choice)
    say(f"General: {checkpoint.source}")
    return checkpoint


def _last_training(choice: Choice) -> CheckpointTraining:
    """Return the training that --train runs: the last one that the paradigm needs."""
    trainings = choice.paradigm.trainings
    if not trainings:
        raise BadOption(f"--train: {choice.paradigm.name} needs no preparation; leave the option out.")
    if choice.options.checkpoint and choice.options.checkpoint.is_dir():
        raise BadOption(f"--checkpoint {choice.options.checkpoint}: a folder; with --train name a file in it.")
    return trainings[-1]


def _training_settings(
    choice: Choice, training: CheckpointTraining, general: MetaParameters | None = None, first: Checkpoint | None = None
) -> Document:
    """Return all that the result of a training depends on, except for rounding: the header of its checkpoint.

    Args:
        choice: the choice of what is trained.
        training: the training of the checkpoint.
        general: the General that training begins at.
        first: the checkpoint that training goes on from.
    """
    folder, name = training_data_folder(choice.application, choice.options.data, choice.options.quiet), training.name
    return (
        {"app": choice.app.name, "checkpoint": name, "data": data_label(folder), "content": fingerprint(folder)}
        | {
            "recipe": choice.options.recipe,
            "recipe_digest": content_digest(repr(choice.recipe)),
            "seed": choice.options.seed,
        }
        | {"steps": choice.options.train_steps, "versions": software_versions()}
        | ({} if training.shared_by_observations else choice.app.observation)
        | choice.app.recorded_conditions(choice.device)
        | ({"encoder": tensor_digest(general.encoder)} if general else {})
        | ({"first": first.digest} if first else {})
    )
