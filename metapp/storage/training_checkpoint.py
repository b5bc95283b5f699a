"""The training checkpoint: a file beside a checkpoint that is being trained, from which the same command goes on.

Safetensors alone: trees of tensors under `theta.`, `state.` and `phi.`, and a JSON document for the rest. On the CPU a
training that goes on from it ends bit for bit as one that was never cut off.
"""

from __future__ import annotations

import json
import os
import time
import warnings
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.learning.learn import MetaParameters, Step
from metapp.learning.progress import TrainState
from metapp.learning.task import Params
from metapp.storage import Document
from metapp.storage.checkpoints import digest, tensor_digest
from metapp.storage.files import opened_tensors, remove_partial, write_atomically

SECONDS = 60.0  # between two writes; METAPP_CHECKPOINT_SECONDS is another number, for tests
SCHEMA = 2
BEST = ("validation", "best_step", "curve")  # fields of a state, about its phi


class TrainingCheckpoint:
    """The file of one training: how far it is, and when that was last written."""

    def __init__(self, checkpoint: Path, settings: Document, device: torch.device | str = "cpu") -> None:
        """Nothing is read or written yet.

        Args:
            checkpoint: the file of the checkpoint that is trained.
            settings: everything that the result depends on, JSON-ready.
            device: where tensors go.
        """
        self.path = checkpoint.with_suffix(".training.safetensors")
        self.settings = json.loads(json.dumps(settings))
        self.device = device
        self.seconds = _seconds()
        self.state = TrainState()
        self.written, self.begin, self.before = time.monotonic(), time.process_time(), 0.0

    @property
    def spent(self) -> float:
        """Processor seconds of this training, with those of programs that were cut off, up to their last write."""
        return self.before + time.process_time() - self.begin

    def load(self) -> TrainState:
        """Load the state of an earlier training of the same settings; empty where there is none.

        Raises:
            ValueError: the file is damaged, or of other settings, and was put aside.
        """
        remove_partial(self.path)
        if not self.path.is_file():
            return TrainState()
        aside = self.path.with_suffix(".aside.safetensors")
        try:
            document, tensors = _read(self.path)
        except (SafetensorError, OSError, ValueError, KeyError, TypeError, RecursionError):
            os.replace(self.path, aside)
            raise ValueError(f"{self.path}: a damaged training checkpoint, put aside as {aside.name}") from None
        then = document["settings"]
        if then != self.settings:
            unlike = sorted(key for key in {*then, *self.settings} if then.get(key) != self.settings.get(key))
            os.replace(self.path, aside)
            raise ValueError(
                f"{self.path}: a training checkpoint of other settings ({', '.join(unlike)}), put aside as {aside.name}"
            )
        self.state, self.before = _state(document, tensors, self.device), document.get("spent", 0.0)
        return self.state

    def keep(self, state: TrainState) -> None:
        """Remember how far it is, and write it where the last write is `seconds` ago."""
        self.state = state
        if time.monotonic() - self.written >= self.seconds:
            self.write()

    def write(self) -> None:
        """Write how far it is, if anything is done; after a failure, a warning, the last file stays."""
        if not self.state.errors and self.state.outer is None:
            return
        document, tensors = _document(self.state)
        text = json.dumps({"schema": SCHEMA, "settings": self.settings, "spent": self.spent, **document})
        metadata = {"training": text, "digest": _digest(text, tensors)}
        try:
            write_atomically(self.path, lambda partial: partial.write_bytes(save(tensors, metadata)))
        except OSError as error:
            warnings.warn(f"no training checkpoint: {error}", stacklevel=1)
        self.written = time.monotonic()

    def remove(self) -> None:
        """The training is done."""
        self.path.unlink(missing_ok=True)


def _seconds() -> float:
    text = os.environ.get("METAPP_CHECKPOINT_SECONDS", "")
    try:
        return float(text) if text else SECONDS
    except ValueError:
        raise ValueError(f"METAPP_CHECKPOINT_SECONDS: '{text}', expected a number of seconds.") from None


def _digest(document: str, tensors: Params) -> str:
    return digest(document) + tensor_digest(tensors)


def _read(path: Path) -> tuple[Document, Params]:
    with opened_tensors(path) as file:
        metadata = file.metadata() or {}
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
    if metadata["digest"] != _digest(metadata["training"], tensors):
        raise ValueError(f"{path}: damaged")
    document = json.loads(metadata["training"])
    if document["schema"] != SCHEMA:
        raise ValueError(f"{path}: schema {document['schema']}, expected {SCHEMA}")
    return document, tensors


def _document(state: TrainState) -> tuple[Document, Params]:
    """A state as a JSON document and tensors [...] on the CPU, no two of which share memory."""
    document: Document = {"errors": state.errors}
    if state.outer is None or state.rng is None:
        return document, {}
    trees = {"theta": state.outer.theta, "state": state.outer.state, "phi": state.phi.flat()}
    named = {f"{part}.{key}": value for part, tree in trees.items() for key, value in tree.items()}
    named |= {"rng": state.rng} | ({"losses": torch.stack(state.losses)} if state.losses else {})
    document |= {"step": state.outer.step, **{name: getattr(state, name) for name in BEST}}
    document["strides"] = {name: value.stride() for name, value in named.items() if not value.is_contiguous()}
    document["order"] = {part: list(tree) for part, tree in trees.items()}
    return document, {name: value.detach().cpu().contiguous().clone() for name, value in named.items()}


def _state(document: Document, tensors: Params, device: torch.device | str) -> TrainState:
    """The inverse of `_document`."""
    errors = tuple(document["errors"])
    if "step" not in document:
        return TrainState(errors)
    strides = document["strides"]
    placed = {name: _laid_out(value, strides.get(name), device) for name, value in tensors.items() if name != "rng"}
    trees = {part: {key: placed[f"{part}.{key}"] for key in keys} for part, keys in document["order"].items()}
    best = {name: document[name] for name in BEST} | {"curve": tuple(map(tuple, document["curve"]))}
    losses = tuple(placed["losses"].unbind()) if "losses" in placed else ()
    outer = Step(document["step"], trees["theta"], trees["state"])
    return TrainState(errors, outer, tensors["rng"].clone(), losses, MetaParameters.unflat(trees["phi"]), **best)


def _laid_out(value: Tensor, stride: list[int] | None, device: torch.device | str) -> Tensor:
    """A copy in memory of its own, laid out as it was: sums may be taken in another order where it is not."""
    if not stride or 0 in stride:
        return value.to(device, copy=True)
    return torch.empty_strided(value.shape, stride, dtype=value.dtype, device=device).copy_(value)
