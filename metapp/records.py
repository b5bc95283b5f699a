"""What runs leave on disk: trained starts, one record a task, fitted parameters."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save, save_file
from torch import Tensor

from metapp.files import write_atomically
from metapp.learning import MetaParameters
from metapp.task import Params

SCHEMA = 1


def save_start(path: Path, start: MetaParameters, info: dict[str, Any], previous: Path | None = None) -> None:
    """Write a prepared start with what it says about itself, as safetensors; `previous` names the one it replaces."""
    tensors = {key: value.detach().cpu().contiguous().clone() for key, value in start.flat().items()}
    metadata = {"metapp": json.dumps({**info, "schema": SCHEMA})}
    # bytes: save_file writes under a name of its own, which a kill would leave behind
    write_atomically(path, lambda target: target.write_bytes(save(tensors, metadata)), previous)


def load_start(path: Path, device: torch.device | str = "cpu") -> tuple[MetaParameters, dict[str, Any]]:
    """Read a prepared start; what is stored in half precision becomes float32.

    Returns:
        The start and what `save_start` was told about it.

    Raises:
        ValueError: there is no such file, or it is not a start of metapp's.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such start; give --checkpoint an existing .safetensors file, or train one.")
    try:
        with safe_open(path, "pt", device=str(device)) as file:
            info = json.loads((file.metadata() or {})["metapp"])
            stored = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        tensors = {key: value.float() if value.dtype == torch.half else value for key, value in stored.items()}
        if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
            raise ValueError(f"{path}: holds NaN or infinite values, expected finite ones; train a start again.")
        if info["schema"] > SCHEMA:
            raise ValueError(f"{path}: schema {info['schema']}, expected at most {SCHEMA}; update metapp.")
        if not all(name.split(".")[0] in MetaParameters._fields and "." in name for name in tensors):
            raise _Misnamed
        return MetaParameters.unflat(tensors), info
    except (SafetensorError, KeyError, TypeError, AttributeError, json.JSONDecodeError, _Misnamed):
        raise ValueError(
            f"{path}: not a start that metapp wrote (safetensors with its description); train one with --train."
        ) from None


class _Misnamed(Exception):
    """A tensor that is no part of a start."""


def digest(document: Any) -> str:
    """12 hex digits that change with a JSON-ready document, or with a file's bytes where a path is given."""
    raw = document.read_bytes() if isinstance(document, Path) else json.dumps(document, sort_keys=True).encode()
    return hashlib.sha256(raw).hexdigest()[:12]


def tensor_digest(params: Params) -> str:
    """12 hex digits that change with any value of a tree."""
    total = hashlib.sha256()
    for key in sorted(params):
        total.update(key.encode() + params[key].detach().cpu().contiguous().numpy().tobytes())
    return total.hexdigest()[:12]


class RunFolder:
    """A run's folder: `record.jsonl`, one line a task, and `params/<task>.safetensors`.

    Lines carry the run's key, a digest of all settings; lines of another key are an older run's and are dropped at the
    first write. A line is whole or absent: a run that was cut off resumes at its first missing task.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self.path = path
        self.settings = settings
        self.key = digest(settings)

    @property
    def file(self) -> Path:
        """The record file."""
        return self.path / "record.jsonl"

    def finished(self) -> dict[str, dict[str, Any]]:
        """Records of this run's key, by task."""
        return {record["name"]: record for record in read_records(self.file) if record.get("key") == self.key}

    def add(self, record: dict[str, Any], theta: dict[str, Tensor] | None = None) -> None:
        """Keep a finished task; its parameters, if it has any, first, so that a record's are always there."""
        if theta is not None:
            tensors = {key: value.detach().cpu().contiguous() for key, value in theta.items()}
            target = self.path / "params" / f"{file_name(record['name'])}.safetensors"
            write_atomically(target, lambda temporary: save_file(tensors, temporary))
        lines = [line for line in self.finished().values() if line["name"] != record["name"]]
        lines = [*lines, {**record, "key": self.key, "settings": self.settings}]
        text = "".join(json.dumps(line) + "\n" for line in lines)
        write_atomically(self.file, lambda temporary: temporary.write_text(text))


def read_records(path: Path) -> list[dict[str, Any]]:
    """The lines of a record file; an unreadable line counts as absent, an absent file as empty."""
    records = []
    if path.is_file():
        for line in path.read_text(errors="replace").splitlines():
            try:
                records.append(json.loads(line))
            except json.JSONDecodeError:
                continue
    return [record for record in records if isinstance(record, dict) and "name" in record]


def file_name(task: str) -> str:
    """A task's name as a file name: letters, digits, dot, underscore and hyphen, the rest as underscores."""
    safe = "".join(c if c.isalnum() or c in "._-" else "_" for c in task).lstrip(".") or "task"
    return safe if safe == task else f"{safe}-{hashlib.sha256(task.encode()).hexdigest()[:6]}"
