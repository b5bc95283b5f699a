"""Data sets on disk: a folder with one safetensors file per task (a shard) and a `manifest.json` that lists them.

Anybody may have written the files: nothing is unpickled, no path in a manifest leads out of its folder, and every field
is checked. What the tensors mean to an application is not known here.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Collection, Generator, Iterable, Mapping
from pathlib import Path

import msgspec
import torch
from msgspec.structs import asdict, replace
from safetensors import SafetensorError
from safetensors.torch import save

from metapp.learning.task import Task, TensorSpec, problems_of
from metapp.storage import Document
from metapp.storage.files import (
    file_name,
    name_file_in_errors,
    open_regular,
    partial_path,
    read_bytes,
    read_tensors,
    remove_partial,
    to_json_value,
    write_bytes,
)
from metapp.storage.folders import MANIFEST as MANIFEST
from metapp.storage.folders import SHARD_SUFFIX

MANIFEST_SCHEMA = 1  # the version of the layout of manifests
SPLITS = ("train", "test")
AUTO_SPLIT = "auto"  # stands for the split that `split_auto` chooses


class ManifestEntry(msgspec.Struct, frozen=True):
    """One task in a manifest, whose file may be still to write.

    Attributes:
        name: the name of the task, as tables print it.
        file: the name of the task's file in the folder.
        split: "train" or "test"; "" before the file is written, if :func:`split_auto` is to choose.
        source: the base name of the file or folder that the task was made of; "" if there is none.
        sha256: the SHA-256 digest of the file's bytes, 64 hexadecimal digits.
        group: the name of a thing that several tasks show, which all get one split; "" if no other task shows it.
    """

    name: str
    file: str = ""
    split: str = ""
    source: str = ""
    sha256: str = ""
    group: str = ""


class Manifest(msgspec.Struct, frozen=True):
    """The content of a data set.

    Attributes:
        app: the name of the application that its tasks belong to.
        tasks: the entries of its tasks, in the order in which they were written.
        units: unit and meaning of each tensor, by the tensor's name.
        notes: anything else worth knowing, such as converter and seed.
        schema: the version of the manifest's layout.
    """

    app: str
    tasks: tuple[ManifestEntry, ...]
    units: dict[str, str]
    notes: Document
    schema: int = MANIFEST_SCHEMA


class _Schema(msgspec.Struct):
    """The part of a manifest that is read first: the other parts of newer manifests may differ."""

    schema: int


def read_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of a data set.

    Raises:
        ValueError: there is no such folder or no manifest in it, or the manifest is damaged, is of a newer version, or
            has file names that lead out of the folder.
    """
    folder = Path(folder)
    path = folder / MANIFEST
    if not folder.is_dir():
        state = "a file" if folder.exists() else "no such folder"
        raise ValueError(f"{folder}: {state}, expected the folder of a data set; make one with `metapp data`.")
    if not path.is_file():
        raise ValueError(
            f"{folder}: no {MANIFEST}, expected one beside the tasks; this is not a data set, or its conversion was "
            "interrupted: convert again with `metapp data`."
        )
    content = read_bytes(path)
    try:
        if (schema := msgspec.json.decode(content, type=_Schema).schema) > MANIFEST_SCHEMA:
            found = f"schema {schema}, written by a newer metapp"
            raise ValueError(f"{path}: {found}, expected {MANIFEST_SCHEMA}; update metapp.")
        manifest = msgspec.json.decode(content, type=Manifest)
        fault = _fault_of_manifest(manifest)
    except (msgspec.MsgspecError, RecursionError) as error:
        fault = f"damaged, expected the manifest of a data set ({error})"
    if fault:
        raise ValueError(f"{path}: {fault}; convert the data again.")
    return manifest


def fingerprint(folder: str | Path) -> str:
    """Return 12 hexadecimal digits of a data set's content, which do not depend on where and when it was converted.

    They change with the application, the tasks' names, the splits and the files' digests as the manifest states them;
    not with notes or the order of tasks.

    Raises:
        ValueError: the manifest cannot be read, see :func:`read_manifest`.
    """
    manifest = read_manifest(folder)
    content = [manifest.app, sorted([entry.name, entry.split, entry.sha256] for entry in manifest.tasks)]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:12]


