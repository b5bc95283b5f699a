"""The training checkpoint: a file beside a checkpoint that is being trained, from which the same command goes on.

Safetensors alone: trees of tensors under `theta.`, `state.` and `best.`, and a JSON document for the rest. On the CPU a
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
from metapp.learning.progress import Prepared, Progress
from metapp.learning.task import Params
from metapp.storage import Document
from metapp.storage.files import remove_partial, write_atomically
from metapp.storage.records import digest, tensor_digest
from metapp.storage.tensors import opened_tensors

SECONDS = 60.0  # between two writes; METAPP_CHECKPOINT_SECONDS is another number, for tests
SCHEMA = 1


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
        self.progress = Progress()
        self.written, self.begin, self.before = time.monotonic(), time.process_time(), 0.0

    @property
    def spent(self) -> float:
        """Processor seconds of this training, with those of programs that were cut off, up to their last write."""
        return self.before + time.process_time() - self.begin

    def load(self) -> Progress:
        """Load the progress of an earlier training of the same settings; empty where there is none.

        Raises:
            ValueError: the file is damaged, or of other settings, and was put aside.
        """
        remove_partial(self.path)
        if not self.path.is_file():
            return Progress()
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
        self.progress, self.before = _progress(document, tensors, self.device), document.get("spent", 0.0)
        return self.progress

    def keep(self, progress: Progress) -> None:
        """Remember how far it is, and write it where the last write is `seconds` ago."""
        self.progress = progress
        if time.monotonic() - self.written >= self.seconds:
            self.write()

    def write(self) -> None:
        """Write how far it is, if anything is done; after a failure, a warning, the last file stays."""
        if not self.progress.errors and self.progress.outer is None:
            return
        document, tensors = _document(self.progress)
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


def _document(progress: Progress) -> tuple[Document, Params]:
    """Progress as a JSON document and tensors [...] on the CPU, no two of which share memory."""
    document: Document = {"looks": progress.errors}
    outer, best, losses = progress.outer, progress.best, progress.losses
    if outer is None or best is None or progress.rng is None:
        return document, {}
    trees = {"theta": outer.theta, "state": outer.state, "best": best.phi.flat()}
    named = {f"{part}.{key}": value for part, tree in trees.items() for key, value in tree.items()}
    named |= {"rng": progress.rng} | ({"losses": torch.stack(losses)} if losses else {})
    document |= {
        "step": outer.step,
        "best": {"validation": best.validation, "step": best.step, "curve": best.curve},
        "strides": {name: value.stride() for name, value in named.items() if not value.is_contiguous()},
        "order": {part: list(tree) for part, tree in trees.items()},
    }
    return document, {name: value.detach().cpu().contiguous().clone() for name, value in named.items()}


def _progress(document: Document, tensors: Params, device: torch.device | str) -> Progress:
    """The inverse of `_document`."""
    errors = tuple(document["looks"])
    if "step" not in document:
        return Progress(errors)
    strides = document["strides"]
    placed = {name: _laid_out(value, strides.get(name), device) for name, value in tensors.items() if name != "rng"}
    trees = {part: {key: placed[f"{part}.{key}"] for key in keys} for part, keys in document["order"].items()}
    curve = tuple((step, loss, error) for step, loss, error in document["best"]["curve"])
    phi = MetaParameters.unflat(trees["best"])
    best = Prepared(phi, document["best"]["validation"], document["best"]["step"], curve)
    losses = tuple(placed["losses"].unbind()) if "losses" in placed else ()
    outer = Step(document["step"], trees["theta"], trees["state"])
    return Progress(errors, outer, tensors["rng"].clone(), losses, best)


def _laid_out(value: Tensor, stride: list[int] | None, device: torch.device | str) -> Tensor:
    """A copy in memory of its own, laid out as it was: sums may be taken in another order where it is not."""
    if not stride or 0 in stride:
        return value.to(device, copy=True)
    return torch.empty_strided(value.shape, stride, dtype=value.dtype, device=device).copy_(value)
