"""Files of runs on disk: trained checkpoints, one record a task, fitted parameters."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import statistics
import sys
import unicodedata
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.storage import Document
from metapp.storage.files import append_line, locked, read_bytes, write_atomically
from metapp.storage.tensors import opened_tensors, read_tensors
from metapp.storage.text import as_text

Record = Document  # of a task, a line of record.jsonl
SCHEMA = 1
SMALL_BYTES = 2**16  # of a record file: below it replaced lines stay
LONGEST = 100  # bytes of a name; file systems take 255, of which suffixes and temporary names need some
FLOATS = (torch.half, torch.float32, torch.float64)

FIT = ("error", "seconds")  # entries of a fit's record, beside its name
TEXTS = ("name", "key", "source", "stamp", "content")  # entries that are texts, where a record has them


def save_checkpoint(path: Path, start: MetaParameters, info: Document, previous: Path | None = None) -> None:
    """Write a checkpoint with what it says about itself, as safetensors; `previous` names the one it replaces."""
    tensors = {key: value.detach().cpu().contiguous().clone() for key, value in start.flat().items()}
    metadata = {"metapp": json.dumps({**info, "schema": SCHEMA})}
    # bytes: save_file writes under a name of its own, which a kill would leave behind
    write_atomically(path, lambda target: target.write_bytes(save(tensors, metadata)), previous)


def load_checkpoint(
    path: Path, device: torch.device | str = "cpu", general: Path | None = None
) -> tuple[MetaParameters, Document]:
    """Read a checkpoint; what is stored in half precision becomes float32.

    One that names General's encoder by its digest, `general`, takes it from `general.safetensors` beside it, or from
    that of its protocol, such as `general-photo.safetensors`.

    Args:
        path: the file.
        device: where its tensors go.
        general: another file of General that it may name.

    Returns:
        The checkpoint and what `save_checkpoint` was told about it.

    Raises:
        ValueError: there is no such file, or it is not a checkpoint of metapp's.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such checkpoint; give --checkpoint an existing .safetensors file, or train one.")
    try:
        with opened_tensors(path, str(device)) as file:
            info = json.loads((file.metadata() or {})["metapp"])
            if not isinstance(info, dict) or type(info["schema"]) is not int:
                raise _Misnamed
            stored = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        tensors = {key: value.float() if value.dtype == torch.half else value for key, value in stored.items()}
        if "start" in info:  # as most files that ship name themselves; writing them anew would double their history
            info["checkpoint"] = info.pop("start")
        if info["schema"] > SCHEMA:
            raise ValueError(f"{path}: schema {info['schema']}, expected at most {SCHEMA}; update metapp.")
        if not all(value.dtype in FLOATS for value in tensors.values()):
            raise _Misnamed
        if not all(name.split(".")[0] in MetaParameters._fields and "." in name for name in tensors):
            raise _Misnamed
        if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
            raise ValueError(f"{path}: holds NaN or infinite values, expected finite ones; train one again.")
        prepared = MetaParameters.unflat(tensors)
        return (
            _with_general(path, prepared, info["general"], device, general) if "general" in info else prepared
        ), info
    except (SafetensorError, KeyError, RecursionError, json.JSONDecodeError, _Misnamed):
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


class _Misnamed(Exception):
    """A tensor that is no part of a checkpoint."""


def digest(document: object) -> str:
    """12 hex digits that change with a JSON-ready document, or with a file's bytes where a path is given."""
    raw = read_bytes(document) if isinstance(document, Path) else json.dumps(document, sort_keys=True).encode()
    return hashlib.sha256(raw).hexdigest()[:12]


def tensor_digest(params: Params) -> str:
    """12 hex digits that change with any value of a tree."""
    total = hashlib.sha256()
    for key in sorted(params):
        total.update(key.encode() + params[key].detach().cpu().contiguous().numpy().tobytes())
    return total.hexdigest()[:12]


