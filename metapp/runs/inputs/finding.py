"""From what a user names to sources: what each path, data set or object in memory is, before it is read as a task.

Each format's reader looks at a path and finds the sources in it. What an input means is decided here once, for all
commands.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_tools.readers.input_source import Source
from data_tools.readers.listing import files_below
from metapp.application import Application
from metapp.learning.task import Task
from metapp.registry import WITHOUT_VARIABLE, registry
from metapp.runs.fit_options import FitOptions
from metapp.runs.inputs.refusals import check_files_of_user, describe_document, is_empty
from metapp.runs.reporter import say
from metapp.storage.files import check_readable, placeholder_line
from metapp.storage.folders import cached_lookup
from metapp.storage.shards import Manifest, read_manifest

DATA_SET_FORMAT, MEMORY_FORMAT = "data set", "memory"  # the `format` of sources that are not files


def find_sources(options: FitOptions) -> list[Source]:
    """Find the sources that options name, each once, in the order of inputs; each folder is listed once.

    A path or a data set that does not exist is left out: whatever reads it later refuses it. Objects in memory are left
    out, too: what they hold is known only once they are read.

    Returns:
        Files and folders, or the data set as a single source; [] for the embedded set and for objects in memory.

    Raises:
        ValueError: a path is no input of the application, or two formats read it.
    """
    if options.paths:
        return _find_in_paths(options)
    return [source_of_data(options.application, options.data)] if options.data and options.data.exists() else []


def source_of_data(application: Application, folder: Path) -> Source:
    """Return a data set as one source, whose facts the names of its tensors tell.

    Args:
        application: the application.
        folder: the folder of the data set.

    Raises:
        ValueError: the manifest cannot be read.
    """
    tensors = dict.fromkeys(read_named_manifest(folder).units)
    return source_of_tensors(application, folder.name, tensors, folder)


def read_named_manifest(folder: Path) -> Manifest:
    """Read the manifest of a folder that a user names as a data set.

    Raises:
        ValueError: the folder is another one that metapp wrote, or its manifest cannot be read.
    """
    check_files_of_user(folder, "the folder of a data set", data_sets=True)
    return read_manifest(folder)


def source_of_tensors(
    application: Application, name: str, tensors: Mapping[str, Any], folder: Path | None = None
) -> Source:
    """Return a task in memory, or a data set in a folder, as a source.

    Args:
        application: the application.
        name: the name of the task, or of the data set.
        tensors: the tensors of the task by name; for a data set, whose tensors are not read, None by name.
        folder: the folder of the data set; None for a task in memory.
    """
    facts = application.describe_tensors(tensors) if tensors else {}
    return Source(name, folder or Path(name), DATA_SET_FORMAT if folder else MEMORY_FORMAT, facts)


def bind_reader_arguments(read: Callable[..., Task], arguments: Mapping[str, object]) -> Callable[..., Task]:
    """Bind arguments to a function of a format by name, and drop those that it has no parameter for.

    Args:
        read: the function, such as a format's `read_task`.
        arguments: values by parameter name.
    """
    return functools.partial(read, **{name: arguments[name] for name in _parameter_names(read) if name in arguments})


@functools.cache  # called for each of perhaps 50,000 files
def _parameter_names(function: Callable[..., object]) -> tuple[str, ...]:
    return tuple(inspect.signature(function).parameters)


def absolute_place(path: Path) -> Path:
    """Return the absolute path of a file or a folder without links.

    The path of the folder that holds it is looked up once for all its files, see
    :func:`metapp.storage.folders.cached_lookup`.
    """
    if path.is_symlink() or path.name in ("", ".."):
        return path.resolve()
    return _resolve_folder(path.parent) / path.name


@cached_lookup
def _resolve_folder(folder: Path) -> Path:
    return folder.resolve()


def _find_in_paths(options: FitOptions) -> list[Source]:
    """Find the sources in all paths that options name, each once.

    Raises:
        ValueError: a path is no input of the application, or two formats read it.
    """
    sources: dict[Path, Source] = {}
    for path in options.paths:
        for source in _find_in_path(options.application, path) if path.exists() else ():
            other = sources.setdefault(absolute_place(source.path), source)
            if other.format != source.format:
                raise ValueError(
                    f"{source.path}: the formats {other.format} and {source.format} both read it, expected one; leave "
                    f"one extension out by {WITHOUT_VARIABLE}."
                )
    return list(sources.values())


def _find_in_path(application: Application, path: Path) -> Iterator[Source]:
    """Find the sources in a path by each format that recognises it, and say which files of a folder are skipped.

    Args:
        application: the application.
        path: a file or a folder that exists.

    Yields:
        Each source, with its format and the path that it was found in.

    Raises:
        ValueError: the path is no input of the application.
    """
    forms = application.input_formats
    check_readable(path)
    inputs = ", ".join(form.inputs for form in forms.values())
    expected = f"{inputs}, or a folder of these" if inputs else "a data set, by --data"
    check_files_of_user(path, f"an input of {application.name} ({expected})")
    readers = {name: reader for name, form in forms.items() if (reader := form.load()).recognises(path)}
    if not readers:
        raise ValueError(_input_refusal(application, path, expected))
    for name, reader in readers.items():
        sources, skipped = reader.find(path)
        for line in skipped if len(readers) == 1 else ():
            say(f"warning: {line}")
        for source in sources:
            is_named = len(sources) == 1 or source.path == path
            yield replace(source, format=name, given_path=path, is_named=is_named)


def _input_refusal(application: Application, path: Path, expected: str) -> str:
    """Return the error message about a path that no format of an application recognises.

    Args:
        application: the application.
        path: the path.
        expected: the inputs that the application takes, in words.
    """
    if line := _first_placeholder_line(path):
        return line
    readers_elsewhere = [
        (other.name, form.inputs)
        for other in sorted(registry().applications.values(), key=lambda other: other.name)
        for form in other.input_formats.values()
        if form.load().recognises(path)
    ]
    if is_empty(path):
        kind, remedy = ("folder", "put files into it") if path.is_dir() else ("file", "copy or download it again")
        return f"{path}: an empty {kind}, expected an input of {application.name} ({expected}); {remedy}."
    document = describe_document(path)
    found = f"{document}, not an input" if document else "not an input"
    hint = "; of a fit, metapp export takes the run's folder" if path.suffix == ".safetensors" else ""
    if document and readers_elsewhere:  # suffixes of documents do not tell what is in them
        hint = f"; of such files {', '.join(f'{name} reads {inputs}' for name, inputs in readers_elsewhere)}"
    elif readers_elsewhere:
        hint = f"; it is one of {', '.join(dict.fromkeys(name for name, _ in readers_elsewhere))}"
    return f"{path}: {found} of {application.name}, expected {expected}{hint}."


def _first_placeholder_line(path: Path) -> str:
    """Return the error message about the first file in a folder that stands for another one; "" if there is none.

    Files that are pages by their names are left out, since they are themselves.
    """
    files = files_below(path) if path.is_dir() else []
    lines = (placeholder_line(file) for file in files if file.suffix.lower() not in (".htm", ".html"))
    return next(filter(None, lines), "")
