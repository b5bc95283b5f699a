"""Fits on disk: a folder each, with parameters, pictures and a record, so that any number of programs write at once.

Nothing is locked or appended: a new fit is written under a temporary name and its folder renamed as a whole, one that
was there before is replaced file by file, its record last.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import statistics
import sys
import unicodedata
import warnings
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from safetensors import SafetensorError
from safetensors.torch import save

from metapp.learning.task import Params
from metapp.storage import Document
from metapp.storage.files import (
    PARTIAL_PREFIX,
    file_name,
    name_file_in_errors,
    open_tensors,
    partial_path,
    read_bytes,
    read_tensors,
    to_json_value,
    write_bytes,
)
from metapp.storage.folders import PARAMS as PARAMS
from metapp.storage.folders import RECORD as RECORD

Record = Document  # of a task
NUMBER_ENTRIES = ("error", "seconds")  # entries of a fit's record, beside its name
TEXT_ENTRIES = ("name", "source", "content")  # entries that are texts, where a record has them


def write_fit(
    run_folder: Path, record: Document, theta: Params | None = None, draw: Callable[[Path], None] = lambda folder: None
) -> Document:
    """Keep a finished task: its parameters, its pictures and its record, in this order, in a folder of its own.

    The folder has the task's name, with a digest of the input if another input has taken that. A fit of the same
    input that is there is replaced. Numbers that are not finite, which JSON lacks, become None.

    Args:
        run_folder: of a run, made if missing.
        record: with `name`, and `source`, the input's path, unless it has the same name in a data set.
        theta: the parameters, if there are any.
        draw: writes pictures into the folder that it is given.

    Returns:
        The record as it is kept, with the task's `folder`; its name is the folder's if that has a digest.

    Raises:
        OSError: the disk is full; a record that was there stays.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as place:
    ...     kept = write_fit(Path(place), {"name": "gold", "error": 1.5}, {"weight": torch.zeros(2)})
    ...     [record["error"] for record in read_fits(Path(place))], read_params(kept["folder"])
    ([1.5], {'weight': tensor([0., 0.])})
    """
    record = {"source": record["name"], **record}
    plain, marked = folders = _folders(run_folder, record["name"], record["source"])
    earlier = _fit_in(folders, record["source"])
    folder = Path(earlier["folder"]) if earlier else partial_path(plain)
    try:
        with name_file_in_errors(plain):
            folder.mkdir(parents=True, exist_ok=True)
            if theta is not None:
                content = save({key: value.detach().cpu().contiguous() for key, value in theta.items()})
                write_bytes(folder / PARAMS, content)
            draw(folder)
            for target in [folder] if earlier else [plain, marked]:
                try:
                    return _record_as(record, folder, target, marked)
                except OSError:
                    if earlier or not os.path.lexists(target):
                        raise
                    if _fit_in(folders, record["source"]):  # of another program, since a moment ago
                        return write_fit(run_folder, record, theta, draw)
        raise ValueError(f"{marked}: no fit of this input, expected one or a new folder; remove it.")
    finally:
        if not earlier:
            shutil.rmtree(folder, ignore_errors=True)


def _record_as(record: Document, folder: Path, target: Path, marked: Path) -> Document:
    """Write a record into a folder, which is then renamed; OSError if the target is another fit's."""
    kept: Document = to_json_value(record) | ({"name": marked.name} if target == marked else {})
    write_bytes(folder / RECORD, json.dumps(kept, allow_nan=False, indent=1).encode())
    if folder != target:
        os.rename(folder, target)
    return kept | {"folder": str(target)}


def _fit_in(folders: Iterable[Path], source: str) -> Document | None:
    for folder in folders:
        try:
            record = read_fit_record(folder) if folder.is_dir() and not folder.is_symlink() else None
        except ValueError:
            continue
        if record and record.get("source") == to_json_value(source):
            return record
    return None


