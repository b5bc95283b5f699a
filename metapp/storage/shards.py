"""Task shards: a folder with one `safetensors` file per task and a `manifest.json` that lists them.

Nothing is ever unpickled, no path of a manifest leads out of its folder, and every field is checked, since anybody may
have written the files.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import save

from metapp.learning.task import Task, TensorSpec, problems_of
from metapp.storage import Document
from metapp.storage.files import (
    get_json_entry,
    name_file_in_errors,
    open_regular,
    partial_path,
    read_bytes,
    read_tensors,
    remove_partial,
    write_bytes,
)
from metapp.storage.folders import MANIFEST as MANIFEST
from metapp.storage.folders import SHARD_SUFFIX, PathKind, path_kind, path_refusal

MANIFEST_SCHEMA = 1
SPLITS = ("train", "test")
AUTO_SPLIT = "auto"  # the split of `split_auto`


class ManifestEntry(NamedTuple):
    """One task of a manifest, whose file may be still to write.

    Attributes:
        name: the task's name, as tables print it.
        file: its file's name inside the folder.
        split: "train" or "test"; before it is written also "", for that of the rule.
        source: base name of the file or folder it was made of; "" if there is none.
        sha256: of the file's bytes, 64 hexadecimal digits.
        group: the thing that several tasks show, which no split parts; "" if it shows something of its own.
    """

    name: str
    file: str = ""
    split: str = ""
    source: str = ""
    sha256: str = ""
    group: str = ""


class Manifest(NamedTuple):
    """The content of a data set.

    Attributes:
        app: the application its tasks belong to.
        tasks: its tasks, in the order they were added.
        units: unit and meaning of each tensor, by the tensor's name.
        notes: anything else worth knowing, such as converter and seed.
        schema: version of the layout.
    """

    app: str
    tasks: tuple[ManifestEntry, ...]
    units: dict[str, str]
    notes: Document
    schema: int = MANIFEST_SCHEMA


def read_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of a data set.

    Raises:
        ValueError: no such folder, no manifest in it, one that is damaged or of a newer version, or one whose file
            names lead out of the folder.
    """
    folder = Path(folder)
    path = folder / MANIFEST
    if not folder.is_dir():
        state = "a file" if folder.exists() else "no such folder"
        raise ValueError(f"{folder}: {state}, expected the folder of a data set; make one with `metapp data`.")
    if not path.is_file():
        if path_kind(folder) is not PathKind.FILES:
            raise ValueError(path_refusal(folder, "the folder of a data set"))
        raise ValueError(
            f"{folder}: no {MANIFEST}, expected one beside the tasks; this is not a data set, or its conversion was "
            "interrupted: convert again with `metapp data`."
        )
    try:
        raw = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not readable as JSON ({error}); convert the data again.") from None
    return _from_json(raw, path)


def fingerprint(folder: str | Path) -> str:
    """Short name of a data set's content: 12 hexadecimal digits, the same wherever and whenever it was converted.

    It covers application, task names, splits and the files' hashes as the manifest states them; not notes, not order.

    Raises:
        ValueError: as `read_manifest`.
    """
    manifest = read_manifest(folder)
    content = [manifest.app, sorted([entry.name, entry.split, entry.sha256] for entry in manifest.tasks)]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:12]


def _from_json(raw: object, path: Path) -> Manifest:
    """Check every field, since anybody may have written the file."""

    def field(record: object, key: str, kind: type, where: str = "") -> Any:
        return get_json_entry(record, key, kind, f"{path}: {where}", "convert the data again")

    schema = field(raw, "schema", int)
    if schema != MANIFEST_SCHEMA:
        newer = schema > MANIFEST_SCHEMA
        remedy = "update metapp" if newer else "convert the data again"
        raise ValueError(
            f"{path}: schema {schema}{', written by a newer metapp' if newer else ''}, expected {MANIFEST_SCHEMA}; {remedy}."
        )
    entries: list[ManifestEntry] = []
    for index, record in enumerate(field(raw, "tasks", list)):
        where = f"task {index + 1}: "
        entry = ManifestEntry(**{key: field(record, key, str, where) for key in ManifestEntry._fields})
        if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]*", entry.file) or not entry.file.endswith(SHARD_SUFFIX):
            raise ValueError(
                f"{path}: {where}file {json.dumps(entry.file)}, expected the plain name of a {SHARD_SUFFIX} file in the "
                "same folder; convert the data again."
            )
        if entry.split not in SPLITS:
            raise ValueError(f"{path}: {where}split '{entry.split}', expected 'train' or 'test'.")
        entries.append(entry)
    for key in ("name", "file"):
        values = [getattr(entry, key) for entry in entries]
        if len(set(values)) < len(values):
            raise ValueError(f"{path}: two tasks have the same {key}, expected them to differ; convert the data again.")
    units = field(raw, "units", dict)
    for key in units:
        field(units, key, str, "units: ")
    return Manifest(field(raw, "app", str), tuple(entries), units, field(raw, "notes", dict), schema)


