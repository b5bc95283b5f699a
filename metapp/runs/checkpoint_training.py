"""Train a checkpoint on the training tasks of a data set, and keep it for later runs on this data."""

from __future__ import annotations

import os
import time
from dataclasses import asdict, replace
from pathlib import Path

from torch import Generator, get_num_threads

from metapp.apps import full_name, protocol_entry
from metapp.learning.app import stack_tasks
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Tasks
from metapp.options import BadOption
from metapp.paradigms import ranks
from metapp.paradigms.paradigm import Preparation
from metapp.paradigms.phi_training import TrainState, train_phi
from metapp.runs.checkpoint_selection import (
    attach_checkpoint,
    has_shipped_checkpoint,
    merge_tuned_adam,
    trained_checkpoint_path,
)
from metapp.runs.environment import make_folder, software_versions
from metapp.runs.inputs.run_inputs import data_label, training_data_folder
from metapp.runs.reporter import progress, say
from metapp.runs.run import Checkpoint, Run
from metapp.storage import Document
from metapp.storage.checkpoint_files import (
    content_digest,
    load_checkpoint,
    load_training_state,
    save_checkpoint,
    save_training_state,
    tensor_digest,
)
from metapp.storage.files import remove_partial
from metapp.storage.shards import fingerprint, read_data_set

SAVE_INTERVAL_SECONDS = 60.0  # between two training checkpoints; METAPP_CHECKPOINT_SECONDS is another number


def train_run(run: Run) -> Run:
    """The run with the checkpoint that is trained for it, which all ranks but the first do not read."""
    with ranks.connect_ranks(run.device):
        path, general = train_checkpoint(run)
    run = replace(run, options=replace(run.options, checkpoint=path))
    if general and run.paradigm.preparations[-1].takes_encoder_from_general:  # which may ship
        return replace(run, checkpoint=merge_tuned_adam(general, load_checkpoint(path)[0], path))
    return attach_checkpoint(run) if ranks.rank_number() == 0 else run


def train_checkpoint(run: Run) -> tuple[Path, Checkpoint | None]:
    """Train the checkpoint that the paradigm of a run needs, together with the other ranks if there are any.

    Returns:
        The file of the checkpoint (the one it replaces is kept as `<name>.previous.safetensors`), and the General that
        training began at, if it did.

    Raises:
        BadOption: there is nothing to train, or a folder of checkpoints was given.
        ValueError: the checkpoint is neither a General that this training begins at nor one that it goes on from.
    """
    preparation, options, steps = _preparation_of(run), run.options, run.options.train_steps
    path = trained_checkpoint_path(run, preparation)
    make_folder(options.out)
    make_folder(path.parent)
    first = _first(run, preparation)
    general = _general_of(run, preparation) if not first and preparation.begins_at_general else None
    general_phi = general.phi if general else None
    tasks = _tasks_of(run, preparation)
    header = _settings(run, preparation, general_phi, first)
    training = preparation.outer_loop
    if training.steps and steps:
        training = replace(training, steps=steps)
    about = {"inner_steps": run.recipe.steps, "batch": run.recipe.batch, "training": asdict(training)}
    settings = header | {"device": str(run.device), "threads": get_num_threads()}  # what rounding depends on

    def keep(state: TrainState, file: Path, previous: Path | None = None) -> None:
        # General's file holds the encoder that QuickFT is tuned for
        phi = state.phi._replace(encoder={}) if preparation.takes_encoder_from_general else state.phi
        result = {"validation_error": state.validation, "best_step": state.best_step, "curve": state.curve}
        save_checkpoint(file, phi, header | about | result, previous)

    writes, seconds, saved = ranks.rank_number() == 0, _seconds(), time.monotonic()
    state = since = _since(path, settings, run)
    with progress(f"train {preparation.name}", long=True, quiet=options.quiet) as bar:
        rng, phi = Generator(run.device).manual_seed(options.seed), first and first.phi
        try:
            for state in train_phi(preparation, tasks, rng, general=general_phi, first=phi, steps=steps, since=since):
                if writes and time.monotonic() - saved >= seconds:
                    save_training_state(_training_path(path), state._asdict(), settings)
                    saved = time.monotonic()
                if state.note:
                    bar.at(state.step, state.total, state.note)
        except (KeyboardInterrupt, ConnectionError) as error:
            if writes and state:
                save_training_state(_training_path(path), state._asdict(), settings)
            if writes and isinstance(error, KeyboardInterrupt) and state and state.curve:
                kept = path.with_suffix(".interrupted.safetensors")
                keep(state, kept)
                say(f"validation error {state.validation:.3f}; to use it as it is: --checkpoint {kept}")
            raise
    assert state is not None
    if writes:
        keep(state, path, _previous(path))
        _training_path(path).unlink(missing_ok=True)
    ranks.wait_for_ranks()  # until the file is there, from which all go on
    at = f"validation error {state.validation:.3f} at step {state.best_step}"
    say(f"{preparation.name}: {at}; kept as {path}, which fits and tables use with --checkpoint {path.parent}")
    return path, general


