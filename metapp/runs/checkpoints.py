"""Checkpoints: find the best there is, or train one on the training tasks of a data set."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any, NamedTuple

from torch import Generator, get_num_threads

from metapp.learning.app import App, stack
from metapp.learning.learn import MetaParameters
from metapp.learning.progress import Prepared, Progress
from metapp.learning.recipe import OuterLoop
from metapp.paradigms import Paradigm, paradigms, ranks
from metapp.paradigms.training import describe, prepare, training_of
from metapp.runs import BadOption
from metapp.runs.checkpoint_check import on_own_grid, require_fit, require_tuned
from metapp.runs.embedded import embedded_exists
from metapp.runs.inputs import data_folder, data_label
from metapp.runs.reporter import progress, say
from metapp.runs.session import (
    Checkpoint,
    Options,
    is_first_protocol,
    make_folder,
    name_of,
    observe_of,
    precision_of,
    versions,
)
from metapp.runs.shipped import shipped_path, ships
from metapp.storage.files import remove_partial
from metapp.storage.records import digest, load_checkpoint, save_checkpoint, tensor_digest
from metapp.storage.shards import fingerprint, read_shard
from metapp.storage.training_checkpoint import TrainingCheckpoint


def find_checkpoint(options: Options, paradigm: Paradigm) -> Checkpoint:
    """Find the best checkpoint there is: --checkpoint, else one trained on this data earlier, else the shipped one.

    Raises:
        ValueError: there is none, or it is another application's, paradigm's, protocol's or network's.
    """
    needs = paradigm.needs(options.job)
    if not needs:
        return Checkpoint(MetaParameters(), "a random initialisation", "")
    needed, *tuned = needs
    path = _checkpoint_path(options, needed)
    prepared, info = load_checkpoint(path, options.device)
    app, name = info.get("app"), info.get("start")
    if (app, name) != (options.app.name, needed):
        a_rule = isinstance(name, str) and name not in paradigms()
        other = app == options.app.name and a_rule and paradigm.name == "meta"
        remedy = f"; add --rule {name}" if other else ""
        raise ValueError(f"{path}: a checkpoint of {app} {name}, expected {options.app.name} {needed}{remedy}.")
    _require_protocol(path, options.app, info)
    _require_conditions(path, options.app, prepared, info)
    prepared = on_own_grid(options, paradigm, prepared)
    require_fit(path, options, paradigm, prepared)
    checkpoint = Checkpoint(prepared, str(path), digest(path))
    if path == _shipped(options, needed) and not options.checkpoint:
        note = ", trained on other data, which may hold these tasks" if options.data else ""
        checkpoint = checkpoint._replace(source=f"the checkpoint that ships{note}")
    for each in tuned:
        checkpoint = _with_tuning(options, checkpoint, each)
    return checkpoint


def _require_protocol(path: Path, app: App, info: dict[str, Any]) -> None:
    """Refuse a checkpoint that learned from what fits may not see now; General's, which all share, says none."""
    then = info.get("observe", app.protocol)
    if then != app.protocol:
        raise ValueError(
            f"{path}: a checkpoint for --observe {then}, expected one for {app.protocol}; give --observe {then} or "
            "another checkpoint."
        )


def _require_conditions(path: Path, app: App, prepared: MetaParameters, info: dict[str, Any]) -> None:
    """Say that a checkpoint was trained with other features than are at hand; refuse one whose encoder reads them."""
    for key, now in app.conditions().items():
        then = info.get(key, now)
        if then != now and prepared.encoder:
            raise ValueError(f"{path}: its encoder reads {then}; here: {now}; or train one with --train.")
        if then != now:
            say(f"warning: {path.name} was trained with {then}; here: {now}.")


