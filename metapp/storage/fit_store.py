"""The folders of fits: each fit has its own, with parameters, pictures and a record, so that many programs can write.

Nothing is locked or appended. A new fit is written under a temporary name, and its folder renamed as a whole; a fit
that was there before is replaced file by file, its record last. What figures and pictures mean is not known here.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import warnings
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace
from safetensors import SafetensorError
from safetensors.torch import save

from metapp.learning.task import Params
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
from metapp.storage.fit_records import FitRecord, Settings, decode_record, encode_record
from metapp.storage.folders import PARAMS as PARAMS
from metapp.storage.folders import RECORD as RECORD
from metapp.storage.folders import FolderKind, mark_folder


def write_fit(
    run_folder: Path, record: FitRecord, theta: Params | None = None, draw: Callable[[Path], None] = lambda folder: None
) -> FitRecord:
    """Write a fit into a folder of its own: its parameters, its pictures and its record, in this order.

    The folder has the name of the task; a digest of the input is added if another input's fit has this name. An earlier
    fit of the same input is replaced. Numbers that are not finite, which JSON lacks, become None.

    Args:
        run_folder: the folder of the run, made if it is missing.
        record: the record of the fit, with `source`, the path of the input, unless the input is the task of this name
            in a data set.
        theta: the parameters; None for a method without parameters.
        draw: a function that writes pictures into the folder that it is given.

    Returns:
        The record as it was written, with the `folder` of the fit; its name has a digest if the folder's name has one.

    Raises:
        OSError: the disk is full; an earlier record stays.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as place:
    ...     kept = write_fit(Path(place), FitRecord(name="gold", error=1.5), {"weight": torch.zeros(2)})
    ...     [record.error for record in read_fit_records(Path(place))], read_params(kept.folder)
    ([1.5], {'weight': tensor([0., 0.])})
    """
    record = replace(record, source=record.source or record.name)
    plain_folder, digest_folder = folders = _candidate_folders(run_folder, record.name, record.source)
    earlier_record = _find_record(folders, record.source)
    folder = Path(earlier_record.folder) if earlier_record else partial_path(plain_folder)
    try:
        with name_file_in_errors(plain_folder):
            mark_folder(run_folder, FolderKind.RUN)
            folder.mkdir(exist_ok=True)
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
                    if _find_record(folders, record.source):
                        return write_fit(run_folder, record, theta, draw)
        raise ValueError(f"{digest_folder}: no fit of this input, expected one or a new folder; remove it.")
    finally:
        if not earlier_record:
            shutil.rmtree(folder, ignore_errors=True)


def _write_record(record: FitRecord, folder: Path, target: Path, digest_folder: Path) -> FitRecord:
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
    content = encode_record(replace(record, name=digest_folder.name) if target == digest_folder else record)
    write_bytes(folder / RECORD, content)
    if folder != target:
        os.rename(folder, target)
    return replace(decode_record(content), folder=str(target))


def _find_record(folders: Iterable[Path], place: str) -> FitRecord | None:
    """Return the record of a fit of an input that one of the folders holds; None if none does."""
    for folder in folders:
        try:
            record = read_fit_record(folder) if folder.is_dir() and not folder.is_symlink() else None
        except ValueError:
            continue
        if record and record.source == to_json_value(place):
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


def read_fit_record(folder: Path, *, figures: Collection[str] = (), timed: bool = False) -> FitRecord | None:
    """Read the record in the folder of a fit.

    Args:
        folder: the folder of the fit.
        figures: the names of figures that the record must have.
        timed: whether it must have seconds.

    Returns:
        The record, with the `folder`; None if the folder has no record.

    Raises:
        ValueError: the file of the record, which anybody may have written, holds something else.
    """
    file = folder / RECORD
    try:
        return replace(decode_record(read_bytes(file), figures=figures, timed=timed), folder=str(folder))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (ValueError, OSError) as error:
        reason = str(error).removeprefix("no record: ").replace(str(file), "").strip(": ")
        raise ValueError(f"{file}: no record, expected one of a task ({reason}); fit again.") from None


def read_fit_records(
    run_folder: Path,
    *,
    figures: Collection[str] = (),
    timed: bool = False,
    check: Callable[[FitRecord], object] = lambda record: None,
) -> list[FitRecord]:
    """Read the records in the folder of a run; see :func:`read_fit_record`.

    A single warning names the first file that should be a record and is not.

    Args:
        run_folder: the folder of the run.
        figures: the names of figures that records must have.
        timed: whether they must have seconds.
        check: a function that raises ValueError for a record that the caller cannot use, which is passed over, too.

    Returns:
        The records, in the order of their folders' names.
    """
    records, problems = [], []
    for folder in sorted(run_folder.iterdir()) if run_folder.is_dir() else ():
        is_partial = folder.name.startswith(PARTIAL_PREFIX)
        try:
            record = None if is_partial else read_fit_record(folder, figures=figures, timed=timed)
            if record:
                check(record)
                records.append(record)
        except ValueError as error:
            problems.append(f"{str(error).removesuffix('; fit again.')}; passed over, as if not there.")
    if problems:
        more = f" {len(problems) - 1} more in {run_folder} alike." if len(problems) > 1 else ""
        warnings.warn(f"{problems[0]}{more}", stacklevel=2)
    return records


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


def pack_fit(record: FitRecord, theta: Params) -> bytes:
    """Return the bytes of a safetensors file that holds the parameters of a fit, and in its header the record.

    :func:`read_packed_record` reads the record back, :func:`read_params` the parameters.
    """
    tensors = {key: value.detach().cpu().contiguous() for key, value in theta.items()}
    return save(tensors, {RECORD: encode_record(record).decode()})


def read_packed_record(path: Path) -> FitRecord:
    """Read the record in a file of one fit, which has the bytes of :func:`pack_fit`.

    Returns:
        The record, with the file as its `folder`.

    Raises:
        ValueError: the file holds no fit, or is damaged.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "gold.safetensors")
    ...     _ = file.write_bytes(pack_fit(FitRecord(name="gold", error=1.5, seconds=0.1), {"weight": torch.zeros(2)}))
    ...     read_packed_record(file).error, read_params(file)
    (1.5, {'weight': tensor([0., 0.])})
    """
    try:
        with open_tensors(path) as stored:
            text = (stored.metadata() or {})[RECORD]
    except (SafetensorError, OSError, ValueError, KeyError):
        raise ValueError(
            f"{path}: no fit, expected a file of Fit.save or a folder of a fit, such as runs/brdf/meta/gold."
        ) from None
    try:
        return replace(decode_record(text, timed=True), folder=str(path))
    except ValueError as error:
        reason = str(error).removeprefix("no record: ")
        raise ValueError(f"{path}: no record, expected one of a fit ({reason}); fit again.") from None


class FitStore(NamedTuple):
    """The folder of a run's fits, which may hold fits of other settings, too.

    Attributes:
        path: the folder, which need not exist.
        settings: all that figures of the run's fits depend on.
        figures: the names of figures that records of the fits have.
        timed: whether records of the fits have seconds.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     ten, twenty = (FitStore(Path(place), Settings(steps=steps)) for steps in (10, 20))
    ...     record = ten.write(FitRecord(name="gold", error=1.5, content="1a2b"))
    ...     list(ten.records()), list(twenty.records()), ten.find("gold", "gold", "1a2b") == record
    (['gold'], [], True)
    """

    path: Path
    settings: Settings
    figures: Collection[str] = ()
    timed: bool = False

    def write(
        self, record: FitRecord, theta: Params | None = None, draw: Callable[[Path], None] = lambda folder: None
    ) -> FitRecord:
        """Write a fit with the settings of the run; see :func:`write_fit`."""
        return write_fit(self.path, replace(record, settings=self.settings), theta, draw)

    def holds(self, name: str, place: str) -> bool:
        """Test whether there is a fit of an input, which may have other settings.

        Args:
            name: the name of the task.
            place: the place of the input.
        """
        return _find_record(_candidate_folders(self.path, name, place), place) is not None

    def find(self, name: str, place: str, content: str) -> FitRecord | None:
        """Return the record of a fit of an input by the settings of this run; None if there is none.

        Args:
            name: the name of the task.
            place: the place of the input.
            content: the digest of the task's values.
        """
        record = _find_record(_candidate_folders(self.path, name, place), place)
        return record if record and record.content == content and record.has_settings(self.settings) else None

    def records(self) -> dict[str, FitRecord]:
        """Read the records with the settings of this run, by the places of their inputs.

        Fits that were made side by side are left out, since their seconds are shares of a batch's time.
        """
        records = read_fit_records(self.path, figures=self.figures, timed=self.timed)
        matching = [record for record in records if record.batch == 1 and record.has_settings(self.settings)]
        return {record.source: replace(record, name=record.source) for record in matching}
