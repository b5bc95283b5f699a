"""The folders of fits: each fit has its own, with parameters, pictures and a record, so that many programs can write.

Nothing is locked or appended. A new fit is written under a temporary name, and its folder renamed as a whole; a fit
that was there before is replaced file by file, its record last. What figures and pictures mean is not known here.
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

Record = Document  # the record of a fit: its name, figures and settings
NUMBER_ENTRIES = ("error", "seconds")  # entries of every record that are numbers; the error may be None
CPU_SECONDS = "cpu_seconds"  # a further entry that is a number, which records of earlier versions and of GPUs lack
TEXT_ENTRIES = ("name", "source", "content")  # entries of a record that are texts


def write_fit(
    run_folder: Path, record: Document, theta: Params | None = None, draw: Callable[[Path], None] = lambda folder: None
) -> Document:
    """Write a fit into a folder of its own: its parameters, its pictures and its record, in this order.

    The folder has the name of the task; a digest of the input is added if another input's fit has this name. An earlier
    fit of the same input is replaced. Numbers that are not finite, which JSON lacks, become None.

    Args:
        run_folder: the folder of the run, made if it is missing.
        record: the record of the fit, with `name`, and with `source`, the path of the input, unless the input is the
            task of this name in a data set.
        theta: the parameters; None for a method without parameters.
        draw: a function that writes pictures into the folder that it is given.

    Returns:
        The record as it was written, with the `folder` of the fit; its name has a digest if the folder's name has one.

    Raises:
        OSError: the disk is full; an earlier record stays.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as place:
    ...     kept = write_fit(Path(place), {"name": "gold", "error": 1.5}, {"weight": torch.zeros(2)})
    ...     [record["error"] for record in read_fit_records(Path(place))], read_params(kept["folder"])
    ([1.5], {'weight': tensor([0., 0.])})
    """
    record = {"source": record["name"], **record}
    plain_folder, digest_folder = folders = _candidate_folders(run_folder, record["name"], record["source"])
    earlier_record = _find_record(folders, record["source"])
    folder = Path(earlier_record["folder"]) if earlier_record else partial_path(plain_folder)
    try:
        with name_file_in_errors(plain_folder):
            folder.mkdir(parents=True, exist_ok=True)
            if theta is not None:
                content = save({key: value.detach().cpu().contiguous() for key, value in theta.items()})
                write_bytes(folder / PARAMS, content)
            draw(folder)
            for target in [folder] if earlier_record else [plain_folder, digest_folder]:
                try:
                    return _write_record(record, folder, target, digest_folder)
                except OSError:
                    if earlier_record or not os.path.lexists(target):
                        raise
                    # another program has written a fit of this input since a moment ago: replace it
                    if _find_record(folders, record["source"]):
                        return write_fit(run_folder, record, theta, draw)
        raise ValueError(f"{digest_folder}: no fit of this input, expected one or a new folder; remove it.")
    finally:
        if not earlier_record:
            shutil.rmtree(folder, ignore_errors=True)


def _write_record(record: Document, folder: Path, target: Path, digest_folder: Path) -> Document:
    """Write the record of a fit into its folder, and give the folder its final name.

    Args:
        record: the record.
        folder: the folder that the fit was written to.
        target: the folder that it becomes.
        digest_folder: the folder whose name has a digest; if it is the target, the record gets its name.

    Returns:
        The record as it was written, with the `folder` of the fit.

    Raises:
        OSError: the target is there already, with a fit of another input.
    """
    json_record: Document = to_json_value(record) | ({"name": digest_folder.name} if target == digest_folder else {})
    write_bytes(folder / RECORD, json.dumps(json_record, allow_nan=False, indent=1).encode())
    if folder != target:
        os.rename(folder, target)
    return json_record | {"folder": str(target)}


def _find_record(folders: Iterable[Path], place: str) -> Document | None:
    """Return the record of a fit of an input that one of the folders holds; None if none does."""
    for folder in folders:
        try:
            record = read_fit_record(folder) if folder.is_dir() and not folder.is_symlink() else None
        except ValueError:
            continue
        if record and record.get("source") == to_json_value(place):
            return record
    return None


def _candidate_folders(run_folder: Path, name: str, place: str) -> tuple[Path, Path]:
    """Return the two folders that a fit may lie in: by the name of its task, and by this name with a digest.

    Args:
        run_folder: the folder of the run.
        name: the name of the task.
        place: the path of the input, of which the digest is made.
    """
    plain_name = file_name(to_json_value(name))
    digest = hashlib.sha256(to_json_value(place).encode()).hexdigest()[:6]
    return run_folder / plain_name, run_folder / file_name(f"{plain_name}-{digest}")


def name_with_digest(name: str, place: str) -> str:
    """Return the name of a task, as a file name, with a digest of its input, for a second input of this name.

    >>> name_with_digest("gold", "/brdfs/second/gold.binary")
    'gold-21ab9d'
    """
    return _candidate_folders(Path(), name, place)[1].name


def read_fit_record(folder: Path, entries: Collection[str] = ()) -> Document | None:
    """Read the record in the folder of a fit.

    Args:
        folder: the folder of the fit.
        entries: the entries that the record must have, beside a name.

    Returns:
        The record, with the `folder`; None if the folder has no record.

    Raises:
        ValueError: the file of the record, which anybody may have written, holds something else.
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
    return _mask_format_characters(record) | {"folder": str(folder)}