class RunFolder:
    """A run's folder: `record.jsonl`, one line a task, and `params/<task>.safetensors`.

    Lines are appended, whole or not at all, and what several programs add at once stays. Of a task's lines the last one
    counts, since its parameters are those on disk; the others are removed once they are most of a large file. Lines
    carry the run's key, a digest of all settings; those of another key are another run's: they stay, and count for that
    run alone. A run that was cut off resumes at its first missing task.

    Args:
        path: the folder, made at the first record.
        settings: all that the run's figures depend on.
        entries: of its records, beside the name; a line that lacks one is passed over, with a warning, and its task
            counts as missing.
        origin: what records say beside, such as where inputs were; no figure depends on it.
    """

    def __init__(
        self,
        path: Path,
        settings: Document,
        entries: Collection[str] = (),
        origin: Document | None = None,
    ) -> None:
        self.path = path
        self.origin = {"origin": origin} if origin else {}
        self.settings = settings
        self.key = digest(settings)
        self._entries = ("key", "settings", *entries)
        self._read: tuple[object, dict[str, Document]] = (None, {})
        self._live_bytes = 0  # of the lines that counted when replaced ones were last looked for

    @property
    def file(self) -> Path:
        """The record file."""
        return self.path / "record.jsonl"

    def finished(self) -> dict[str, Document]:
        """Records of this run's key, by task; the file is read again only where it has changed."""
        state = self.file.stat() if self.file.is_file() else None
        stamp = state and (state.st_ino, state.st_size, state.st_mtime_ns)
        if stamp is None or stamp != self._read[0]:
            records = read_records(self.file, self._entries)
            self._read = (stamp, {record["name"]: record for record in records if record["key"] == self.key})
        return dict(self._read[1])

    def add(self, record: Document, theta: dict[str, Tensor] | None = None) -> None:
        """Keep a finished task; its parameters, if it has any, first, so that a record's are always there.

        Numbers that are not finite, which JSON lacks, become None.

        Raises:
            OSError: the disk is full; the record file is as before.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        with locked(self.path):  # another run's parameters of this task must not come between
            if theta is not None:
                tensors = {key: value.detach().cpu().contiguous() for key, value in theta.items()}
                write_atomically(self.params(record["name"]), lambda target: target.write_bytes(save(tensors)))
            whole = {**record, "key": self.key, "settings": self.settings, **self.origin}
            line = json.dumps(as_text(finite(whole)), allow_nan=False)
            append_line(self.file, line.encode(), lambda tail: _parsed(tail) is not None)
            with contextlib.suppress(OSError):  # the record is kept, whatever happens to replaced ones
                self._remove_replaced()

    def _remove_replaced(self) -> None:
        """Remove lines that do not count any more: else a fit repeated n times reads n lines each time."""
        size = self.file.stat().st_size
        if size < max(SMALL_BYTES, 2 * self._live_bytes):
            return
        lines = read_bytes(self.file).split(b"\n")
        tasks = [self._task_of(line) for line in lines]
        last = {task: number for number, task in enumerate(tasks)}
        kept = [line for number, line in enumerate(lines) if tasks[number] is None or last[tasks[number]] == number]
        if 2 * len(kept) < len(lines):
            write_atomically(self.file, lambda target: target.write_bytes(b"\n".join(kept)))
        self._live_bytes = sum(map(len, kept))

    def _task_of(self, line: bytes) -> tuple[str, str] | None:
        """Name and key of a record; None where the line is none."""
        record = _parsed(line)
        return (record["name"], record["key"]) if is_record(record, self._entries) else None

    def params(self, task: str) -> Path:
        """The file of a task's parameters."""
        return _params(self.path, task)

    def theta(self, task: str) -> dict[str, Tensor]:
        """A task's parameters.

        Raises:
            ValueError: their file is missing or damaged.
        """
        return read_theta(self.path, task)


