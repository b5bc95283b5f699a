"""Train a checkpoint on the training tasks of a data set, and keep it for later runs on this data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from torch import Generator, get_num_threads

from metapp.learning.app import stack
from metapp.learning.learn import MetaParameters
from metapp.learning.progress import TrainState
from metapp.learning.recipe import OuterLoop
from metapp.learning.task import Tasks
from metapp.options import BadOption
from metapp.paradigms import PARADIGMS, ranks
from metapp.paradigms.paradigm import TrainingData
from metapp.paradigms.training import describe, preparing, training_of
from metapp.paradigms.validation import split_validation
from metapp.runs.checkpoints import ships_general, trained_path, with_checkpoint
from metapp.runs.inputs.sources import data_folder, data_label
from metapp.runs.naming import name_of, observe_of
from metapp.runs.reporter import progress, say
from metapp.runs.run import Checkpoint, Run
from metapp.runs.surroundings import make_folder, precision_of, versions
from metapp.storage import Document
from metapp.storage.checkpoints import digest, load_checkpoint, save_checkpoint, tensor_digest
from metapp.storage.files import remove_partial
from metapp.storage.shards import fingerprint, read_shard
from metapp.storage.training_checkpoint import TrainingCheckpoint


class Trained(NamedTuple):
    """A checkpoint that was trained here.

    Attributes:
        path: its file; the one it replaces is kept as `<name>.previous.safetensors`.
        general: the one that training went on from or tuned for, if it did.
        state: at the end of the training, with what it holds.
        seconds: processor time of training, that before it was cut off included.
    """

    path: Path
    general: Checkpoint | None
    state: TrainState
    seconds: float


def train_checkpoint(plan: Run, steps: int | None, general: Checkpoint | None = None) -> Trained:
    """Train what the paradigm of a plan needs, together with the other ranks where there are any.

    Args:
        plan: what for.
        steps: outer steps instead of the recipe's.
        general: the one that training goes on from or tunes for, if it does; None: as `general_of` has it.

    Raises:
        BadOption: there is nothing to train, or a folder of checkpoints was given.
        ValueError: the checkpoint is neither a General that this training begins at nor one that it goes on from.
    """
    name, app, options = _name_of(plan), plan.app, plan.options
    paradigm, path = preparing(plan.paradigm, name), trained_path(plan, name)
    make_folder(options.out)
    make_folder(path.parent)
    folder = data_folder(app, options.data, options.quiet)
    first = _first(plan, name)
    begins = not first.digest and _needs_general(plan, name)
    general = general or general_of(plan, steps) if begins else None
    encoder = general.phi if general else None
    tasks = _tasks_of(plan, name, folder)
    about = _about(plan, name, folder, encoder) | ({"first": first.digest} if first.digest else {})
    settings = _settings(plan, name, steps, folder, encoder) | about
    info = about | {"training_digest": digest(settings)}

    def keep(state: TrainState, file: Path, previous: Path | None = None) -> None:
        # General's file holds the encoder that QuickFT is tuned for
        kept = state.phi._replace(encoder={}) if name == "quickft" else state.phi
        save_checkpoint(file, kept, describe(paradigm, state, steps) | info, previous)

    writes, phi = ranks.number() == 0, first.phi
    checkpoint, since = _opened(path, settings, plan, training_of(paradigm, steps))
    with progress(f"train {name}", long=True, quiet=options.quiet) as bar:
        rng = Generator(plan.device).manual_seed(options.seed)
        state = since
        try:
            data = TrainingData(*split_validation(tasks), rng, encoder, steps, since, phi)
            for state in paradigm.prepare(data):
                if writes:
                    checkpoint.keep(state)
                if state.note:
                    bar.at(state.done, state.total, state.note)
        except (KeyboardInterrupt, ConnectionError) as error:
            if writes:
                checkpoint.write()
            if writes and isinstance(error, KeyboardInterrupt) and state.curve:
                kept = path.with_suffix(".interrupted.safetensors")
                keep(state, kept)
                say(f"validation error {state.validation:.3f}; to use it as it is: --checkpoint {kept}")
            raise
    if writes:
        keep(state, path, _previous(path))
        checkpoint.remove()
    ranks.wait()  # until the file is there, from which all go on
    at = f"validation error {state.validation:.3f} at step {state.best_step}"
    say(f"{name}: {at}; kept as {path}, which fits and tables use with --checkpoint {path.parent}")
    return Trained(path, general, state, checkpoint.spent)


def _opened(
    path: Path, settings: Document, plan: Run, training: OuterLoop | None
) -> tuple[TrainingCheckpoint, TrainState]:
    """The training checkpoint beside a file, and how far it was: read by all ranks."""
    writes = ranks.number() == 0
    if writes:
        _remove_partial(path)
    else:
        ranks.wait()  # until rank 0 has looked at the file, and put it aside if need be
    settings = settings | {"device": str(plan.device), "threads": get_num_threads()}  # what rounding depends on
    checkpoint = TrainingCheckpoint(path, settings, plan.device)
    since = _go_on(checkpoint, training)
    if writes:
        ranks.wait()
    ranks.wait()  # until all have read it
    return checkpoint, since


def _tasks_of(plan: Run, name: str, folder: Path) -> Tasks:
    """The training tasks of a data set."""
    app = plan.app
    tasks = stack(app, read_shard(folder, "train", app.name, app.tensors), plan.device)
    say(f"training {name_of(app)} {name} on {len(tasks)} tasks of {folder.name}, every eighth for validation")
    return tasks


def _first(plan: Run, name: str) -> Checkpoint:
    """The checkpoint that a training goes on from; an empty one where none was given, or a General to begin at."""
    given = plan.options.checkpoint
    if not given or (_needs_general(plan, name) and load_checkpoint(given)[1].get("checkpoint") == "general"):
        return Checkpoint(MetaParameters(), "", "")
    if name == "quickft":
        raise ValueError(f"{given}: expected the General that an Adam is searched for; name its file, or leave it out.")
    checkpoint = with_checkpoint(plan).checkpoint
    assert checkpoint is not None
    say(f"going on from {checkpoint.source}")
    return checkpoint


def _previous(path: Path) -> Path:
    """Where the checkpoint that is replaced is kept."""
    return path.with_suffix(".previous.safetensors")


def _remove_partial(path: Path) -> None:
    """Remove what a kill left of a checkpoint, or of the one that it replaces."""
    for file in (path, _previous(path)):
        remove_partial(file)


def general_of(plan: Run, steps: int | None = None) -> Checkpoint:
    """The General that QuickFT is tuned for or that Meta's training begins at.

    It is the one that --checkpoint names, else the one that ships, else one that is trained now, for as many steps. A
    training with the same settings that has ended is not repeated.

    Raises:
        ValueError: there is a General of other settings in its place, which is not replaced.
    """
    options = replace(plan.options, paradigm="general")
    plan = replace(plan, options=options, paradigm=PARADIGMS["general"](plan.app, plan.recipe, plan.paradigm.rule_name))
    if not options.checkpoint and not ships_general(plan):
        begin = replace(plan, options=replace(options, checkpoint=None))
        path = trained_path(begin, "general")
        if path.is_file() and not _is_trained(begin, steps):
            found = "a General that was trained by other settings"
            raise ValueError(f"{path}: {found}; begin at it with --checkpoint {path}, or move it to train another one.")
        if not path.is_file():
            say(f"no General ships for this data: training it first{f', {steps} steps' if steps else ''}.")
            train_checkpoint(begin, steps)
        plan = replace(plan, options=replace(options, checkpoint=path))
    checkpoint = with_checkpoint(plan).checkpoint
    assert checkpoint is not None
    say(f"General: {checkpoint.source}")
    return checkpoint


def _is_trained(plan: Run, steps: int | None) -> bool:
    """True if the General that would be trained now is there, by the same settings."""
    path = trained_path(plan, "general")
    folder = data_folder(plan.app, plan.options.data, plan.options.quiet)
    settings = _settings(plan, "general", steps, folder, None) | _about(plan, "general", folder, None)
    return load_checkpoint(path)[1].get("training_digest") == digest(settings)


def _name_of(plan: Run) -> str:
    """The checkpoint to train: the last of those that the paradigm needs."""
    needs = plan.paradigm.needs
    if not needs:
        raise BadOption(f"--train: {plan.paradigm.name} needs no preparation; leave the option out.")
    if plan.options.checkpoint and plan.options.checkpoint.is_dir():
        raise BadOption(f"--checkpoint {plan.options.checkpoint}: a folder; with --train name a file in it.")
    return needs[-1]


def _needs_general(plan: Run, name: str) -> bool:
    return name == "quickft" or (name != "general" and plan.recipe.training(name).from_general)


def _about(plan: Run, name: str, folder: Path, encoder: MetaParameters | None) -> Document:
    """The part of a checkpoint's header about the data it was trained on."""
    return (
        {"data": data_label(folder), "recipe": plan.options.recipe, "seed": plan.options.seed}
        | ({} if name == "general" else observe_of(plan.app))
        | plan.app.conditions()
        | precision_of(plan.app, plan.device)
        | {"versions": versions()}
        | ({"encoder": tensor_digest(encoder.encoder)} if encoder else {})
    )


def _settings(plan: Run, name: str, steps: int | None, folder: Path, encoder: MetaParameters | None) -> Document:
    """All that the result of a training depends on but for rounding, beside what its checkpoint says about itself."""
    return {
        "app": plan.app.name,
        "checkpoint": name,
        "steps": steps,
        "settings of the recipe": digest(repr(plan.recipe)),
        "content of the data": fingerprint(folder),
        "General": encoder and tensor_digest(encoder.flat()),
    }


def _go_on(checkpoint: TrainingCheckpoint, training: OuterLoop | None) -> TrainState:
    """Load the state of the same training when it was cut off, and say one line about it."""
    try:
        since = checkpoint.load()
    except ValueError as error:
        say(f"{error}; training from the beginning")
        return TrainState()
    if since.outer and training:
        steps = f"step {since.outer.step:,} of {training.steps:,}"
        say(f"going on from {steps} (training checkpoint {checkpoint.path})")
    elif since.errors:
        say(f"going on after {len(since.errors)} looks of the search (training checkpoint {checkpoint.path})")
    return since