def _mask_format_characters(record: Document) -> Document:
    """Replace invisible format characters in a record's name, which could turn the direction of the text beside it.

    Names of tasks have none; a record that somebody else wrote may have.
    """
    return {**record, "name": "".join("_" if unicodedata.category(c) == "Cf" else c for c in record["name"])}


def read_fit_records(run_folder: Path, entries: Collection[str] = ()) -> list[Document]:
    """Read the records in the folder of a run; see :func:`read_fit_record`.

    A single warning names the first file that should be a record and is not.

    Args:
        run_folder: the folder of the run.
        entries: the entries that records must have, beside a name.

    Returns:
        The records, in the order of their folders' names.
    """
    records, problems = [], []
    for folder in sorted(run_folder.iterdir()) if run_folder.is_dir() else ():
        try:
            record = None if folder.name.startswith(PARTIAL_PREFIX) else read_fit_record(folder, entries)
        except ValueError as error:
            problems.append(str(error))
        else:
            records += [record] if record else []
    if problems:
        more = f" {len(problems) - 1} more in {run_folder} alike." if len(problems) > 1 else ""
        warnings.warn(f"{problems[0]}{more}", stacklevel=2)
    return records


def is_record(value: object, entries: Collection[str] = ()) -> bool:
    """Test whether a JSON document, which anybody may have written, is the record of a fit.

    Args:
        value: the document.
        entries: the entries that the record must have, beside a name.

    >>> is_record({"name": "gold", "error": 1.5}), is_record({"name": "gold", "error": "low"}), is_record(["gold"])
    (True, False, False)
    """
    if not isinstance(value, dict) or not value.keys() >= {"name", *entries}:
        return False
    keys = (*NUMBER_ENTRIES, CPU_SECONDS)
    numbers = [value[key] for key in keys if key in value and (key, value[key]) != ("error", None)]
    return (
        all(isinstance(value.get(key, ""), str) for key in TEXT_ENTRIES)
        and all(type(number) in (int, float) and abs(number) <= sys.float_info.max for number in numbers)
        and isinstance(value.get("settings", {}), dict)
    )


def read_params(folder: str | Path) -> Params:
    """Read the parameters of a fit.

    Args:
        folder: the folder of the fit, or a file that has the bytes of :func:`pack_fit`.

    Raises:
        ValueError: the file of the parameters is missing or damaged.
    """
    path = Path(folder) if Path(folder).is_file() else Path(folder) / PARAMS
    try:
        return read_tensors(path)
    except (SafetensorError, OSError) as error:
        purpose = "to fit anew" if path.name == PARAMS else "and fit anew"
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"{path}: fitted parameters not readable ({reason}); remove {folder} {purpose}.") from None


def pack_fit(record: Document, theta: Params) -> bytes:
    """Return the bytes of a safetensors file that holds the parameters of a fit, and in its header the record.

    :func:`read_packed_record` reads the record back, :func:`read_params` the parameters.
    """
    text = json.dumps(to_json_value(record), allow_nan=False)
    return save({key: value.detach().cpu().contiguous() for key, value in theta.items()}, {RECORD: text})