def _fault_of_manifest(manifest: Manifest) -> str:
    """Return what is wrong with a manifest that anybody may have written, and what was expected; "" for nothing."""
    if manifest.schema != MANIFEST_SCHEMA:
        return f"schema {manifest.schema}, expected {MANIFEST_SCHEMA}"
    for entry in manifest.tasks:
        if entry.file != f"{file_name(entry.file.removesuffix(SHARD_SUFFIX))}{SHARD_SUFFIX}":
            return f"file {entry.file!a:.200}, expected the plain name of a {SHARD_SUFFIX} file in the same folder"
        if entry.split not in SPLITS:
            return f"split {entry.split!a:.200}, expected 'train' or 'test'"
    for key in ("name", "file"):
        if len({getattr(entry, key) for entry in manifest.tasks}) < len(manifest.tasks):
            return f"two tasks have the same {key}, expected them to differ"
    return ""


def split_auto(names: Iterable[str]) -> dict[str, str]:
    """Choose splits by the rule that the documentation states: every fifth name is for tests, all others for training.

    Args:
        names: names of tasks and of groups. :func:`write_data_set` sorts them, so that neither a seed nor the order of
            files counts.

    Returns:
        The split, "train" or "test", by name.

    >>> "".join(name for name, split in split_auto("abcdefghijk").items() if split == "test")
    'ej'
    """
    return {name: "test" if index % 5 == 4 else "train" for index, name in enumerate(dict.fromkeys(names))}


