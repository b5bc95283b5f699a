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
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import save

from metapp.learning.task import Task, TensorSpec, problems_of
from metapp.storage import Document
from metapp.storage.files import (
    entry_of,
    naming,
    open_regular,
    partial_path,
    read_bytes,
    read_tensors,
    remove_partial,
    write_bytes,
)

SCHEMA = 1
MANIFEST, SUFFIX = "manifest.json", ".safetensors"
SPLITS = ("train", "test")
AUTO = "auto"  # the split of `split_auto`


class Entry(NamedTuple):
    """One task of a manifest, whose file may be still to write.

    Attributes:
        name: the task's name, as tables print it.
        file: its file's name inside the folder.
        split: "train" or "test"; before it is written also "", for that of the rule.
        source: base name of the file or folder it was made of; "" if there is none.
        sha256: of the file's bytes, 64 hexadecimal digits.
        group: the thing that several tasks show, which no split parts; "" if it shows something of its own.
        beside: name of a file in the folder that holds one of its tensors as text; "" if there is none.
    """

    name: str
    file: str = ""
    split: str = ""
    source: str = ""
    sha256: str = ""
    group: str = ""
    beside: str = ""


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
    tasks: tuple[Entry, ...]
    units: dict[str, str]
    notes: Document
    schema: int = SCHEMA


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


def to_json(manifest: Manifest) -> str:
    """A manifest as the text of its file."""
    raw = {**manifest._asdict(), "tasks": [entry._asdict() for entry in manifest.tasks]}
    # ASCII: a file name may hold bytes that no encoding takes, which Python passes on as lone surrogates.
    return json.dumps(raw, indent=1, allow_nan=False) + "\n"