def read_packed_record(path: Path, entries: Collection[str] = ()) -> Document:
    """Read the record in a file of one fit, which has the bytes of :func:`pack_fit`.

    Args:
        path: the file.
        entries: the entries that the record must have, beside a name.

    Returns:
        The record, with the file as its `folder`.

    Raises:
        ValueError: the file holds no fit, or is damaged.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "gold.safetensors")
    ...     _ = file.write_bytes(pack_fit({"name": "gold", "error": 1.5}, {"weight": torch.zeros(2)}))
    ...     read_packed_record(file)["error"], read_params(file)
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
    return _mask_format_characters(record) | {"folder": str(path)}


class RunFolder(NamedTuple):
    """The folder of a run's fits, which may hold fits of other settings, too.

    Attributes:
        path: the folder, which need not exist.
        settings: all that figures of the run's fits depend on.
        entries: the entries that records of the fits have, beside the name.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     ten, twenty = (RunFolder(Path(place), {"steps": steps}) for steps in (10, 20))
    ...     record = ten.write({"name": "gold", "error": 1.5, "content": "1a2b"})
    ...     list(ten.records()), list(twenty.records()), ten.matches(record, "1a2b"), twenty.matches(record, "1a2b")
    (['gold'], [], True, False)
    """

    path: Path
    settings: Document
    entries: Collection[str] = ()

    def write(
        self, record: Document, theta: Params | None = None, draw: Callable[[Path], None] = lambda folder: None
    ) -> Document:
        """Write a fit with the settings of the run; see :func:`write_fit`."""
        return write_fit(self.path, {**record, "settings": self.settings}, theta, draw)

    def earlier_record(self, name: str, place: str) -> Document | None:
        """Return the record of an earlier fit of an input, which may have other settings; None if there is none.

        Args:
            name: the name of the task.
            place: the place of the input.
        """
        return _find_record(_candidate_folders(self.path, name, place), place)

    def matches(self, record: Document, content: str | None = None) -> bool:
        """Test whether a record states the settings of this run, and the content of an input.

        Args:
            record: the record.
            content: the digest of the input's content; None if any content will do.
        """
        has_equal_settings = bool(record.get("settings") == to_json_value(self.settings))
        return has_equal_settings and (content is None or record.get("content") == content)

    def records(self) -> dict[str, Document]:
        """Read the records with the settings of this run, by the places of their inputs.

        Fits that were made side by side are left out, since their seconds are shares of their common time.
        """
        records = read_fit_records(self.path, ("source", "settings", *self.entries))
        single_fits = [record for record in records if record.get("batch", 1) == 1 and self.matches(record)]
        return {record["source"]: record | {"name": record["source"]} for record in single_fits}


def summary(records: Sequence[Document]) -> dict[str, float | None]:
    """Summarise records: the mean error in the unit of tables, and the median inference time of a task in seconds.

    Records without an error or a time are left out. Fits of photos without a reference have the mean of `photo_error`,
    too.

    >>> summary([{"error": 1.0, "seconds": 0.5}, {"error": 3.0, "seconds": 0.7}, {"error": None}])
    {'error': 2.0, 'seconds': 0.6}
    """
    photo_errors = [record["photo_error"] for record in records if record.get("photo_error") is not None]
    errors = [record["error"] for record in records if record["error"] is not None]
    seconds = [record["seconds"] for record in records if "seconds" in record]
    return {
        "error": statistics.fmean(errors) if errors else None,
        **({"photo_error": statistics.fmean(photo_errors)} if photo_errors else {}),
        "seconds": statistics.median(seconds) if seconds else None,
    }


def count_guarded(records: Sequence[Document]) -> int | None:
    """Count the tasks on which the guard of a learned rule acted; None if the fits had no guard.

    >>> count_guarded([{"guarded": True}, {"guarded": False}]), count_guarded([{}])
    (1, None)
    """
    flags = [record["guarded"] for record in records if "guarded" in record]
    return sum(map(bool, flags)) if flags else None
