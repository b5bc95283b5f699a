"""Files of checkpoints and of the states of running trainings.

A checkpoint is one file of several entries: General's encoder, QuickFT's Adam, and learned rules. An entry is one phi
with its description. A file that is read may be damaged or written by anybody; no file is unpickled.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import warnings
from collections.abc import Iterator, Mapping
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

CHECKPOINT_SCHEMA, STATE_SCHEMA = 2, 3  # versions of the layouts of checkpoints and of training states
FLOAT_TYPES = (torch.half, torch.float32, torch.float64)  # types that tensors of a checkpoint may have
ENCODER_OF = "encoder_of"  # in the description of an entry: the entry of the file that holds its encoder


def write_entry(path: Path, entry: str, phi: MetaParameters, header: Document, previous: Path | None = None) -> None:
    """Write one entry of a checkpoint; all other entries of the file stay as they are.

    An encoder that several entries have is stored once. Each description gets the digest of the entry's values.

    Args:
        path: the file, which is made if it is missing.
        entry: the name of the entry, such as "general"; an entry of this name is replaced.
        phi: the meta-parameters.
        header: the description of the entry, JSON-ready.
        previous: the file in which the whole file is kept as it was if the entry is replaced; None to keep none.

    Raises:
        ValueError: there is a file, but it is not a checkpoint.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "brdf.safetensors")
    ...     write_entry(path, "general", MetaParameters(encoder={"w": torch.ones(2)}), {"app": "brdf"})
    ...     write_entry(path, "ridge", MetaParameters(encoder={"w": torch.ones(2)}), {"app": "brdf"})
    ...     list(read_headers(path)), read_headers(path)["ridge"]["encoder_of"]
    (['general', 'ridge'], 'general')
    """
    entries: dict[str, tuple[MetaParameters, Document]] = {}
    if path.is_file():
        with _open_checkpoint(path) as (file, stored):
            entries = {name: (_read_phi(file, stored, name), description) for name, description in stored.items()}
    replaced_file = previous if entry in entries else None
    entries[entry] = phi, header
    tensors: Params = {}
    headers: dict[str, Document] = {}
    holders: dict[str, str] = {}  # the entry that holds an encoder, by its digest
    for name in sorted(entries, key=lambda name: bool(entries[name][0].alpha)):  # encoders alone come first
        part, header = entries[name]
        headers[name] = {key: value for key, value in header.items() if key != ENCODER_OF}
        headers[name]["digest"] = phi_digest(part)
        holder = holders.setdefault(phi_digest(MetaParameters(encoder=part.encoder)), name) if part.encoder else name
        if holder != name:
            headers[name][ENCODER_OF] = holder
            part = part._replace(encoder={})
        tensors |= {f"{name}:{key}": value.detach().cpu().contiguous().clone() for key, value in part.flatten().items()}
    metadata = {"metapp": json.dumps({"schema": CHECKPOINT_SCHEMA, "entries": headers})}
    # save_file would write under a name that it chooses, and leave that file behind if the program is killed
    write_bytes(path, save(tensors, metadata), replaced_file)


def read_entry(path: Path, entry: str, device: torch.device | str = "cpu") -> tuple[MetaParameters, Document]:
    """Read one entry of a checkpoint; tensors in half precision become float32.

    Args:
        path: the file.
        entry: the name of the entry.
        device: the device of the tensors.

    Returns:
        The meta-parameters, with their encoder, and the description that :func:`write_entry` wrote.

    Raises:
        ValueError: there is no such file, it is not a checkpoint of metapp, or it has no such entry.
    """
    with _open_checkpoint(path, device) as (file, headers):
        if entry not in headers:
            raise ValueError(f"{path}: holds {', '.join(headers)}, expected {entry}; name another checkpoint.")
        tensors = _to_single(_read_phi(file, headers, entry).flatten())
    if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
        raise ValueError(f"{path}: holds NaN or infinite values, expected finite ones; train one again.")
    return MetaParameters.unflatten(tensors), headers[entry]


def read_headers(path: Path) -> dict[str, Document]:
    """Read the descriptions of all entries of a checkpoint, by the names of the entries.

    Raises:
        ValueError: there is no such file, or it is not a checkpoint of metapp.
    """
    with _open_checkpoint(path) as (_, headers):
        return headers


@contextlib.contextmanager
def _open_checkpoint(path: Path, device: torch.device | str = "cpu") -> Iterator[tuple[Any, dict[str, Document]]]:
    """Open a checkpoint for the time of a `with` block, with the descriptions of its entries by their names.

    Raises:
        ValueError: there is no such file, or it is not a checkpoint of metapp, which may turn out in the block.
    """
    if path.is_dir():
        raise ValueError(f"{path}: a folder, expected a checkpoint; name the .safetensors file in it.")
    if not path.is_file():
        raise ValueError(f"{path}: no such checkpoint; give --checkpoint an existing .safetensors file, or train one.")
    try:
        with open_tensors(path, str(device)) as file:
            document = json.loads((file.metadata() or {})["metapp"])
            if not isinstance(document, dict) or type(schema := document["schema"]) is not int:
                raise KeyError(path)
            if schema != CHECKPOINT_SCHEMA:
                remedy = "update metapp" if schema > CHECKPOINT_SCHEMA else "train one again"
                raise ValueError(f"{path}: schema {schema}, expected {CHECKPOINT_SCHEMA}; {remedy}.")
            headers = document["entries"]
            if not isinstance(headers, dict) or not all(isinstance(header, dict) for header in headers.values()):
                raise KeyError(path)
            yield file, headers
    except (SafetensorError, KeyError, RecursionError, json.JSONDecodeError):
        raise ValueError(
            f"{path}: not a checkpoint that metapp wrote (safetensors with its description); train one with --train."
        ) from None


def _read_phi(file: Any, headers: dict[str, Document], entry: str) -> MetaParameters:
    """Read an entry of an open checkpoint with its encoder, in the precision of the file.

    Args:
        file: the open file.
        headers: the descriptions of its entries.
        entry: the name of the entry.

    Raises:
        KeyError: the tensors are not those of meta-parameters, or the entry that holds the encoder is missing.
    """
    names = [name for name in file.keys() if name.startswith(f"{entry}:")]  # noqa: SIM118  (not a mapping)
    tensors = {name.removeprefix(f"{entry}:"): file.get_tensor(name) for name in names}
    if not all(value.dtype in FLOAT_TYPES for value in tensors.values()):
        raise KeyError(entry)
    if not all(name.split(".")[0] in MetaParameters._fields and "." in name for name in tensors):
        raise KeyError(entry)
    phi = MetaParameters.unflatten(tensors)
    if ENCODER_OF not in headers[entry]:
        return phi
    holder = str(headers[entry][ENCODER_OF])
    if ENCODER_OF in headers[holder]:  # two entries could name each other without end
        raise KeyError(entry)
    return phi._replace(encoder=_read_phi(file, headers, holder).encoder)


def phi_digest(phi: MetaParameters) -> str:
    """Return 12 hexadecimal digits that change with any value of meta-parameters, as fits see them."""
    return tensor_digest(_to_single(phi.flatten()))


def _to_single(tensors: Params) -> Params:
    """Return tensors with those of half precision in single precision."""
    return {key: value.float() if value.dtype == torch.half else value for key, value in tensors.items()}


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