def _with_tuning(options: Options, checkpoint: Checkpoint, name: str) -> Checkpoint:
    """Put the Adam that was tuned for this very encoder into its checkpoint."""
    encoder = tensor_digest(checkpoint.prepared.encoder)
    candidates = [_shipped(options, name)]
    if options.data or embedded_exists(options.app.name):
        candidates.insert(0, trained_path(options, name))
    for path in candidates:
        if path.is_file():
            tuned, info = load_checkpoint(path)
            if info.get("encoder") == encoder:
                require_tuned(path, tuned)
                return Checkpoint(
                    checkpoint.prepared._replace(alpha=tuned.alpha), f"{checkpoint.source}, tuned Adam", digest(path)
                )
    words = ["metapp", name, options.app.name, "--train"]
    words += ["--observe", options.app.protocol] if options.app.protocol else []
    remedy = shlex.join(words + (["--data", str(options.data)] if options.data else []))
    say(f"{name}: no Adam was tuned for this encoder, the recipe's is used; {remedy}")
    return checkpoint


def _checkpoint_path(options: Options, name: str) -> Path:
    if options.checkpoint:
        return options.checkpoint
    if options.data or (_starts(options).is_dir() and embedded_exists(options.app.name)):
        path = trained_path(options, name)
        if path.is_file():
            return path
    path = _shipped(options, name)
    if path.is_file() and ships(options.app.name, options.recipe):
        return path
    raise ValueError(
        f"{name_of(options.app)} {name}, recipe {options.recipe}: no checkpoint, neither trained on this data nor "
        "shipped; train one with --train."
    )


def trained_path(options: Options, name: str) -> Path:
    """Where a checkpoint that is trained on this data is kept."""
    label = data_label(data_folder(options.app, options.data, options.quiet))
    run = f"{label}-{options.recipe}-seed{options.seed}"
    return _starts(options) / run / f"{checkpoint_name(options.app, name)}.safetensors"


def _starts(options: Options) -> Path:
    """The folder of checkpoints that were trained for this application, on any data."""
    return options.out / options.app.name / "starts"


def checkpoint_name(app: App, name: str) -> str:
    """A checkpoint's file name without its suffix: with the protocol, unless it is the first or General's."""
    return name if name == "general" or is_first_protocol(app) else f"{name}-{app.protocol}"


def _shipped(options: Options, name: str) -> Path:
    return shipped_path(options.app.name, checkpoint_name(options.app, name), options.recipe)


class Trained(NamedTuple):
    """A checkpoint that was trained here.

    Attributes:
        path: its file; the one it replaces is kept as `<name>.previous.safetensors`.
        prepared: what it holds.
        seconds: processor time of training, that before it was cut off included.
    """

    path: Path
    prepared: Prepared
    seconds: float


