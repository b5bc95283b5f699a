"""Checkpoints on disk, trained ones and those of running trainings, and the digests by which records name them."""

from __future__ import annotations

import hashlib
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

from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.storage import Document
from metapp.storage.files import open_tensors, read_bytes, remove_partial, write_bytes

CHECKPOINT_SCHEMA, STATE_SCHEMA = 1, 3
FLOAT_TYPES = (torch.half, torch.float32, torch.float64)


def save_checkpoint(path: Path, start: MetaParameters, info: Document, previous: Path | None = None) -> None:
    """Write a checkpoint with its description, as safetensors; `previous` names the one it replaces."""
    tensors = {key: value.detach().cpu().contiguous().clone() for key, value in start.flatten().items()}
    metadata = {"metapp": json.dumps({**info, "schema": CHECKPOINT_SCHEMA})}
    # bytes: save_file writes under a name of its own, which a kill would leave behind
    write_bytes(path, save(tensors, metadata), previous)


def load_checkpoint(
    path: Path, device: torch.device | str = "cpu", general: Path | None = None
) -> tuple[MetaParameters, Document]:
    """Read a checkpoint; tensors in half precision become float32.

    One that names General's encoder by its digest, `general`, takes it from `general.safetensors` beside it, or from
    that of its protocol, such as `general-photo.safetensors`.

    Args:
        path: the file.
        device: of its tensors.
        general: another file of General that it may name.

    Returns:
        The checkpoint and its description, as of `save_checkpoint`.

    Raises:
        ValueError: there is no such file, or it is not a checkpoint of metapp's.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such checkpoint; give --checkpoint an existing .safetensors file, or train one.")
    try:
        with open_tensors(path, str(device)) as file:
            info = json.loads((file.metadata() or {})["metapp"])
            if not isinstance(info, dict) or type(info["schema"]) is not int:
                raise KeyError(path)
            stored = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        tensors = {key: value.float() if value.dtype == torch.half else value for key, value in stored.items()}
        if "start" in info:  # as most files that ship name themselves; writing them anew would double their history
            info["checkpoint"] = info.pop("start")
        if info["schema"] > CHECKPOINT_SCHEMA:
            raise ValueError(f"{path}: schema {info['schema']}, expected at most {CHECKPOINT_SCHEMA}; update metapp.")
        if not all(value.dtype in FLOAT_TYPES for value in tensors.values()):
            raise KeyError(path)
        if not all(name.split(".")[0] in MetaParameters._fields and "." in name for name in tensors):
            raise KeyError(path)
        if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
            raise ValueError(f"{path}: holds NaN or infinite values, expected finite ones; train one again.")
        prepared = MetaParameters.unflatten(tensors)
        return (
            _with_general(path, prepared, info["general"], device, general) if "general" in info else prepared
        ), info
    except (SafetensorError, KeyError, RecursionError, json.JSONDecodeError):
        raise ValueError(
            f"{path}: not a checkpoint that metapp wrote (safetensors with its description); train one with --train."
        ) from None


def _with_general(
    path: Path, prepared: MetaParameters, wanted: str, device: torch.device | str, other: Path | None
) -> MetaParameters:
    """The checkpoint with the encoder of the General that it names; General's own names none."""
    names = ("general", f"general-{path.stem.rpartition('-')[2]}")  # a protocol's own has its name
    files = [path.with_name(f"{name}.safetensors") for name in names]
    for file in [*files, other] if other else files:
        if file.is_file() and file != path:
            encoder = load_checkpoint(file, device)[0].encoder
            if tensor_digest(encoder) == wanted:
                return prepared._replace(encoder=encoder)
    raise ValueError(
        f"{path}: goes on from General {wanted}, which is not beside it, as general.safetensors; keep both together."
    )


def content_digest(document: object) -> str:
    """12 hex digits that change with a JSON-ready document, or, given a path, with a file's bytes.

    >>> digest({"seed": 0, "steps": 10}) == digest({"steps": 10, "seed": 0})
    True
    """
    raw = read_bytes(document) if isinstance(document, Path) else json.dumps(document, sort_keys=True).encode()
    return hashlib.sha256(raw).hexdigest()[:12]


def tensor_digest(params: Params) -> str:
    """12 hex digits that change with any value of a tree.

    >>> tensor_digest({"x": torch.zeros(2)}) == tensor_digest({"x": torch.tensor([0.0, 1e-30])})
    False
    """
    total = hashlib.sha256()
    for key in sorted(params):
        total.update(key.encode() + params[key].detach().cpu().contiguous().numpy().tobytes())
    return total.hexdigest()[:12]


def save_training_state(path: Path, fields: Mapping[str, Any], settings: Document) -> None:
    """Write the state of a training, from which the same command goes on; after a failure, a warning, the last stays.

    On the CPU a training that goes on from it ends bit for bit as one that was never cut off.

    Args:
        path: of the file.
        fields: of the state by name: tensors, flat trees of tensors, and JSON-ready values.
        settings: all that the training's result depends on, JSON-ready.
    """
    trees = {name: value for name, value in fields.items() if isinstance(value, dict)}
    named = {f"{tree}.{key}": value for tree, values in trees.items() for key, value in values.items()}
    named |= {name: value for name, value in fields.items() if isinstance(value, Tensor)}
    document = {
        "schema": STATE_SCHEMA,
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


def load_training_state(path: Path, settings: Document, device: torch.device | str = "cpu") -> dict[str, Any] | None:
    """Read the fields of a state that `save_training_state` wrote with equal settings; None if there is no file.

    Floats are on the device, integers on the CPU.

    Raises:
        ValueError: the file is damaged, or of other settings, and was put aside.
    """
    remove_partial(path)
    if not path.is_file():
        return None
    aside, now = path.with_suffix(".aside.safetensors"), json.loads(json.dumps(settings))
    try:
        with open_tensors(path) as file:
            text, written = (file.metadata()[key] for key in ("training", "digest"))
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        document = json.loads(text)
        if written != _digest(text, tensors) or document["schema"] != STATE_SCHEMA:
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
    return content_digest(text) + tensor_digest(tensors)


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