def _folders(run_folder: Path, name: str, source: str) -> tuple[Path, Path]:
    """The folders that a fit may be in: that of the task's name, and that with a digest of its input."""
    plain, digest = file_name(to_json_value(name)), hashlib.sha256(to_json_value(source).encode()).hexdigest()[:6]
    return run_folder / plain, run_folder / file_name(f"{plain}-{digest}")


def name_with_digest(name: str, source: str) -> str:
    """The name of a task, as a file name, with a digest of its input, for a second input of that name.

    >>> marked_name("gold", "/brdfs/second/gold.binary")
    'gold-21ab9d'
    """
    return _folders(Path(), name, source)[1].name


def read_fit_record(folder: Path, entries: Collection[str] = ()) -> Document | None:
    """The record in a task's folder, with the `folder`; None if there is none.

    Args:
        folder: the task's.
        entries: that the record must have, beside a name.

    Raises:
        ValueError: there is one, which anybody may have written, of another form.
    """
    file = folder / RECORD
    try:
        stored = json.loads(read_bytes(file))
        record = to_json_value(stored) if is_record(stored, entries) else None
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (ValueError, RecursionError, OSError):
        record = None
    if record is None:
        raise ValueError(f"{file}: no record, expected one of a task; passed over, as if not there.")
    return _shown(record) | {"folder": str(folder)}


def _shown(record: Document) -> Document:
    """A record whose name is as fits name tasks: in a run of somebody else it could turn the text beside it."""
    return {**record, "name": "".join("_" if unicodedata.category(c) == "Cf" else c for c in record["name"])}


def read_fit_records(run_folder: Path, entries: Collection[str] = ()) -> list[Document]:
    """The records in a run's folder, by name, as `read_fit_record` gives them; one warning names the first that is none."""
    records, damaged = [], []
    for folder in sorted(run_folder.iterdir()) if run_folder.is_dir() else ():
        try:
            record = None if folder.name.startswith(PARTIAL_PREFIX) else read_fit_record(folder, entries)
        except ValueError as error:
            damaged.append(str(error))
        else:
            records += [record] if record else []
    if damaged:
        more = f" {len(damaged) - 1} more in {run_folder} alike." if len(damaged) > 1 else ""
        warnings.warn(f"{damaged[0]}{more}", stacklevel=2)
    return records


def is_record(value: object, entries: Collection[str] = ()) -> bool:
    """True if a document, which anybody may have written, is a task's record with these entries.

    >>> is_record({"name": "gold", "error": 1.5}), is_record({"name": "gold", "error": "low"}), is_record(["gold"])
    (True, False, False)
    """
    if not isinstance(value, dict) or not value.keys() >= {"name", *entries}:
        return False
    numbers = [value[key] for key in NUMBER_ENTRIES if key in value and (key, value[key]) != ("error", None)]
    return (
        all(isinstance(value.get(key, ""), str) for key in TEXT_ENTRIES)
        and all(type(each) in (int, float) and abs(each) <= sys.float_info.max for each in numbers)
        and isinstance(value.get("settings", {}), dict)
    )


def read_params(folder: str | Path) -> Params:
    """The parameters in a task's folder, or in a file of `pack_fit`.

    Raises:
        ValueError: their file is missing or damaged.
    """
    path = Path(folder) if Path(folder).is_file() else Path(folder) / PARAMS
    try:
        return read_tensors(path)
    except (SafetensorError, OSError) as error:
        again = "to fit anew" if path.name == PARAMS else "and fit anew"
        raise ValueError(f"{path}: fitted parameters not readable ({error}); remove {folder} {again}.") from None


def pack_fit(record: Document, theta: Params) -> bytes:
    """A fit as one file of safetensors, whose header holds the record; `read_packed_record` reads that."""
    text = json.dumps(to_json_value(record), allow_nan=False)
    return save({key: value.detach().cpu().contiguous() for key, value in theta.items()}, {RECORD: text})


