"""Training checkpoints: the state of a training in a file, from which the same command goes on.

Safetensors alone: the tensors of the state, and a JSON document for all else. On the CPU a training that goes on
from it ends bit for bit as one that was never cut off.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.learning.task import Params
from metapp.storage import Document
from metapp.storage.checkpoints import digest, tensor_digest
from metapp.storage.files import opened_tensors, remove_partial, write_bytes

SCHEMA = 3


def save_state(path: Path, fields: Mapping[str, Any], settings: Document) -> None:
    """Write the state of a training; after a failure, a warning, the last file stays.

    Args:
        path: of the file.
        fields: of the state by name: tensors, flat trees of tensors, and JSON-ready values.
        settings: all that the training's result depends on, JSON-ready.
    """
    trees = {name: value for name, value in fields.items() if isinstance(value, dict)}
    named = {f"{tree}.{key}": value for tree, values in trees.items() for key, value in values.items()}
    named |= {name: value for name, value in fields.items() if isinstance(value, Tensor)}
    document = {
        "schema": SCHEMA,
        "settings": settings,
        "fields": {name: value for name, value in fields.items() if name not in {*trees, *named}},
        "trees": {name: list(tree) for name, tree in trees.items()},
        "strides": {name: value.stride() for name, value in named.items() if not value.is_contiguous()},
    }
    text = json.dumps(document)
    # no two of which share memory
    tensors = {name: value.detach().cpu().contiguous().clone() for name, value in named.items()}
    metadata = {"training": text, "digest": _digest(text, tensors)}
    try:
        write_bytes(path, save(tensors, metadata))
    except OSError as error:
        warnings.warn(f"no training checkpoint: {error}", stacklevel=2)


def load_state(path: Path, settings: Document, device: torch.device | str = "cpu") -> dict[str, Any] | None:
    """Read the fields of a state that `save_state` wrote with equal settings; None if there is no file.

    Floats are on the device, integers on the CPU.

    Raises:
        ValueError: the file is damaged, or of other settings, and was put aside.
    """
    remove_partial(path)
    if not path.is_file():
        return None
    aside, now = path.with_suffix(".aside.safetensors"), json.loads(json.dumps(settings))
    try:
        with opened_tensors(path) as file:
            text, written = (file.metadata()[key] for key in ("training", "digest"))
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        document = json.loads(text)
        if written != _digest(text, tensors) or document["schema"] != SCHEMA:
            raise ValueError(path)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, RecursionError):
        os.replace(path, aside)
        raise ValueError(f"{path}: a damaged training checkpoint, put aside as {aside.name}") from None
    then = document["settings"]
    if then != now:
        unlike = ", ".join(sorted(key for key in {*then, *now} if then.get(key) != now.get(key)))
        os.replace(path, aside)
        raise ValueError(f"{path}: a training checkpoint of other settings ({unlike}), put aside as {aside.name}")
    strides, trees = document["strides"], document["trees"]
    placed = {name: _laid_out(value, strides.get(name), device) for name, value in tensors.items()}
    fields = {name: _tuples(value) for name, value in document["fields"].items()}
    fields |= {tree: {key: placed.pop(f"{tree}.{key}") for key in keys} for tree, keys in trees.items()}
    return fields | placed


def _digest(text: str, tensors: Params) -> str:
    return digest(text) + tensor_digest(tensors)


def _tuples(value: Any) -> Any:
    """A JSON document with tuples for lists."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _laid_out(value: Tensor, stride: list[int] | None, device: torch.device | str) -> Tensor:
    """A copy in memory of its own, laid out as it was: sums may be taken in another order if it is not."""
    if not value.is_floating_point():
        return value.clone()
    if not stride or 0 in stride:
        return value.to(device, copy=True)
    return torch.empty_strided(value.shape, stride, dtype=value.dtype, device=device).copy_(value)