def train_checkpoint(
    options: Options, paradigm: Paradigm, steps: int | None, general: Checkpoint | None = None
) -> Trained:
    """Train what a paradigm needs on the training tasks and keep it for later runs on this data.

    Args:
        options: what for.
        paradigm: whose.
        steps: outer steps instead of the recipe's.
        general: the one that it starts from or is tuned for, if it does; None: the one there is, else trained now.
    """
    needs = paradigm.needs(options.job)
    if not needs:
        raise BadOption(f"--train: {paradigm.name} needs no preparation; leave the option out.")
    if options.checkpoint:
        raise BadOption("--train makes a checkpoint of its own; leave --checkpoint out.")
    name = needs[-1]
    path = trained_path(options, name)
    make_folder(path.parent)
    folder = data_folder(options.app, options.data, options.quiet)
    encoder = (general or general_of(options, steps)).prepared if _needs_general(options, name) else None
    tasks = stack(options.app, read_shard(folder, "train", options.app.name, options.app.holds), options.device)
    say(f"training {name_of(options.app)} {name} on {len(tasks)} tasks of {folder.name}, every eighth for validation")
    info: dict[str, Any] = {"data": data_label(folder), "recipe": options.recipe, "seed": options.seed}
    info |= (
        ({} if name == "general" else observe_of(options.app))
        | options.app.conditions()
        | precision_of(options.app, options.device)
        | {"versions": versions()}
        | ({"encoder": tensor_digest(encoder.encoder)} if encoder else {})
    )

    def keep(prepared: Prepared, file: Path, previous: Path | None = None) -> None:
        # General's file holds the encoder that QuickFT is tuned for
        kept = prepared.phi._replace(encoder={}) if name == "quickft" else prepared.phi
        save_checkpoint(file, kept, describe(options.job, name, prepared, steps) | info, previous)

    writes = ranks.number() == 0
    if writes:
        remove_partial(path)
    else:
        ranks.wait()  # until rank 0 has looked at the file, and put it aside if need be
    checkpoint = TrainingCheckpoint(path, _settings(options, name, steps, folder, encoder) | info, options.device)
    since = _go_on(checkpoint, training_of(options.job, name, steps))
    if writes:
        ranks.wait()
    ranks.wait()  # until all have read it
    with progress(f"train {name}", long=True, quiet=options.quiet) as bar:
        rng = Generator(options.device).manual_seed(options.seed)
        prepared: Prepared | None = None
        try:
            for now in prepare(name, options.job, tasks, rng, encoder=encoder, steps=steps, since=since):
                prepared = now.best
                if writes:
                    checkpoint.keep(now)
                if now.note:
                    bar.at(now.done, now.total, now.note)
        except (KeyboardInterrupt, ConnectionError) as error:
            if writes:
                checkpoint.write()
            if writes and isinstance(error, KeyboardInterrupt) and prepared and prepared.curve:
                kept = path.with_suffix(".interrupted.safetensors")
                keep(prepared, kept)
                say(f"validation error {prepared.validation:.3f}; to use it as it is: --checkpoint {kept}")
            raise
    assert prepared is not None
    if writes:
        keep(prepared, path, path.with_suffix(".previous.safetensors"))
        checkpoint.remove()
    ranks.wait()  # until the file is there, from which all go on
    say(f"{name}: validation error {prepared.validation:.3f} at step {prepared.step}; kept as {path}")
    return Trained(path, prepared, checkpoint.spent)


def _settings(
    options: Options, name: str, steps: int | None, folder: Path, encoder: MetaParameters | None
) -> dict[str, Any]:
    """What the result of a training depends on, beside what its checkpoint says about itself."""
    return {
        "app": options.app.name,
        "start": name,
        "steps": steps,
        "settings of the recipe": digest(repr(options.job.recipe)),
        "content of the data": fingerprint(folder),
        "General": encoder and tensor_digest(encoder.flat()),
        "device": str(options.device),
        "threads": get_num_threads(),
    }


def _go_on(checkpoint: TrainingCheckpoint, training: OuterLoop | None) -> Progress:
    """How far the same training was when it was cut off, and one line about it."""
    try:
        since = checkpoint.load()
    except ValueError as error:
        say(f"{error}; training from the beginning")
        return Progress()
    if since.outer and training:
        steps = f"step {since.outer.step:,} of {training.steps:,}"
        say(f"going on from {steps} (training checkpoint {checkpoint.path})")
    elif since.errors:
        say(f"going on after {len(since.errors)} looks of the search (training checkpoint {checkpoint.path})")
    return since


def _needs_general(options: Options, name: str) -> bool:
    recipe = options.job.recipe
    return name == "quickft" or (name != "general" and recipe.training(name).from_general)


def has_general(options: Options) -> bool:
    """Whether there is a General for this data.

    For a data set of the user's own only one trained on its training tasks will do: the shipped one may have seen its
    test tasks.
    """
    if trained_path(options, "general").is_file():
        return True
    return not options.data and ships(options.app.name, options.recipe) and _shipped(options, "general").is_file()


def general_of(options: Options, steps: int | None = None) -> Checkpoint:
    """The General that QuickFT is tuned for or that Meta starts from, trained now if this data has none."""
    general = paradigms()["general"]
    if not has_general(options):
        say(f"no General that was trained on this data yet: training it first{f', {steps} steps' if steps else ''}.")
        train_checkpoint(options, general, steps)
    checkpoint = find_checkpoint(options, general)
    say(f"General: {checkpoint.source}")
    return checkpoint
