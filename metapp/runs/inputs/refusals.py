"""Refusals of paths that are not what a command reads: what a path is, what was expected, and what takes it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from metapp.options import BadOption
from metapp.registry import registry
from metapp.storage.files import printable_name, read_bytes
from metapp.storage.folders import MANIFEST, FolderKind, path_kind, read_json

DESCRIBED_SUFFIXES = (".xml", ".json")
MAX_DESCRIBED_BYTES = 1 << 20  # of a document, up to which it is read to name its parts
COMMANDS_OF_FITS = ("view", "export", "compare")  # commands that take a fit or a run, as far as they are there


def path_refusal(path: Path, kind: FolderKind, expected: str) -> str:
    """Return the message that refuses what metapp wrote: what it is, what was expected, and which command takes it.

    Args:
        path: the path.
        kind: its kind.
        expected: what was expected, in words.
    """
    if kind is FolderKind.DATA_SET:
        app = _manifest_app(path)
        remedy = f"fit its test tasks by metapp meta {app} {path}, or check it by metapp data check {path}"
    elif kind in (FolderKind.FIT, FolderKind.RUN):
        commands = [f"metapp {name}" for name in COMMANDS_OF_FITS if name in registry().commands]
        takers = f"{', '.join(commands[:-1])} and {commands[-1]} take it" if commands[1:] else f"{commands[0]} takes it"
        remedy = f"{takers}: {commands[0]} {path}"
    else:
        remedy = "give the photos or files themselves"
    return f"{path}: {kind.value}, expected {expected}; {remedy}."


def is_empty(path: Path) -> bool:
    """Tell whether a path is a file without content, or a folder without any file in it."""
    if path.is_dir():
        return not any(entry.is_file() for entry in path.rglob("*"))
    return path.stat().st_size == 0


def describe_document(path: Path) -> str:
    """Return what an XML or JSON document is, by its root element or its keys; "" for any other path."""
    suffix = path.suffix.lower()
    if suffix not in DESCRIBED_SUFFIXES or not path.is_file():
        return ""
    is_read = path.stat().st_size <= MAX_DESCRIBED_BYTES
    if suffix == ".xml":
        text = read_bytes(path).decode(errors="replace") if is_read else ""
        root = re.search(r"<([A-Za-z_][\w:.-]*)", re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))
        return f"an XML document of <{printable_name(root[1])[:40]}>" if root else "an XML document"
    content = read_json(str(path)) if is_read else None
    if isinstance(content, list) and content:
        kind, content = "a JSON list", content[0]
    else:
        kind = "a JSON document"
    keys = [printable_name(key)[:20] for key in content][:6] if isinstance(content, dict) else []
    return f"{kind} of {', '.join(keys)}" if keys else kind


def check_files_of_user(path: Path, expected: str, *, data_sets: bool = False) -> None:
    """Refuse what metapp itself has written where files of a user are read.

    Args:
        path: the path of an input.
        expected: the files that are read, in words.
        data_sets: whether data sets are read, too.

    Raises:
        ValueError: the path is a data set, a fit, a run, or a picture that shows results.
    """
    kind = path_kind(path)
    if kind and not (data_sets and kind is FolderKind.DATA_SET):
        raise ValueError(path_refusal(path, kind, expected))


def check_new_files(paths: Iterable[Path]) -> None:
    """Refuse to overwrite files: one that is there already may be a measurement.

    Raises:
        BadOption: one of the files is there already.
    """
    for path in paths:
        if os.path.lexists(path):
            raise BadOption(f"{path}: is there already, expected a new file; choose another --out, or remove it.")


def _manifest_app(folder: Path) -> str:
    """Return the name of the application in a data set's manifest; "APP" if there is none."""
    manifest = read_json(str(folder / MANIFEST))
    app = manifest.get("app") if isinstance(manifest, dict) else None
    return app if isinstance(app, str) and app.isidentifier() else "APP"
