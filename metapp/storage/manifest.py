"""The manifest of a data set: what its folder holds, checked field by field, since anybody may have written it."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

from metapp.storage import Document
from metapp.storage.files import read_bytes
from metapp.storage.text import entry_of

SCHEMA = 1
MANIFEST = "manifest.json"
SPLITS = ("train", "test")

SUFFIX = ".safetensors"


class Entry(NamedTuple):
    """One task of a manifest.

    Attributes:
        name: the task's name, as tables print it.
        file: its file's name inside the folder.
        split: "train" or "test".
        source: base name of the file or folder it was made of; "" where there is none.
        sha256: of the file's bytes, 64 hexadecimal digits.
        group: what several tasks show; "" where it shows something of its own, or the file does not say.
        beside: name of a file in the folder that holds one of its tensors as text; "" where there is none.
    """

    name: str
    file: str
    split: str
    source: str
    sha256: str
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
    """Read what a data set holds.

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

    def field(record: object, key: str, kind: type, where: str = "") -> Any:
        return entry_of(record, key, kind, f"{path}: {where}", "convert the data again")

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
        optional = [key for key in Entry._field_defaults if isinstance(record, dict) and key not in record]
        entry = Entry(**{key: field(record, key, str, where) for key in Entry._fields if key not in optional})
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