def split_auto(in_line: Iterable[str]) -> dict[str, str]:
    """The stated rule of splits, "train" or "test" by name: of names in line, every fifth is for tests.

    Names of tasks and of groups are sorted for it, so that neither a seed nor the order of files counts.

    >>> "".join(name for name, split in split_auto("abcdefghijk").items() if split == "test")
    'ej'
    """
    return {name: "test" if index % 5 == 4 else "train" for index, name in enumerate(dict.fromkeys(in_line))}


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

    Files are written into a folder with a temporary name; only at the end do they move, and the manifest comes last.
    If the iterator of tasks raises, the folder is as it was.

    Args:
        folder: of the data set, made if missing.
        app: the application the tasks belong to.
        units: unit and meaning of every tensor, by name; the manifest has those of tensors that a task holds.
        tasks: each with its split, "train", "test", or "auto" (by the rule of `split_auto` among all groups of tasks
            so), and the file or folder it was made of, of which the base name is kept; "" for none.
        notes: anything else worth keeping, as JSON can hold it.
        beside: name of a tensor whose bytes, a text, are kept as a file beside each task, and that file's suffix.
        overwrite: whether a data set of the same application that is there is replaced as a whole.

    Returns:
        The entries of the manifest.

    Raises:
        ValueError: the folder is a file or holds another data set (before the first task is asked for); no task; an
            unknown split, an empty or repeated name, a task without tensors, a tensor without a unit, a value that is
            not finite.

    >>> import tempfile
    >>> gold = Task("gold", {"angles": torch.zeros(2, 3)})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     (entry,) = write_shard(folder, "brdf", {"angles": "rad"}, [(gold, "train", "brdfs/gold.binary")])
    ...     entry.source, read_shard(folder)[0].data["angles"].shape
    ('gold.binary', torch.Size([2, 3]))
    """
    folder, notes = Path(folder), dict(notes or {})
    # A note that JSON cannot hold should be refused now, not after an hour of converting.
    try:
        json.dumps(notes, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{folder}: notes hold {error}; expected plain text, numbers, lists.") from None
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: a file, expected a folder to write to; choose another one.")
    _replaced(folder, app, overwrite)
    remove_partial(folder / "tasks")
    partial = partial_path(folder / "tasks")
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    partial.mkdir(parents=True)
    entries: list[ManifestEntry] = []
    held: set[str] = set()  # names of tensors
    taken = (
        {MANIFEST.replace(".json", SHARD_SUFFIX)} if beside else set()
    )  # its text would take the name of the manifest
    try:
        for task, split, source in tasks:
            _check_task(task, split, units, entries, source or folder)
            held |= set(task.data)
            # A copy of its own each: safetensors refuses tensors that share memory.
            own = torch.contiguous_format
            content = save({key: tensor.detach().cpu().clone(memory_format=own) for key, tensor in task.data.items()})
            file = _file_name(task.name, taken)
            taken.add(file.lower())
            with name_file_in_errors(folder / file):
                (partial / file).write_bytes(content)
                if beside:
                    text = task.data[beside[0]].cpu().numpy().tobytes().rstrip() + b"\n"
                    (partial / file).with_suffix(beside[1]).write_bytes(text)
            base = re.split(r"[/\\]", str(source).rstrip("/\\"))[-1]
            entries.append(ManifestEntry(task.name, file, split, base, hashlib.sha256(content).hexdigest(), task.group))
        if not entries:
            raise ValueError(f"{folder}: 0 tasks to write, expected at least one.")
        auto = split_auto(sorted(entry.group or entry.name for entry in entries if entry.split == AUTO_SPLIT))
        entries = [
            entry._replace(split=auto[entry.group or entry.name]) if entry.split == AUTO_SPLIT else entry
            for entry in entries
        ]
        manifest = Manifest(app, tuple(entries), {key: unit for key, unit in units.items() if key in held}, notes)
        _publish(folder, partial, manifest, _replaced(folder, app, overwrite), beside)
    finally:
        if isinstance(tasks, Generator):
            tasks.close()  # ends a progress bar before an error is shown
        shutil.rmtree(partial, ignore_errors=True)
        for path in made:
            if any(path.iterdir()):
                break
            path.rmdir()
    return entries


def _check_task(
    task: Task, split: str, units: Mapping[str, str], before: Sequence[ManifestEntry], subject: str | Path
) -> None:
    if split not in (*SPLITS, AUTO_SPLIT):
        raise ValueError(f"{task.name}: split '{split}', expected 'train', 'test' or 'auto'.")
    if not task.name.strip():
        raise ValueError(f"{subject}: a task with an empty name; give it one.")
    if any(entry.name == task.name for entry in before):
        raise ValueError(f"{task.name}: two tasks of this name, expected names that differ; rename one source.")
    if not task.data:
        raise ValueError(f"{task.name}: a task without tensors.")
    for key, tensor in task.data.items():
        if key not in units:
            raise ValueError(f"{task.name}: tensor '{key}' has no unit; add it to units.")
        if not torch.isfinite(tensor).all():
            raise ValueError(f"{task.name}: tensor '{key}' holds NaN or infinite values, expected finite ones.")


def _replaced(folder: Path, app: str, overwrite: bool) -> Manifest | None:
    """The manifest of the data set to replace; ValueError if that must stay."""
    try:
        before = read_manifest(folder)
    except ValueError:  # there is none
        return None
    if before.app != app:
        raise ValueError(
            f"{folder}: holds tasks of '{before.app}', expected an empty folder or tasks of '{app}'; choose another "
            "folder."
        )
    if not overwrite:
        raise ValueError(
            f"{folder}: holds a data set of {len(before.tasks)} tasks, expected a new folder; add --overwrite to "
            "replace it."
        )
    return before


def _publish(
    folder: Path, partial: Path, manifest: Manifest, before: Manifest | None, beside: tuple[str, str] | None
) -> None:
    """Move all files to their place, the manifest last; while there is no manifest, there is no data set."""
    raw = {**manifest._asdict(), "tasks": [entry._asdict() for entry in manifest.tasks]}
    (folder / MANIFEST).unlink(missing_ok=True)
    for entry in before.tasks if before else ():
        for suffix in (SHARD_SUFFIX, beside[1] if beside else SHARD_SUFFIX):
            (folder / entry.file).with_suffix(suffix).unlink(missing_ok=True)
    for file in sorted(partial.iterdir()):
        os.replace(file, folder / file.name)
    # ASCII: a file name may hold bytes that no encoding takes, which Python passes on as lone surrogates.
    write_bytes(folder / MANIFEST, json.dumps(raw, indent=1, allow_nan=False).encode("ascii") + b"\n")


def read_data_set(
    folder: str | Path, split: str | None = None, app: str | None = None, holds: Mapping[str, TensorSpec] | None = None
) -> list[Task]:
    """Read the tasks of a data set; the tensors are mapped from disk and loaded when they are used.

    Args:
        folder: of the data set.
        split: only the "train" or only the "test" tasks; None is all.
        app: the application that the tasks must belong to; None takes any.
        holds: the tensors of each task, as the application says; None takes any.

    Returns:
        The tasks in the manifest's order; an empty list if the split has none. Hashes are not compared: see
        `list_data_set_problems`.

    Raises:
        ValueError: as `read_manifest`; another application's tasks; a file that is missing or damaged, or lacks
            tensors.
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
    """Check a data set against its manifest, and its tasks against the tensors that the application asks for.

    Returns:
        One line a problem: files that are missing, changed, damaged or not listed, values that are not finite,
        tensors that are missing or of another shape or type. An empty list means that all is well.
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
    beside = manifest.notes.get("files")  # what else its command wrote there
    listed = {MANIFEST, *(map(str, beside) if isinstance(beside, list) else ())}
    stems = {entry.file.removesuffix(SHARD_SUFFIX) for entry in manifest.tasks}  # a task's text has its name
    problems += [
        f"{path}: not listed in {MANIFEST}; remove it, or convert the data again."
        for path in sorted(folder.iterdir())
        if path.name not in listed and path.stem not in stems
    ]
    return problems


def _file_name(name: str, taken: Collection[str]) -> str:
    """A file name that every file system takes, and that differs from those taken even if case does not count."""
    stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip(".")[:100] or "_"
    file, count = stem + SHARD_SUFFIX, 1
    while file.lower() in taken:
        count += 1
        file = f"{stem}-{count}{SHARD_SUFFIX}"
    return file


def _read_task(folder: Path, entry: ManifestEntry) -> Task:
    path = folder / entry.file
    if not path.is_file():
        raise ValueError(f"{path}: missing, expected a file as {MANIFEST} lists it; convert the data again.")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{path}: a link that leads out of the data set's folder; copy the file there instead.")
    try:
        return Task(entry.name, read_tensors(path), entry.group)
    except (SafetensorError, RuntimeError, TypeError, AttributeError) as error:  # torch's, of types it lacks
        raise ValueError(f"{path}: not readable as safetensors ({error}); convert the data again.") from None
