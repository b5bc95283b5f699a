"""From what a user names to sources: files by the readers of their formats, data sets, objects in memory."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_tools.readers.input_source import Source
from data_tools.readers.listing import files_below
from metapp.learning.task import Task
from metapp.names import application_of, input_formats
from metapp.registry import WITHOUT_VARIABLE, load_reference, registry
from metapp.runs.fit_options import FitOptions
from metapp.runs.reporter import say
from metapp.storage.files import check_readable, placeholder_line
from metapp.storage.folders import PathKind, cache_lookups, cached_lookup, check_files_of_user, path_kind, path_refusal
from metapp.storage.shards import read_manifest

DATA_SET_FORMAT, MEMORY_FORMAT = "data set", "memory"  # formats of sources that are no files


def find_sources(options: FitOptions) -> list[Source]:
    """Find the sources that options name, each once, in the order of inputs; each folder is listed once.

    Of a path or data set that is not there, whatever reads it says so; objects in memory tell something once they are
    read.

    Returns:
        Files and folders, or the data set as a single source; [] for the embedded set and for objects in memory.

    Raises:
        ValueError: a path that is no input of the application, or one that two formats read.
    """
    if options.paths:
        with cache_lookups():
            return _sources_of_paths(options)
    return [source_of_data(options.app, options.data)] if options.data and options.data.exists() else []


def source_of_data(app: str, folder: Path) -> Source:
    """Return a data set as one source: its tensors tell its protocol and facts.

    Raises:
        ValueError: it cannot be read.
    """
    tensors = dict.fromkeys(read_manifest(folder).units)
    return source_of_tensors(app, folder.name, tensors, folder)


def source_of_tensors(app: str, name: str, tensors: Mapping[str, Any], folder: Path | None = None) -> Source:
    """Return a task in memory, or a data set in a folder, as a source.

    Args:
        app: the name of the application.
        name: of the task, or of the data set.
        tensors: by name; None for those of a data set, which are not read.
        folder: of the data set.
    """
    entry = application_of(app)
    protocol = next((name for name, tensor in entry.protocols.items() if tensor in tensors), "")
    facts = load_reference(entry.facts)(tensors) if entry.facts and tensors else {}
    return Source(name, folder or Path(name), DATA_SET_FORMAT if folder else MEMORY_FORMAT, protocol, facts)


def bind_reader_arguments(read: Callable[..., Task], arguments: Mapping[str, object]) -> Callable[..., Task]:
    """Bind those arguments to a function of a format that it has parameters for."""
    return functools.partial(read, **{name: arguments[name] for name in _parameters(read) if name in arguments})


@functools.cache  # called for each of perhaps 50,000 files
def _parameters(function: Callable[..., object]) -> tuple[str, ...]:
    return tuple(inspect.signature(function).parameters)


def absolute_place(path: Path) -> Path:
    """Return the absolute path of a file or folder without links, which is looked up once for the files of a folder."""
    if path.is_symlink() or path.name in ("", ".."):
        return path.resolve()
    return _resolved(path.parent) / path.name


@cached_lookup
def _resolved(folder: Path) -> Path:
    return folder.resolve()


def _sources_of_paths(options: FitOptions) -> list[Source]:
    sources: dict[Path, Source] = {}
    for path in options.paths:
        for source in _found(options.app, path) if path.exists() else ():
            other = sources.setdefault(absolute_place(source.path), source)
            if other.format != source.format:
                raise ValueError(
                    f"{source.path}: the formats {other.format} and {source.format} both read it, expected one; leave "
                    f"one extension out by {WITHOUT_VARIABLE}."
                )
    return list(sources.values())


def _found(app: str, path: Path) -> Iterator[Source]:
    """Return the sources that each format finds which recognises a path; skipped files of a folder are said.

    Raises:
        ValueError: the path is no input of the application.
    """
    check_readable(path)
    forms = input_formats(app)
    inputs = ", ".join(form.inputs for form in forms.values())
    expected = f"{inputs}, or a folder of these" if inputs else "a data set, by --data"
    check_files_of_user(path, f"an input of {app} ({expected})")
    readers = {name: reader for name, form in forms.items() if (reader := form.load()).recognises(path)}
    if not readers:
        raise ValueError(_refusal(app, path, expected))
    for name, reader in readers.items():
        sources, skipped = reader.find(path)
        for line in skipped if len(readers) == 1 else ():
            say(f"warning: {line}")
        for source in sources:
            named = len(sources) == 1 or source.path == path
            yield replace(source, format=name, given=path, named=named)


def _refusal(app: str, path: Path, expected: str) -> str:
    """Return the line about a path that no format of an application recognises."""
    if path_kind(path) is PathKind.RUN_FOLDERS:
        return path_refusal(path, f"an input of {app} ({expected})")
    if line := _first_placeholder(path):
        return line
    every = (form for form in registry().formats.values() if form.inputs)
    others = sorted({form.app for form in every if form.load().recognises(path)})
    fit = "; of a fit, metapp export takes the run's folder" if path.suffix == ".safetensors" else ""
    more = f"; it is one of {', '.join(others)}" if others else fit
    return f"{path}: not an input of {app}, expected {expected}{more}."


def _first_placeholder(path: Path) -> str:
    """Return the line about the first file in a folder that stands for another one, pages by name left out."""
    files = files_below(path) if path.is_dir() else []
    lines = (placeholder_line(file) for file in files if file.suffix.lower() not in (".htm", ".html"))
    return next(filter(None, lines), "")
