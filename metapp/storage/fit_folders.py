"""The folders of fits: each fit has its own, with parameters, pictures and a record, so that many programs can write.

Nothing is locked or appended. A new fit is written under a temporary name, and its folder renamed as a whole; a fit
that was there before is replaced file by file, its record last. What a record states is not known here, but for the
name of the fit and its source, by which it is told whose fit a folder holds.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

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
from metapp.storage.folders import PARAMS as PARAMS
from metapp.storage.folders import RECORD as RECORD
from metapp.storage.folders import FolderKind, mark_folder, read_json


def write_fit_folder(
    run_folder: Path,
    name: str,
    source: str,
    encode: Callable[[str], bytes],
    theta: Params | None = None,
    draw: Callable[[Path], object] = lambda folder: None,
) -> Path:
    """Write a fit into a folder of its own: its parameters, its pictures and its record, in this order.

    The folder has the name of the fit; a digest of the source is added if the fit of another source has this name. An
    earlier fit of the same source is replaced.

    Args:
        run_folder: the folder of the run, made if it is missing.
        name: the name of the fit.
        source: the path of what was fitted, or its name in a data set.
        encode: a function that returns the record, a JSON object with this `source`, of a fit that has the name that it
            is given: the name of the folder if that has a digest.
        theta: the parameters; None for a method without parameters.
        draw: a function that writes pictures into the folder that it is given.

    Returns:
        The folder of the fit.

    Raises:
        OSError: the disk is full; an earlier record stays.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as place:
    ...     record = b'{"name": "gold", "source": "/gold.binary"}'
    ...     folder = write_fit_folder(Path(place), "gold", "/gold.binary", lambda name: record, {"w": torch.zeros(2)})
    ...     folder.name, read_params(folder)
    ('gold', {'w': tensor([0., 0.])})
    """
    plain_folder, digest_folder = folders = _candidate_folders(run_folder, name, source)
    earlier = _find_folder(folders, source)
    folder = earlier or partial_path(plain_folder)
    try:
        with name_file_in_errors(plain_folder):
            mark_folder(run_folder, FolderKind.RUN)
            folder.mkdir(exist_ok=True)
            if theta is not None:
                content = save({key: value.detach().cpu().contiguous() for key, value in theta.items()})
                write_bytes(folder / PARAMS, content)
            draw(folder)
            for target in [folder] if earlier else folders:
                try:
                    write_bytes(folder / RECORD, encode(target.name if target == digest_folder else name))
                    if folder != target:
                        os.rename(folder, target)
                    return target
                except OSError:
                    if earlier or not os.path.lexists(target):
                        raise
                    # another program has written a fit of this source since a moment ago: replace it
                    if _find_folder(folders, source):
                        return write_fit_folder(run_folder, name, source, encode, theta, draw)
        raise ValueError(f"{digest_folder}: no fit of this input, expected one or a new folder; remove it.")
    finally:
        if not earlier:
            shutil.rmtree(folder, ignore_errors=True)


def find_fit_folder(run_folder: Path, name: str, source: str) -> Path | None:
    """Return the folder that holds the fit of a source; None if the run has none.

    Args:
        run_folder: the folder of the run.
        name: the name of the fit.
        source: the path of what was fitted, or its name in a data set.
    """
    return _find_folder(_candidate_folders(run_folder, name, source), source)


def fit_folders(run_folder: Path) -> list[Path]:
    """Return the folders in a run's folder that have a record, sorted by name, without unfinished ones."""
    folders = sorted(run_folder.iterdir()) if run_folder.is_dir() else []
    return [folder for folder in folders if not folder.name.startswith(PARTIAL_PREFIX) and (folder / RECORD).is_file()]


def _find_folder(folders: Iterable[Path], source: str) -> Path | None:
    """Return the one of some folders that holds the fit of a source; None if none does."""
    for folder in folders:
        record = read_json(str(folder / RECORD)) if folder.is_dir() and not folder.is_symlink() else None
        if isinstance(record, dict) and record.get("source", record.get("name")) == to_json_value(source):
            return folder
    return None


def _candidate_folders(run_folder: Path, name: str, source: str) -> tuple[Path, Path]:
    """Return the two folders that a fit may lie in: by its name, and by its name with a digest of its source."""
    return run_folder / file_name(to_json_value(name)), run_folder / name_with_digest(name, source)


def name_with_digest(name: str, source: str) -> str:
    """Return the name of a fit, as a file name, with a digest of its source, for a second fit of this name.

    >>> name_with_digest("gold", "/brdfs/second/gold.binary")
    'gold-21ab9d'
    """
    digest = hashlib.sha256(str(to_json_value(source)).encode()).hexdigest()[:6]
    return file_name(f"{file_name(to_json_value(name))}-{digest}")


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


def pack_fit(record: bytes, theta: Params) -> bytes:
    """Return the bytes of a safetensors file that holds the parameters of a fit, and in its header the record.

    :func:`read_packed_record` reads the record back, :func:`read_params` the parameters.
    """
    tensors = {key: value.detach().cpu().contiguous() for key, value in theta.items()}
    return save(tensors, {RECORD: record.decode()})


def read_record(place: Path) -> bytes | None:
    """Read the record in the folder of a fit, or in a file that has the bytes of :func:`pack_fit`.

    Returns:
        The record; None if the folder has none.

    Raises:
        ValueError: the file holds no fit, or is damaged.

    >>> import tempfile, torch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "gold.safetensors")
    ...     _ = file.write_bytes(pack_fit(b'{"name": "gold"}', {"weight": torch.zeros(2)}))
    ...     read_record(file), read_params(file)
    (b'{"name": "gold"}', {'weight': tensor([0., 0.])})
    """
    if place.is_file():
        try:
            with open_tensors(place) as stored:
                return str((stored.metadata() or {})[RECORD]).encode()
        except (SafetensorError, OSError, ValueError, KeyError):
            raise ValueError(
                f"{place}: no fit, expected a file of Fit.save or a folder of a fit, such as runs/brdf/meta/gold."
            ) from None
    try:
        return read_bytes(place / RECORD)
    except (FileNotFoundError, NotADirectoryError):
        return None
