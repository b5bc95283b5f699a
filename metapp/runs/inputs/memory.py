"""Objects of a program as inputs of fits, and how their tasks are named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

from metapp.learning.task import Task
from metapp.registry import registry
from metapp.storage.text import file_name


def in_memory(sources: Sequence[object]) -> bool:
    """True if sources are objects in memory, not paths; all text is a path but that of an XML document.

    Raises:
        ValueError: some are paths, others are not.
    """
    count = sum(not _is_path(source) for source in sources)
    if 0 < count < len(sources):
        raise ValueError(f"{count} of {len(sources)} sources are no paths, expected all or none of them.")
    return count > 0


def tasks_of_objects(app: str, objects: Sequence[object], how: Mapping[str, object]) -> list[Task]:
    """The tasks of objects in memory.

    Args:
        app: name of the application.
        objects: what it takes.
        how: arguments of readers by name, and `observe`, what fits see.

    Raises:
        ValueError: something else than the application takes; as readers of files, with the object's name.
    """
    entry = registry().objects.get(app)
    if entry is None:
        raise ValueError(f"{type(objects[0]).__name__}: no path, expected one; {app} reads files and folders.")
    from_object = entry.load()
    return [from_object(source, name, **how) for source, name in zip(objects, _names(objects), strict=True)]


def _is_path(source: object) -> bool:
    return isinstance(source, PathLike) or (isinstance(source, str) and not source.lstrip().startswith("<"))


def _names(objects: Sequence[object]) -> list[str]:
    """Names of tasks: a function's own, of a picture that PIL opened its file's, else "object"."""
    names = [_name(source) for source in objects]
    plain = [name for name in names if not name]
    numbers = iter(range(1, len(plain) + 1))
    return [file_name(name) if name else f"object-{next(numbers)}" if len(plain) > 1 else "object" for name in names]


def _name(source: object) -> str:
    place = getattr(source, "filename", "")
    name = Path(place).stem if isinstance(place, str | PathLike) else ""
    return str(getattr(source, "__name__", name)).strip("<>")
