"""What a program holds in memory, to be fitted: tasks of it, or files that stand for it while they are read."""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path

from data_tools.formats import object_files_of, objects_of
from metapp.apps import protocols_of
from metapp.learning.task import Task
from metapp.runs.inputs import distinct, label_of
from metapp.storage.records import file_name


def is_path(source: object) -> bool:
    """Whether a source is a path: all text but that of an XML document."""
    return isinstance(source, PathLike) or (isinstance(source, str) and not source.lstrip().startswith("<"))


def in_memory(sources: Sequence[object]) -> bool:
    """Whether sources are things in memory.

    Raises:
        ValueError: some are paths, others are not.
    """
    count = sum(not is_path(source) for source in sources)
    if 0 < count < len(sources):
        raise ValueError(f"{count} of {len(sources)} sources are no paths, expected all or none of them.")
    return count > 0


def tasks_of_objects(app: str, sources: Sequence[object]) -> tuple[list[Task], str]:
    """The tasks of things in memory whose application makes tasks of them, and a name of them.

    Raises:
        ValueError: something else than the application takes.
    """
    from_object = objects_of(app)
    if from_object is None:
        raise ValueError(f"{type(sources[0]).__name__}: no path, expected one; {app} reads files and folders.")
    tasks = distinct([from_object(source, name) for source, name in zip(sources, _names(sources), strict=True)])
    return tasks, label_of(tasks)


@contextlib.contextmanager
def files_of_objects(app: str, sources: Sequence[object], observe: str) -> Iterator[list[Path]]:
    """Files of things in memory, gone at the end; none where `tasks_of_objects` takes them.

    Args:
        app: name of the application.
        sources: what it takes.
        observe: what fits see; "" for the application's own choice.

    Raises:
        ValueError: something else than the application takes; also what is wrong with such a file, by its name alone.
    """
    to_file = object_files_of(app)
    if to_file is None:
        yield []
        return
    observe = observe or next(iter(protocols_of(app)), "")
    with tempfile.TemporaryDirectory(prefix="metapp-") as made:
        folder, files = Path(made).resolve(), list[Path]()
        try:
            for number, (source, name) in enumerate(zip(sources, _names(sources), strict=True)):
                own = folder / str(number)
                own.mkdir()
                files.append(to_file(source, file_name(name), own, observe))
            yield files
        except ValueError as error:
            text = str(error)
            if str(folder) not in text:
                raise
            for file in files:
                text = text.replace(str(file), file.stem)
            raise ValueError(re.sub(rf"{re.escape(str(folder))}/\d+/", "", text)) from None


def _names(sources: Sequence[object]) -> list[str]:
    """Names of things in memory: of functions their own, of pictures that PIL opened their file's, else "object"."""
    names = [_name(source) for source in sources]
    plain = [name for name in names if not name]
    numbers = iter(range(1, len(plain) + 1))
    return [name or (f"object-{next(numbers)}" if len(plain) > 1 else "object") for name in names]


def _name(source: object) -> str:
    place = getattr(source, "filename", "")
    name = Path(place).stem if isinstance(place, str | PathLike) else ""
    return str(getattr(source, "__name__", name)).strip("<>")