def read_theta(folder: Path, task: str) -> dict[str, Tensor]:
    """A task's parameters in a run's folder.

    Raises:
        ValueError: their file is missing or damaged.
    """
    path = _params(folder, task)
    try:
        return read_tensors(path)
    except (SafetensorError, OSError) as error:
        raise ValueError(
            f"{path}: fitted parameters not readable ({error}); remove record.jsonl in {folder.name} to fit anew."
        ) from None


def _params(folder: Path, task: str) -> Path:
    return folder / "params" / f"{file_name(as_text(task))}.safetensors"


def read_records(path: Path, entries: Collection[str] = ()) -> list[Document]:
    """The records of a file, each task's last one; an absent file counts as empty.

    A line that is no record is passed over with a warning; a last one that was cut off without.

    Args:
        path: the file.
        entries: that they must have, beside a name.
    """
    records: dict[str, Document] = {}
    bad = []
    lines = read_bytes(path).split(b"\n") if path.exists() else []
    for number, line in enumerate(lines, 1):
        record = as_text(_parsed(line))
        if is_record(record, entries):
            # as fits name tasks: in a run of somebody else a name could turn the order of the text beside it
            record["name"] = "".join("_" if unicodedata.category(c) == "Cf" else c for c in record["name"])
            records.pop(record["name"], None)
            records[record["name"]] = record
        elif line.strip() and (record is not None or number < len(lines)):
            bad.append(number)
    if bad:
        which = f"line{'s' if len(bad) > 1 else ''} {', '.join(map(str, bad[:5]))}{', ...' if len(bad) > 5 else ''}"
        warnings.warn(
            f"{path}: {which}: no record, expected one of a task; passed over, as if not there.", stacklevel=2
        )
    return list(records.values())


def is_record(value: object, entries: Collection[str] = ()) -> bool:
    """Test what a line holds, which anybody may have written: a task's record with these entries."""
    if not isinstance(value, dict) or not value.keys() >= {"name", *entries}:
        return False
    numbers = [value[key] for key in FIT if key in value and (key, value[key]) != ("error", None)]
    return (
        all(isinstance(value.get(key, ""), str) for key in TEXTS)
        and all(type(each) in (int, float) and abs(each) <= sys.float_info.max for each in numbers)
        and isinstance(value.get("settings", {}), dict)
    )


def finite(value: object) -> object:
    """A document with None for every number that is not finite."""
    if isinstance(value, dict):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _parsed(line: bytes) -> Any:
    """A line's document; None where it is not JSON."""
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def safe_name(name: str) -> str:
    """A name that can be printed and drawn, of LONGEST bytes at most; others get a digest of what they were.

    Control characters, line ends and bytes that are no text (lone surrogates) become underscores.
    """
    return _marked("".join("_" if unicodedata.category(c)[0] == "C" or c in "\u2028\u2029" else c for c in name), name)


def file_name(task: str) -> str:
    """A task's name as a file name: letters, digits, dot, underscore and hyphen, the rest as underscores.

    It has LONGEST bytes at most; one that differs from the task's name ends with a digest of that.
    """
    return _marked("".join(c if c.isalnum() or c in "._-" else "_" for c in task).lstrip(".") or "task", task)


def _marked(safe: str, name: str) -> str:
    """`safe` where it is the name itself and short, else with a digest of the name."""
    if safe == name and len(safe.encode()) <= LONGEST:
        return safe
    mark = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:6]
    return f"{safe.encode()[: LONGEST - 7].decode(errors='ignore')}-{mark}"


def summary(records: Sequence[Document]) -> dict[str, float | None]:
    """Mean error, as the table prints it, and median inference time of a task, of those that have one."""
    errors = [record["error"] for record in records if record["error"] is not None]
    seconds = [record["seconds"] for record in records if "seconds" in record]
    return {
        "error": statistics.fmean(errors) if errors else None,
        "seconds": statistics.median(seconds) if seconds else None,
    }


def guarded(records: Sequence[Document]) -> int | None:
    """On how many tasks the guard of a learned rule acted; None where fits have none."""
    flags = [record["guarded"] for record in records if "guarded" in record]
    return sum(map(bool, flags)) if flags else None