def _from_json(raw: object, path: Path) -> Manifest:
    """Check every field, since anybody may have written the file."""

    def field(record: object, key: str, kind: type, where: str = "", absent: object = None) -> Any:
        return entry_of(record, key, kind, f"{path}: {where}", "convert the data again", absent)

    schema = field(raw, "schema", int)
    if schema != SCHEMA:
        newer = schema > SCHEMA
        remedy = "update metapp" if newer else "convert the data again"
        raise ValueError(
            f"{path}: schema {schema}{', written by a newer metapp' if newer else ''}, expected {SCHEMA}; {remedy}."
        )
    entries: list[Entry] = []
    for index, record in enumerate(field(raw, "tasks", list)):
        where = f"task {index + 1}: "
        # older data sets have neither of two fields
        absent = {key: "" if key in ("group", "beside") else None for key in Entry._fields}
        entry = Entry(**{key: field(record, key, str, where, absent[key]) for key in Entry._fields})
        if not re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]*", entry.file) or not entry.file.endswith(SUFFIX):
            raise ValueError(
                f"{path}: {where}file {json.dumps(entry.file)}, expected the plain name of a {SUFFIX} file in the "
                "same folder; convert the data again."
            )
        stem = re.escape(entry.file.removesuffix(SUFFIX))
        if entry.beside and not re.fullmatch(rf"{stem}\.[a-z]{{1,8}}", entry.beside):
            raise ValueError(
                f"{path}: {where}beside {json.dumps(entry.beside)}, expected the name of {entry.file} with another "
                "suffix; convert the data again."
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


class ShardWriter:
    """Writes a data set, all or nothing: `with ShardWriter(folder, app, units) as writer: writer.add(task, "train")`.

    Files are written into a folder with a temporary name; only at the end do they move, and the manifest comes last.
    When the block is left by an exception, the folder is as it was. With `overwrite` a data set of the same application
    that was there is replaced as a whole.

    Args:
        folder: of the data set, made if missing.
        app: the application the tasks belong to.
        units: unit and meaning of every tensor, by name; the manifest has those of tensors that a task holds.
        notes: anything else worth keeping, as JSON can hold it.
        beside: name of a tensor whose bytes, a text, are kept as a file beside each task, and that file's suffix.

    Raises:
        ValueError: the folder is a file or holds another application's tasks (on entering); no task was added (on
            leaving).

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with ShardWriter(folder, "brdf", {"angles": "rad"}) as writer:
    ...         writer.add(Task("gold", {"angles": torch.zeros(2, 3)}), "train", "brdfs/gold.binary")
    ...     [entry.source for entry in read_manifest(folder).tasks], read_shard(folder)[0].data["angles"].shape
    (['gold.binary'], torch.Size([2, 3]))
    """

    def __init__(
        self,
        folder: str | Path,
        app: str,
        units: Mapping[str, str],
        notes: Mapping[str, object] | None = None,
        beside: tuple[str, str] | None = None,
        *,
        overwrite: bool = False,
    ) -> None:
        self.folder = Path(folder)
        self._partial = partial_path(self.folder / "tasks")
        self._beside, self._overwrite = beside, overwrite
        self._manifest = Manifest(app, (), dict(units), dict(notes or {}))
        # A note that JSON cannot hold should be refused now, not after an hour of converting.
        try:
            json.dumps(self._manifest.notes, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{folder}: notes hold {error}; expected plain text, numbers, lists.") from None
        self._entries: list[Entry] = []
        self._held: set[str] = set()  # names of tensors
        self._files = {MANIFEST.replace(".json", SUFFIX)} if beside else set()  # its text would take the same name
        self._made: list[Path] = []

    def __enter__(self) -> ShardWriter:
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"{self.folder}: a file, expected a folder to write to; choose another one.")
        self._before()
        remove_partial(self.folder / "tasks")
        self._made = [path for path in (self.folder, *self.folder.parents) if not path.exists()]
        self._partial.mkdir(parents=True)
        return self

    def add(self, task: Task, split: str, source: str | Path = "") -> None:
        """Write one task, into the temporary folder.

        Args:
            task: its tensors may live anywhere, in any layout; a name that another task has is refused.
            split: "train", "test", or "auto": by the rule of `split_auto` among all groups of tasks added so.
            source: the file or folder it was made of; only the base name is kept.

        Raises:
            ValueError: an unknown split, an empty or repeated name, a task without tensors, a tensor without a unit,
                a value that is not finite.
        """
        if split not in (*SPLITS, AUTO):
            raise ValueError(f"{task.name}: split '{split}', expected 'train', 'test' or 'auto'.")
        if not task.name.strip():
            raise ValueError(f"{source or self.folder}: a task with an empty name; give it one.")
        if any(entry.name == task.name for entry in self._entries):
            raise ValueError(f"{task.name}: two tasks of this name, expected names that differ; rename one source.")
        if not task.data:
            raise ValueError(f"{task.name}: a task without tensors.")
        for key, tensor in task.data.items():
            if key not in self._manifest.units:
                raise ValueError(f"{task.name}: tensor '{key}' has no unit; add it to units.")
            if not torch.isfinite(tensor).all():
                raise ValueError(f"{task.name}: tensor '{key}' holds NaN or infinite values, expected finite ones.")
        self._held |= set(task.data)
        # A copy of its own each: safetensors refuses tensors that share memory.
        own = torch.contiguous_format
        payload = save({key: tensor.detach().cpu().clone(memory_format=own) for key, tensor in task.data.items()})
        file = _file_name(task.name, self._files)
        with naming(self.folder / file):
            (self._partial / file).write_bytes(payload)
        self._files.add(file.lower())
        beside = ""
        if self._beside is not None:
            key, suffix = self._beside
            beside = file.removesuffix(SUFFIX) + suffix
            (self._partial / beside).write_bytes(task.data[key].cpu().numpy().tobytes().rstrip() + b"\n")
            self._files.add(beside.lower())
        digest = hashlib.sha256(payload).hexdigest()
        base = re.split(r"[/\\]", str(source).rstrip("/\\"))[-1]
        self._entries.append(Entry(task.name, file, split, base, digest, task.group, beside))

    def entries(self) -> tuple[Entry, ...]:
        """The tasks added so far, in that order, each in its split."""
        auto = split_auto(sorted(entry.group or entry.name for entry in self._entries if entry.split == AUTO))
        return tuple(
            entry._replace(split=auto[entry.group or entry.name]) if entry.split == AUTO else entry
            for entry in self._entries
        )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._publish()
        finally:
            shutil.rmtree(self._partial, ignore_errors=True)
            for path in self._made:
                if any(path.iterdir()):
                    break
                path.rmdir()

    def _publish(self) -> None:
        """Move all files to their place, the manifest last; while there is no manifest, there is no data set."""
        if not self._entries:
            raise ValueError(f"{self.folder}: 0 tasks to write, expected at least one.")
        before = self._before()
        units = {key: unit for key, unit in self._manifest.units.items() if key in self._held}
        text = to_json(self._manifest._replace(tasks=self.entries(), units=units))
        (self.folder / MANIFEST).unlink(missing_ok=True)
        for file in _files(self._entries):
            os.replace(self._partial / file, self.folder / file)
        if before is not None:
            for file in _files(before.tasks):
                if file.lower() not in self._files:
                    (self.folder / file).unlink(missing_ok=True)
        write_bytes(self.folder / MANIFEST, text.encode("ascii"))

    def _before(self) -> Manifest | None:
        """The manifest of the data set to replace; ValueError if that must stay."""
        try:
            before = read_manifest(self.folder)
        except ValueError:  # there is none
            return None
        if before.app != self._manifest.app:
            raise ValueError(
                f"{self.folder}: holds tasks of '{before.app}', expected an empty folder or tasks of "
                f"'{self._manifest.app}'; choose another folder."
            )
        if not self._overwrite:
            raise ValueError(
                f"{self.folder}: holds a data set of {len(before.tasks)} tasks, expected a new folder; add "
                "--overwrite to replace it."
            )
        return before


def read_shard(
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
        `check_shard`.

    Raises:
        ValueError: as `read_manifest`; another application's tasks; a file that is missing or damaged, or lacks
            tensors.
    """
    folder = Path(folder)
    if split is not None and split not in SPLITS:
        raise ValueError(f"{folder}: split '{split}', expected 'train' or 'test'.")
    manifest = read_manifest(folder)
    if app is not None and manifest.app != app:
        raise ValueError(f"{folder}: holds tasks of '{manifest.app}', expected '{app}'; name another data set.")
    tasks = []
    for entry in manifest.tasks:
        if split in (None, entry.split):
            task = _read_task(folder, entry)
            if problems := problems_of(task, holds or {}):
                raise ValueError(f"{folder / entry.file}: {problems[0]}; convert the data again.")
            tasks.append(task)
    return tasks


def check_shard(folder: str | Path, holds: Mapping[str, TensorSpec] | None = None) -> list[str]:
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
    missing = [entry.beside for entry in manifest.tasks if entry.beside and not (folder / entry.beside).is_file()]
    problems += [f"{folder / file}: missing, expected a file as {MANIFEST} lists it." for file in missing]
    beside = manifest.notes.get("files")  # what else its command wrote there
    listed = {MANIFEST, *_files(manifest.tasks), *(map(str, beside) if isinstance(beside, list) else ())}
    problems += [
        f"{path}: not listed in {MANIFEST}; remove it, or convert the data again."
        for path in sorted(folder.iterdir())
        if path.name not in listed
    ]
    return problems


def _files(entries: Iterable[Entry]) -> list[str]:
    return [file for entry in entries for file in (entry.file, entry.beside) if file]


def _file_name(name: str, taken: set[str]) -> str:
    """A file name that every file system takes, and that differs from those taken even if case does not count."""
    stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip(".")[:100] or "_"
    file, count = stem + SUFFIX, 1
    while file.lower() in taken:
        count += 1
        file = f"{stem}-{count}{SUFFIX}"
    return file


def _read_task(folder: Path, entry: Entry) -> Task:
    path = folder / entry.file
    if not path.is_file():
        raise ValueError(f"{path}: missing, expected a file as {MANIFEST} lists it; convert the data again.")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{path}: a link that leads out of the data set's folder; copy the file there instead.")
    try:
        return Task(entry.name, read_tensors(path), entry.group)
    except (SafetensorError, RuntimeError, TypeError, AttributeError) as error:  # torch's, of types it lacks
        raise ValueError(f"{path}: not readable as safetensors ({error}); convert the data again.") from None