def write_data_set(
    folder: str | Path,
    app: str,
    units: Mapping[str, str],
    tasks: Iterable[tuple[Task, str, str | Path]],
    notes: Mapping[str, object] | None = None,
    beside: tuple[str, str] | None = None,
    *,
    overwrite: bool = False,
) -> list[ManifestEntry]:
    """Write a data set, all or nothing.

    Files are written into a folder with a temporary name. They move to their place at the end, and the manifest moves
    last. If the iterator of tasks raises an error, the folder stays as it was.

    Args:
        folder: the folder of the data set, made if it is missing.
        app: the name of the application that the tasks belong to.
        units: unit and meaning of every tensor, by name; the manifest has the units of tensors that a task holds.
        tasks: for each task the task, its split and its source. The split is "train", "test", or "auto", for which
            :func:`split_auto` chooses among the names of all such tasks and groups. The source is the file or folder
            that the task was made of, whose base name is kept; "" for none.
        notes: anything else worth keeping, JSON-ready.
        beside: the name of a tensor that holds the bytes of a text, which is written as a file beside each task, and
            the suffix of this file; None for no such text.
        overwrite: whether a data set of an equal application that is in the folder is replaced as a whole.

    Returns:
        The entries of the manifest.

    Raises:
        ValueError: the folder is a file or holds another data set (this is found before the first task is asked for),
            there is no task, a split is unknown, a name is empty or occurs twice, a task has no tensors, a tensor has
            no unit, or a value is not finite.

    >>> import tempfile
    >>> gold = Task("gold", {"angles": torch.zeros(2, 3)})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     (entry,) = write_data_set(folder, "brdf", {"angles": "rad"}, [(gold, "train", "brdfs/gold.binary")])
    ...     entry.source, read_data_set(folder)[0].data["angles"].shape
    ('gold.binary', torch.Size([2, 3]))
    """
    folder, notes = Path(folder), dict(notes or {})
    # a note that JSON cannot hold is refused now, rather than after an hour of converting
    try:
        json.dumps(notes, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{folder}: notes hold {error}; expected plain text, numbers, lists.") from None
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: a file, expected a folder to write to; choose another one.")
    _require_replaceable(folder, app, overwrite)
    remove_partial(folder)
    partial = partial_path(folder / "tasks")
    new_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    partial.mkdir(parents=True)
    entries: list[ManifestEntry] = []
    names: set[str] = set()
    tensor_names: set[str] = set()
    # the text beside a task "manifest" would take the name of the manifest
    file_names = {MANIFEST.replace(".json", SHARD_SUFFIX)} if beside else set()
    try:
        for task, split, source in tasks:
            _check_task(task, split, units, names, source or folder)
            names.add(to_json_value(task.name))
            tensor_names |= set(task.data)
            # each tensor is copied, since safetensors refuses tensors that share memory
            layout = torch.contiguous_format
            content = save(
                {key: tensor.detach().cpu().clone(memory_format=layout) for key, tensor in task.data.items()}
            )
            file = _shard_name(task.name, file_names)
            file_names.add(file.lower())
            with name_file_in_errors(folder / file):
                (partial / file).write_bytes(content)
                if beside:
                    text = task.data[beside[0]].cpu().numpy().tobytes().rstrip() + b"\n"
                    (partial / file).with_suffix(beside[1]).write_bytes(text)
            base_name = re.split(r"[/\\]", str(source).rstrip("/\\"))[-1]
            digest = hashlib.sha256(content).hexdigest()
            entries.append(ManifestEntry(task.name, file, split, base_name, digest, task.group))
        if not entries:
            raise ValueError(f"{folder}: 0 tasks to write, expected at least one.")
        split_by_name = split_auto(sorted(entry.group or entry.name for entry in entries if entry.split == AUTO_SPLIT))
        entries = [
            replace(entry, split=split_by_name[entry.group or entry.name]) if entry.split == AUTO_SPLIT else entry
            for entry in entries
        ]
        tensor_units = {key: unit for key, unit in units.items() if key in tensor_names}
        manifest = Manifest(app, tuple(entries), tensor_units, notes)
        _publish(folder, partial, manifest, _require_replaceable(folder, app, overwrite), beside)
    finally:
        if isinstance(tasks, Generator):
            tasks.close()  # ends a progress bar before an error is shown
        shutil.rmtree(partial, ignore_errors=True)
        for path in new_folders:
            if any(path.iterdir()):
                break
            path.rmdir()
    return entries


def _check_task(task: Task, split: str, units: Mapping[str, str], names: Collection[str], subject: str | Path) -> None:
    """Refuse a task that a data set cannot hold.

    Args:
        task: the task.
        split: its split.
        units: the units of tensors, by name.
        names: the names, as JSON holds them, of tasks that are written already; they must differ.
        subject: what a message names if the task has no name.

    Raises:
        ValueError: the split is unknown, the name is empty or occurs twice, the task has no tensors, a tensor has no
            unit, or a value is not finite.
    """
    if split not in (*SPLITS, AUTO_SPLIT):
        raise ValueError(f"{task.name}: split '{split}', expected 'train', 'test' or 'auto'.")
    if not task.name.strip():
        raise ValueError(f"{subject}: a task with an empty name; give it one.")
    if to_json_value(task.name) in names:
        raise ValueError(f"{task.name}: two tasks of this name, expected names that differ; rename one source.")
    if not task.data:
        raise ValueError(f"{task.name}: a task without tensors.")
    for key, tensor in task.data.items():
        if key not in units:
            raise ValueError(f"{task.name}: tensor '{key}' has no unit; add it to units.")
        if not torch.isfinite(tensor).all():
            raise ValueError(f"{task.name}: tensor '{key}' holds NaN or infinite values, expected finite ones.")


def _require_replaceable(folder: Path, app: str, overwrite: bool) -> Manifest | None:
    """Return the manifest of the data set in a folder, which is to be replaced; None if there is none.

    Raises:
        ValueError: the data set is of another application, or must not be overwritten; the manifest is damaged, of a
            newer version or of another program.
    """
    if not (folder / MANIFEST).exists():
        return None
    try:
        manifest = read_manifest(folder)
    except ValueError as error:
        raise ValueError(f"{error} To keep what is there, choose another folder.") from None
    if manifest.app != app:
        raise ValueError(
            f"{folder}: holds tasks of '{manifest.app}', expected an empty folder or tasks of '{app}'; choose another "
            "folder."
        )
    if not overwrite:
        raise ValueError(
            f"{folder}: holds a data set of {len(manifest.tasks)} tasks, expected a new folder; add --overwrite to "
            "replace it."
        )
    return manifest


def _publish(
    folder: Path, partial: Path, manifest: Manifest, replaced: Manifest | None, beside: tuple[str, str] | None
) -> None:
    """Move all files to their place, the manifest last: without a manifest, a folder holds no data set.

    Args:
        folder: the folder of the data set.
        partial: the folder that the files were written to.
        manifest: the new manifest.
        replaced: the manifest of the data set that is replaced; None if there is none.
        beside: the name of a tensor and the suffix of the texts beside tasks; None if there are no texts.
    """
    (folder / MANIFEST).unlink(missing_ok=True)
    for entry in replaced.tasks if replaced else ():
        for suffix in (SHARD_SUFFIX, beside[1] if beside else SHARD_SUFFIX):
            (folder / entry.file).with_suffix(suffix).unlink(missing_ok=True)
    for file in sorted(partial.iterdir()):
        os.replace(file, folder / file.name)
    document = to_json_value({**asdict(manifest), "tasks": [asdict(entry) for entry in manifest.tasks]})
    write_bytes(folder / MANIFEST, json.dumps(document, indent=1).encode() + b"\n")


def read_data_set(
    folder: str | Path, split: str | None = None, app: str | None = None, holds: Mapping[str, TensorSpec] | None = None
) -> list[Task]:
    """Read the tasks of a data set; the tensors are mapped from disk and loaded when they are used.

    The digests of files are not compared; see :func:`list_data_set_problems`.

    Args:
        folder: the folder of the data set.
        split: "train" or "test" to read the tasks of one split only; None for all.
        app: the name of the application that the tasks must belong to; None for any.
        holds: the tensors that the application asks of each task, by name; None for any.

    Returns:
        The tasks in the order of the manifest; [] if the split has none.

    Raises:
        ValueError: the manifest cannot be read, the tasks are of another application, or a file is missing or damaged,
            or lacks tensors.
    """
    folder = Path(folder)
    if split is not None and split not in SPLITS:
        raise ValueError(f"{folder}: split '{split}', expected 'train' or 'test'.")
    manifest = read_manifest(folder)
    if app is not None and manifest.app != app:
        raise ValueError(
            f"{folder}: holds tasks of '{manifest.app}', expected '{app}'; name another data set, or another APP."
        )
    tasks = []
    for entry in manifest.tasks:
        if split in (None, entry.split):
            task = _read_task(folder, entry)
            if problems := problems_of(task, holds or {}):
                raise ValueError(f"{folder / entry.file}: {problems[0]}; convert the data again.")
            tasks.append(task)
    return tasks


def list_data_set_problems(folder: str | Path, holds: Mapping[str, TensorSpec] | None = None) -> list[str]:
    """Compare a data set with its manifest, and its tasks with the tensors that the application asks for.

    Args:
        folder: the folder of the data set.
        holds: the tensors that the application asks of each task, by name; None for any.

    Returns:
        One line for each problem; [] for none. Problems are files that are missing, changed, damaged or not listed,
        values that are not finite, and tensors that are missing or of another shape or type.
    """
    folder = Path(folder)
    try:
        manifest = read_manifest(folder)
    except ValueError as error:
        return [str(error)]
    problems = []
    for entry in manifest.tasks:
        path = folder / entry.file
        try:
            task = _read_task(folder, entry)
        except ValueError as error:
            problems.append(str(error))
            continue
        with open_regular(path) as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        if digest != entry.sha256:
            problems.append(
                f"{path}: SHA-256 {digest[:12]}..., expected {entry.sha256[:12]}...; the file has changed since."
            )
        problems += [f"{path}: {problem}; convert the data again." for problem in problems_of(task, holds or {})]
    other_files = manifest.notes.get("files")  # files that the command wrote beside the tasks
    listed_names = {MANIFEST, *(map(str, other_files) if isinstance(other_files, list) else ())}
    # the text beside a task has the stem of the task's file
    stems = {entry.file.removesuffix(SHARD_SUFFIX) for entry in manifest.tasks}
    problems += [
        f"{path}: not listed in {MANIFEST}; remove it, or convert the data again."
        for path in sorted(folder.iterdir())
        # hidden files are those of the system, such as .DS_Store, and of a command that is writing
        if path.name not in listed_names and path.stem not in stems and not path.name.startswith(".")
    ]
    return problems


def _shard_name(name: str, used_names: Collection[str]) -> str:
    """Return a file name for a task that every file system takes.

    Args:
        name: the name of the task.
        used_names: names of files in lower case, from which it must differ even where case does not count.
    """
    file, count = f"{file_name(name)}{SHARD_SUFFIX}", 1
    while file.lower() in used_names:
        count += 1
        file = f"{file_name(f'{name}-{count}')}{SHARD_SUFFIX}"
    return file


def _read_task(folder: Path, entry: ManifestEntry) -> Task:
    """Read the task of an entry in a manifest.

    Raises:
        ValueError: the file is missing or damaged, or is a link that leads out of the folder.
    """
    path = folder / entry.file
    if not path.is_file():
        raise ValueError(f"{path}: missing, expected a file as {MANIFEST} lists it; convert the data again.")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{path}: a link that leads out of the data set's folder; copy the file there instead.")
    try:
        return Task(entry.name, read_tensors(path), entry.group)
    except (
        SafetensorError,
        RuntimeError,
        TypeError,
        AttributeError,
    ) as error:  # by torch, for types that it lacks
        raise ValueError(f"{path}: not readable as safetensors ({error}); convert the data again.") from None
