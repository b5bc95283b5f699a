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
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.learning.learn import MetaParameters, Progress
from metapp.learning.task import Params
from metapp.paradigms.resuming import Outer, Prepared, Reached
from metapp.storage.files import remove_partial, write_atomically
from metapp.storage.records import digest, tensor_digest
from metapp.storage.tensors import opened_tensors

SECONDS = 60.0  # between two writes; METAPP_CHECKPOINT_SECONDS is another number, for tests
SCHEMA = 1


class TrainingCheckpoint:
    """The file of one training: what was last reached, and when it was last written."""

    def __init__(self, start: Path, settings: dict[str, Any], device: torch.device | str = "cpu") -> None:
        """Nothing is read or written yet.

        Args:
            start: the file of the checkpoint that is trained.
            settings: everything that the result depends on, JSON-ready.
            device: where tensors go.
        """
        self.path = start.with_suffix(".training.safetensors")
        self.settings = json.loads(json.dumps(settings))
        self.device = device
        self.seconds = _seconds()
        self.reached = Reached()
        self.written, self.begin, self.before = time.monotonic(), time.process_time(), 0.0

    @property
    def spent(self) -> float:
        """Processor seconds of this training, with those of programs that were cut off, up to their last write."""
        return self.before + time.process_time() - self.begin

    def load(self) -> Reached:
        """How far an earlier training of the same settings was; nothing where there is none.

        Raises:
            ValueError: the file is damaged, or of other settings, and was put aside.
        """
        remove_partial(self.path)
        if not self.path.is_file():
            return Reached()
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
        self.reached, self.before = _reached(document, tensors, self.device), document.get("spent", 0.0)
        return self.reached

    def keep(self, reached: Reached) -> None:
        """Take note of how far it is, and write it now and then."""
        self.reached = reached
        if time.monotonic() - self.written >= self.seconds:
            self.write()

    def write(self) -> None:
        """Write what was reached, if anything; a failure is said, and the last file that was written stays."""
        if not self.reached.looks and self.reached.outer is None:
            return
        document, tensors = _document(self.reached)
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
    told = os.environ.get("METAPP_CHECKPOINT_SECONDS", "")
    try:
        return float(told) if told else SECONDS
    except ValueError:
        raise ValueError(f"METAPP_CHECKPOINT_SECONDS: '{told}', expected a number of seconds.") from None


def _digest(document: str, tensors: Params) -> str:
    return digest(document) + tensor_digest(tensors)


def _read(path: Path) -> tuple[dict[str, Any], Params]:
    with opened_tensors(path) as file:
        metadata = file.metadata() or {}
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
    if metadata["digest"] != _digest(metadata["training"], tensors):
        raise ValueError(f"{path}: damaged")
    document = json.loads(metadata["training"])
    if document["schema"] != SCHEMA:
        raise ValueError(f"{path}: schema {document['schema']}, expected {SCHEMA}")
    return document, tensors


def _document(reached: Reached) -> tuple[dict[str, Any], Params]:
    """What was reached as a JSON document and tensors [...] on the CPU, no two of which share memory."""
    document: dict[str, Any] = {"looks": reached.looks}
    if reached.outer is None:
        return document, {}
    (step, theta, state), rng, best, losses = reached.outer
    trees = {"theta": theta, "state": state, "best": best.start.flat()}
    named = {f"{part}.{key}": value for part, tree in trees.items() for key, value in tree.items()}
    named |= {"rng": rng} | ({"losses": torch.stack(losses)} if losses else {})
    document |= {
        "step": step,
        "best": {"validation": best.validation, "step": best.step, "curve": best.curve},
        "strides": {name: value.stride() for name, value in named.items() if not value.is_contiguous()},
        "order": {part: list(tree) for part, tree in trees.items()},
    }
    return document, {name: value.detach().cpu().contiguous().clone() for name, value in named.items()}


def _reached(document: dict[str, Any], tensors: Params, device: torch.device | str) -> Reached:
    """The inverse of `_document`."""
    looks = tuple(document["looks"])
    if "step" not in document:
        return Reached(looks)
    strides = document["strides"]
    placed = {name: _laid_out(value, strides.get(name), device) for name, value in tensors.items() if name != "rng"}
    trees = {part: {key: placed[f"{part}.{key}"] for key in keys} for part, keys in document["order"].items()}
    curve = [(step, loss, error) for step, loss, error in document["best"]["curve"]]
    start = MetaParameters.unflat(trees["best"])
    best = Prepared(start, document["best"]["validation"], document["best"]["step"], curve)
    losses = tuple(placed["losses"].unbind()) if "losses" in placed else ()
    progress = Progress(document["step"], trees["theta"], trees["state"])
    return Reached(looks, Outer(progress, tensors["rng"].clone(), best, losses))


def _laid_out(value: Tensor, stride: list[int] | None, device: torch.device | str) -> Tensor:
    """A copy in memory of its own, laid out as it was: sums may be taken in another order where it is not."""
    if not stride or 0 in stride:
        return value.to(device, copy=True)
    return torch.empty_strided(value.shape, stride, dtype=value.dtype, device=device).copy_(value)