def _since(path: Path, settings: Document, run: Run) -> TrainState | None:
    """The state of the training that was cut off, read by all ranks, rank 0 first: it puts a damaged file aside."""
    if ranks.rank_number() > 0:
        ranks.wait_for_ranks()
    else:
        for file in (path, _previous(path)):
            remove_partial(file)
    since = None
    try:
        if fields := load_training_state(_training_path(path), settings, run.device):
            since = TrainState(**fields)
            at = f"step {since.step:,} of {since.total:,}" if since.moments else f"{since.step} Adams of the search"
            say(f"going on from {at} (training checkpoint {_training_path(path)})")
    except ValueError as error:
        say(f"{error}; training from the beginning")
    if ranks.rank_number() == 0:
        ranks.wait_for_ranks()
    ranks.wait_for_ranks()  # until all have read it
    return since


def _seconds() -> float:
    text = os.environ.get("METAPP_CHECKPOINT_SECONDS", "")
    try:
        return float(text) if text else SAVE_INTERVAL_SECONDS
    except ValueError:
        raise ValueError(f"METAPP_CHECKPOINT_SECONDS: '{text}', expected a number of seconds.") from None


def _training_path(path: Path) -> Path:
    """The file of a checkpoint's training."""
    return path.with_suffix(".training.safetensors")


def _tasks_of(run: Run, preparation: Preparation) -> Tasks:
    """The training tasks of a data set."""
    app, folder = run.app, training_data_folder(run.app, run.options.data, run.options.quiet)
    tasks = stack_tasks(app, read_data_set(folder, "train", app.name, app.tensors), run.device)
    on = f"{len(tasks)} tasks of {folder.name}, every eighth for validation"
    say(f"training {full_name(app)} {preparation.name} on {on}")
    return tasks


def _first(run: Run, preparation: Preparation) -> Checkpoint | None:
    """The checkpoint that a training goes on from; None if none was given, or a General to begin at."""
    given = run.options.checkpoint
    general = preparation.general.name
    if not given or (preparation.begins_at_general and load_checkpoint(given)[1].get("checkpoint") == general):
        return None
    if preparation.takes_encoder_from_general:
        raise ValueError(f"{given}: expected the General that an Adam is searched for; name its file, or leave it out.")
    checkpoint = attach_checkpoint(run).checkpoint
    assert checkpoint is not None
    say(f"going on from {checkpoint.source}")
    return checkpoint


def _previous(path: Path) -> Path:
    """The path of the checkpoint that is replaced."""
    return path.with_suffix(".previous.safetensors")


def _general_of(run: Run, preparation: Preparation) -> Checkpoint:
    """Return the General that a training begins at.

    It is the one that --checkpoint names, else the one that ships, else one that is trained now, for as many steps. A
    training with the same settings that has ended is not repeated.

    Raises:
        ValueError: there is a General of other settings in its place, which is not replaced.
    """
    general = preparation.general
    options = replace(run.options, paradigm=general.paradigm.name)
    run = replace(run, options=options, paradigm=general.paradigm)
    if not options.checkpoint and not has_shipped_checkpoint(run, general):
        path, steps = trained_checkpoint_path(run, general), options.train_steps
        if not path.is_file():
            say(f"no General ships for this data: training it first{f', {steps} steps' if steps else ''}.")
            train_checkpoint(run)
        elif not _settings(run, general).items() <= load_checkpoint(path)[1].items():
            found = "a General that was trained by other settings"
            raise ValueError(f"{path}: {found}; begin at it with --checkpoint {path}, or move it to train another one.")
        run = replace(run, options=replace(options, checkpoint=path))
    checkpoint = attach_checkpoint(run).checkpoint
    assert checkpoint is not None
    say(f"General: {checkpoint.source}")
    return checkpoint


def _preparation_of(run: Run) -> Preparation:
    """Return what to train: the last of the checkpoints that the paradigm needs."""
    preparations = run.paradigm.preparations
    if not preparations:
        raise BadOption(f"--train: {run.paradigm.name} needs no preparation; leave the option out.")
    if run.options.checkpoint and run.options.checkpoint.is_dir():
        raise BadOption(f"--checkpoint {run.options.checkpoint}: a folder; with --train name a file in it.")
    return preparations[-1]


def _settings(
    run: Run, preparation: Preparation, general: MetaParameters | None = None, first: Checkpoint | None = None
) -> Document:
    """Return all that the result of a training depends on but for rounding: the header of its checkpoint."""
    folder, name = training_data_folder(run.app, run.options.data, run.options.quiet), preparation.name
    return (
        {"app": run.app.name, "checkpoint": name, "data": data_label(folder), "content": fingerprint(folder)}
        | {"recipe": run.options.recipe, "recipe_digest": content_digest(repr(run.recipe)), "seed": run.options.seed}
        | {"steps": run.options.train_steps, "versions": software_versions()}
        | ({} if preparation.shared_by_protocols else protocol_entry(run.app))
        | run.app.conditions(run.device)
        | ({"encoder": tensor_digest(general.encoder)} if general else {})
        | ({"first": first.digest} if first else {})
    )
