"""Files of checkpoints and of the states of running trainings, and the digests by which records name them.

A file that is read may be damaged or written by anybody; no file is unpickled. Which checkpoint a run needs is decided
in `metapp.runs.checkpoints`.
"""

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
from metapp.storage.files import content_digest, open_tensors, write_bytes

CHECKPOINT_SCHEMA, STATE_SCHEMA = 1, 3  # versions of the layouts of checkpoints and of training states
FLOAT_TYPES = (torch.half, torch.float32, torch.float64)  # types that tensors of a checkpoint may have


def save_checkpoint(path: Path, phi: MetaParameters, header: Document, previous: Path | None = None) -> None:
    """Write a checkpoint with its description, as safetensors.

    Args:
        path: the file to write.
        phi: the meta-parameters.
        header: the description, JSON-ready.
        previous: the file in which a checkpoint that is replaced is kept; None to keep none.
    """
    tensors = {key: value.detach().cpu().contiguous().clone() for key, value in phi.flatten().items()}
    metadata = {"metapp": json.dumps({**header, "schema": CHECKPOINT_SCHEMA})}
    # save_file would write under a name that it chooses, and leave that file behind if the program is killed
    write_bytes(path, save(tensors, metadata), previous)


def load_checkpoint(
    path: Path, device: torch.device | str = "cpu", general: Path | None = None
) -> tuple[MetaParameters, Document]:
    """Read a checkpoint; tensors in half precision become float32.

    A checkpoint may name General's encoder by its digest instead of holding it. The encoder is then read from
    `general.safetensors` beside the file, or from the file of its protocol, such as `general-photo.safetensors`.

    Args:
        path: the file.
        device: the device of the tensors.
        general: another file of General that may have the encoder.

    Returns:
        The meta-parameters and the description that :func:`save_checkpoint` wrote.

    Raises:
        ValueError: there is no such file, it is not a checkpoint of metapp, or General's encoder is not found.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such checkpoint; give --checkpoint an existing .safetensors file, or train one.")
    try:
        with open_tensors(path, str(device)) as file:
            header = json.loads((file.metadata() or {})["metapp"])
            if not isinstance(header, dict) or type(header["schema"]) is not int:
                raise KeyError(path)
            stored = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        tensors = {key: value.float() if value.dtype == torch.half else value for key, value in stored.items()}
        if "start" in header:  # the key in most files that ship; writing them anew would double their history in Git
            header["checkpoint"] = header.pop("start")
        if header["schema"] > CHECKPOINT_SCHEMA:
            raise ValueError(f"{path}: schema {header['schema']}, expected at most {CHECKPOINT_SCHEMA}; update metapp.")
        if not all(value.dtype in FLOAT_TYPES for value in tensors.values()):
            raise KeyError(path)
        if not all(name.split(".")[0] in MetaParameters._fields and "." in name for name in tensors):
            raise KeyError(path)
        if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
            raise ValueError(f"{path}: holds NaN or infinite values, expected finite ones; train one again.")
        phi = MetaParameters.unflatten(tensors)
        if "general" in header:
            phi = _add_general_encoder(path, phi, header["general"], device, general)
        return phi, header
    except (SafetensorError, KeyError, RecursionError, json.JSONDecodeError):
        raise ValueError(
            f"{path}: not a checkpoint that metapp wrote (safetensors with its description); train one with --train."
        ) from None


def _add_general_encoder(
    path: Path, phi: MetaParameters, encoder_digest: str, device: torch.device | str, general: Path | None
) -> MetaParameters:
    """Add to a checkpoint the encoder of the General that its description names.

    Args:
        path: the file of the checkpoint.
        phi: the meta-parameters in the file.
        encoder_digest: the digest of General's encoder.
        device: the device of the tensors.
        general: a file of General beside those in the checkpoint's folder.

    Raises:
        ValueError: no file of General has this encoder.
    """
    names = ("general", f"general-{path.stem.rpartition('-')[2]}")  # the second is a file for the protocol alone
    files = [path.with_name(f"{name}.safetensors") for name in names]
    for file in [*files, general] if general else files:
        if file.is_file() and file != path:  # a file of General itself names no other
            encoder = load_checkpoint(file, device)[0].encoder
            if tensor_digest(encoder) == encoder_digest:
                return phi._replace(encoder=encoder)
    raise ValueError(
        f"{path}: goes on from General {encoder_digest}, which is not beside it, as general.safetensors; keep both "
        "files together."
    )


def tensor_digest(params: Params) -> str:
    """Return 12 hexadecimal digits that change with any name or value of a dictionary of tensors.

    >>> tensor_digest({"x": torch.zeros(2)}) == tensor_digest({"x": torch.tensor([0.0, 1e-30])})
    False
    """
    digest = hashlib.sha256()
    for key in sorted(params):
        digest.update(key.encode() + params[key].detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:12]


def save_training_state(path: Path, fields: Mapping[str, Any], settings: Document) -> None:
    """Write the state of a running training, from which an equal command goes on if the training is cut off.

    On the CPU a training that goes on from it ends bit for bit like one that was never cut off. If the file cannot be
    written, a warning says so, and the file that was there stays.

    Args:
        path: the file to write.
        fields: the fields of the state by name: tensors, dictionaries of tensors, and JSON-ready values.
        settings: all that the result of the training depends on, JSON-ready.
    """
    trees = {name: value for name, value in fields.items() if isinstance(value, dict)}
    tensors = {f"{tree}.{key}": value for tree, values in trees.items() for key, value in values.items()}
    tensors |= {name: value for name, value in fields.items() if isinstance(value, Tensor)}
    document = {
        "schema": STATE_SCHEMA,
        "settings": settings,
        "fields": {name: value for name, value in fields.items() if name not in {*trees, *tensors}},
        "trees": {name: list(tree) for name, tree in trees.items()},
        "strides": {name: value.stride() for name, value in tensors.items() if not value.is_contiguous()},
    }
    text = json.dumps(document)
    # clones, since safetensors refuses tensors that share memory
    tensors = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    metadata = {"training": text, "digest": _state_digest(text, tensors)}
    try:
        write_bytes(path, save(tensors, metadata))
    except OSError as error:
        warnings.warn(f"no training checkpoint: {error}", stacklevel=2)


def load_training_state(path: Path, settings: Document, device: torch.device | str = "cpu") -> dict[str, Any] | None:
    """Read the state of a training that :func:`save_training_state` wrote with equal settings.

    Args:
        path: the file.
        settings: all that the result of the training depends on, JSON-ready.
        device: the device of tensors of floats; tensors of integers stay on the CPU.

    Returns:
        The fields of the state by name; None if there is no file.

    Raises:
        ValueError: the file is damaged or has other settings, and was put aside.
    """
    if not path.is_file():
        return None
    aside_path, settings = path.with_suffix(".aside.safetensors"), json.loads(json.dumps(settings))
    try:
        with open_tensors(path) as file:
            text, digest = (file.metadata()[key] for key in ("training", "digest"))
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        document = json.loads(text)
        if digest != _state_digest(text, tensors) or document["schema"] != STATE_SCHEMA:
            raise ValueError(path)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, RecursionError):
        os.replace(path, aside_path)
        raise ValueError(f"{path}: a damaged training checkpoint, put aside as {aside_path.name}") from None
    saved_settings = document["settings"]
    if saved_settings != settings:
        keys = {*saved_settings, *settings}
        differing = ", ".join(sorted(key for key in keys if saved_settings.get(key) != settings.get(key)))
        os.replace(path, aside_path)
        raise ValueError(
            f"{path}: a training checkpoint of other settings ({differing}), put aside as {aside_path.name}"
        )
    strides, trees = document["strides"], document["trees"]
    tensors = {name: _copy_with_strides(value, strides.get(name), device) for name, value in tensors.items()}
    fields = {name: _lists_to_tuples(value) for name, value in document["fields"].items()}
    fields |= {tree: {key: tensors.pop(f"{tree}.{key}") for key in keys} for tree, keys in trees.items()}
    return fields | tensors


def _state_digest(text: str, tensors: Params) -> str:
    return content_digest(text) + tensor_digest(tensors)


def _lists_to_tuples(value: Any) -> Any:
    """Replace the lists in a JSON document by tuples."""
    return tuple(map(_lists_to_tuples, value)) if isinstance(value, list) else value


def _copy_with_strides(value: Tensor, stride: list[int] | None, device: torch.device | str) -> Tensor:
    """Copy a tensor with the strides that it had when it was saved, since sums depend on the order in memory.

    Args:
        value: the tensor, contiguous on the CPU; integers are copied as they are.
        stride: the strides; None for a contiguous tensor.
        device: the device of the copy.
    """
    if not value.is_floating_point():
        return value.clone()
    if not stride or 0 in stride:
        return value.to(device, copy=True)
    return torch.empty_strided(value.shape, stride, dtype=value.dtype, device=device).copy_(value)