def read_packed_record(path: Path, entries: Collection[str] = ()) -> Document:
    """The record in a file of one fit, as `pack_fit` makes it, with the file as its `folder`.

    Args:
        path: of the file.
        entries: that the record must have, beside a name.

    Raises:
        ValueError: the file is none, or damaged.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "gold.safetensors")
    ...     _ = file.write_bytes(packed({"name": "gold", "error": 1.5}, {"weight": torch.zeros(2)}))
    ...     read_packed(file)["error"], read_params(file)
    (1.5, {'weight': tensor([0., 0.])})
    """
    try:
        with open_tensors(path) as stored:
            record = to_json_value(json.loads((stored.metadata() or {})[RECORD]))
    except (SafetensorError, OSError, ValueError, KeyError, RecursionError):
        record = None
    if not is_record(record, entries):
        raise ValueError(
            f"{path}: no fit, expected a file of Fit.save or a folder of a fit, such as runs/brdf/meta/gold."
        )
    return _shown(record) | {"folder": str(path)}


class RunFolder(NamedTuple):
    """The folder of a run's fits, which may hold fits of other settings, too.

    Attributes:
        path: of the folder, which need not be there.
        settings: all that figures of the run's fits depend on.
        entries: the entries of their records, beside the name.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     ten, twenty = (RunFolder(Path(place), {"steps": steps}) for steps in (10, 20))
    ...     record = ten.write({"name": "gold", "error": 1.5, "content": "1a2b"})
    ...     list(ten.records()), list(twenty.records()), ten.holds(record, "1a2b"), twenty.holds(record, "1a2b")
    (['gold'], [], True, False)
    """

    path: Path
    settings: Document
    entries: Collection[str] = ()

    def write(
        self, record: Document, theta: Params | None = None, draw: Callable[[Path], None] = lambda folder: None
    ) -> Document:
        """Keep a finished task with the settings; see :func:`write_fit`."""
        return write_fit(self.path, {**record, "settings": self.settings}, theta, draw)

    def earlier(self, name: str, source: str) -> Document | None:
        """Return the record of the fit of an input, of whatever settings; None if there is none.

        Args:
            name: of the task.
            source: the input's place.
        """
        return _fit_in(_folders(self.path, name, source), source)

    def holds(self, record: Document, content: str | None = None) -> bool:
        """Return whether a record is of these settings, and, if a digest is given, of an input of this content."""
        is_same = bool(record.get("settings") == to_json_value(self.settings))
        return is_same and (content is None or record.get("content") == content)

    def records(self) -> dict[str, Document]:
        """Return the records of these settings, by their sources; none of fits whose seconds are a batch's shares."""
        records = read_fit_records(self.path, ("source", "settings", *self.entries))
        alone = [record for record in records if record.get("batch", 1) == 1 and self.holds(record)]
        return {record["source"]: record | {"name": record["source"]} for record in alone}


def summary(records: Sequence[Document]) -> dict[str, float | None]:
    """Mean error, as the table prints it, and median inference time of a task, of those that have one.

    Of photos without a reference there is the mean of `photo_error`, too.

    >>> summary([{"error": 1.0, "seconds": 0.5}, {"error": 3.0, "seconds": 0.7}, {"error": None}])
    {'error': 2.0, 'seconds': 0.6}
    """
    of_photos = [record["photo_error"] for record in records if record.get("photo_error") is not None]
    errors = [record["error"] for record in records if record["error"] is not None]
    seconds = [record["seconds"] for record in records if "seconds" in record]
    return {
        "error": statistics.fmean(errors) if errors else None,
        **({"photo_error": statistics.fmean(of_photos)} if of_photos else {}),
        "seconds": statistics.median(seconds) if seconds else None,
    }


def count_guarded(records: Sequence[Document]) -> int | None:
    """On how many tasks the guard of a learned rule acted; None if fits have none.

    >>> guarded([{"guarded": True}, {"guarded": False}]), guarded([{}])
    (1, None)
    """
    flags = [record["guarded"] for record in records if "guarded" in record]
    return sum(map(bool, flags)) if flags else None
