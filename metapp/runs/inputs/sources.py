"""From paths to tasks: a user's files by the readers of data_tools, or the test tasks of a data set."""

from __future__ import annotations

import functools
import hashlib
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.names import inputs_of
from metapp.registry import WITHOUT, registry
from metapp.runs.inputs.embedded import embedded_data, embedded_tests
from metapp.runs.reporter import say
from metapp.runs.run import Run
from metapp.storage.files import as_text, check_readable, file_name, named, placeholder_line, safe_name
from metapp.storage.fits import marked_name
from metapp.storage.folders import Kind, check_files_of_user, kind_of, refusal

FILES, MEMORY = "files", "memory"  # as records call data that are no data set


class Source(NamedTuple):
    """Something to fit, read when its turn comes.

    Attributes:
        place: its path as text, or its name in a data set: its key in records.
        read: -> the task; ValueError or OSError if it is damaged.
        named: whether the user named it, so that it must be good; False of a file that was found in a folder.
        given: the inputs, as the user gave them, that it was found in.
    """

    place: str
    read: Callable[[], Task]
    named: bool = False
    given: Sequence[Path] = ()

    def task(self) -> Task:
        """Read it.

        Raises:
            ValueError: it is damaged.
            OSError: it cannot be read.
        """
        task = self.read()
        return task._replace(name=safe_name(task.name))


def data_folder(app: App, data: Path | None, quiet: bool) -> Path:
    """Return the folder of a data set with training tasks: --data, or the whole embedded set, made on first use."""
    return data or embedded_data(app.name, quiet=quiet)


def data_label(folder: Path) -> str:
    """A data set's name in run folders: its folder's name and a digest of its content."""
    from metapp.storage.shards import fingerprint

    return f"{safe_name(folder.resolve().name)}-{fingerprint(folder)[:6]}"


def tasks_of_data(app: App, data: Path | None, quiet: bool) -> tuple[list[Task], str]:
    """The test tasks of a data set, None for the embedded one, and its name in run folders.

    Raises:
        ValueError: it has none.
    """
    from metapp.storage.shards import read_shard

    folder = data or embedded_tests(app.name, quiet)
    tasks = read_shard(folder, "test", app.name, app.tensors)
    if not tasks:
        raise ValueError(f"{folder}: 0 test tasks, expected some; convert the data again with --split auto or test.")
    return [task._replace(name=safe_name(task.name)) for task in tasks], data_label(folder)


def sources_to_fit(run: Run) -> tuple[list[Source], str]:
    """The sources of a run, its files, objects or test tasks of its data set, and the name of the data in records.

    Of files nothing is read yet.

    Raises:
        ValueError: a path that is missing or no input of the application; no test task.
    """
    app, options = run.app, run.options
    if options.objects:
        return sources_of_objects(app.name, options.objects, _arguments(run)), MEMORY
    if not options.paths:
        tasks, label = tasks_of_data(app, options.data, options.quiet)
        return sources_of(tasks), label
    merges = [option for option in registry().merges.of(app.name) if option in options.own.given()]
    return [_merged(run, merges[0])] if merges else _sources_of_files(run), FILES


def _sources_of_files(run: Run) -> list[Source]:
    """Files, also those of folders, each once, in the order of inputs; ValueError for one that two formats read."""
    sources: dict[str, tuple[str, Source]] = {}  # and the format that reads it
    for path in run.options.paths:
        for form, places, read in _found(run, path):
            for place in places:
                whole, is_named = str(place.resolve()), len(places) == 1 or place == path
                source = Source(as_text(whole), functools.partial(read, place), is_named, [path])
                other, _ = sources.setdefault(whole, (form, source))
                if other != form:
                    raise ValueError(
                        f"{place}: the formats {other} and {form} both read it, expected one; leave one extension "
                        f"out by {WITHOUT}."
                    )
    return [source for _, source in sources.values()]


def sources_of(tasks: Sequence[Task]) -> list[Source]:
    """Tasks that are read already."""
    return [Source(task.name, task._replace) for task in tasks]


def read_tasks(sources: Sequence[Source]) -> list[Task]:
    """The tasks of sources; a damaged file that was found in a folder is left out with a warning.

    Raises:
        ValueError: a damaged file that was named, or nothing is left.
    """
    read = []
    for source in sources:
        try:
            read.append((source.place, source.task()))
        except (ValueError, OSError) as error:
            if source.named:
                raise named(error, Path(source.place)) from None
            say(f"warning: skipped {named(error, Path(source.place))}")
    if not read:
        raise ValueError(f"none of the {len(sources)} found could be read.")
    return told_apart(read)


def told_apart(read: Iterable[tuple[str, Task]]) -> list[Task]:
    """Tasks of sources' places; the second of a name has a digest of its place, as folders of fits have."""
    first: dict[str, str] = {}
    return [
        task if first.setdefault(task.name, place) == place else task._replace(name=marked_name(task.name, place))
        for place, task in read
    ]


def _found(run: Run, path: Path) -> Iterator[tuple[str, list[Path], Callable[[Path], Task]]]:
    """The name of each format that recognises a path, its sources there, and the function that reads one of them.

    Raises:
        ValueError: there is no such path, or it is no input of the application.
    """
    app = run.app
    if not path.exists():
        raise ValueError(f"{path}: no such file or folder; give existing input files.")
    check_readable(path)
    forms = inputs_of(app.name)
    inputs = ", ".join(form.inputs for form in forms.values())
    expected = f"{inputs}, or a folder of these" if inputs else "a data set, by --data"
    check_files_of_user(path, f"an input of {app.name} ({expected})")
    readers = {name: reader for name, form in forms.items() if (reader := form.load()).recognises(path)}
    if not readers:
        if kind_of(path) is Kind.RUN_FOLDERS:
            raise ValueError(refusal(path, f"an input of {app.name} ({expected})"))
        if line := _first_placeholder(path):
            raise ValueError(line)
        every = (form for form in registry().formats.values() if form.inputs)
        others = sorted({form.app for form in every if form.load().recognises(path)})
        fit = "; of a fit, metapp export takes the run's folder" if path.suffix == ".safetensors" else ""
        more = f"; it is one of {', '.join(others)}" if others else fit
        raise ValueError(f"{path}: not an input of {app.name}, expected {expected}{more}.")
    for name, reader in readers.items():
        places, skipped = reader.find(path)
        for line in skipped if len(readers) == 1 else ():
            say(f"warning: {line}")
        arguments = _taken(reader.read_task, _arguments(run))
        yield name, places, functools.partial(_read, functools.partial(reader.read_task, **arguments))


def _first_placeholder(path: Path) -> str:
    """Return the line about the first file in a folder that stands for another one, pages by name left out."""
    from data_tools.readers.listing import files_below  # here: most runs need it not

    files = files_below(path) if path.is_dir() else []
    lines = (placeholder_line(file) for file in files if file.suffix.lower() not in (".htm", ".html"))
    return next(filter(None, lines), "")


def _read(read_task: Callable[[Path], Task], place: Path) -> Task:
    """Read a file by a reader, which gets no file that stands for another one."""
    check_readable(place)
    return read_task(place)


def _taken(read: Callable[..., Task], arguments: Mapping[str, object]) -> dict[str, object]:
    """The arguments that a function of a format has."""
    return {key: arguments[key] for key in inspect.signature(read).parameters if key in arguments}


def _arguments(run: Run) -> dict[str, object]:
    """The arguments of readers, by keyword: the size that fits have, and the options about INPUT that were given.

    `size` is px a side, or `rows`; `least` px of photos.
    """
    arguments = {"observe": run.options.observe} | run.options.own.reading()
    if reads := run.app.read_size:
        from data_tools.readers.photos import SIZE  # here: fits of BRDFs need no readers of pictures

        arguments = {"size": reads, "rows": reads, "least": min(reads, SIZE)} | arguments
    return arguments


def _merged(run: Run, option: str) -> Source:
    """The one source of all inputs, as an option merges them."""
    app = run.app
    places = [place for path in run.options.paths for _, some, _ in _found(run, path) for place in some]

    def read() -> Task:
        merge = registry().merges[app.name, option].load()
        return merge(places, getattr(run.options.own, option), **_taken(merge, _arguments(run)))

    return Source(as_text(str(places[0].resolve())), read, True, run.options.paths)


def content_of(task: Task) -> str:
    """12 hex digits of a task's values: the same of an input that was moved or copied."""
    total = hashlib.sha256()
    for key in sorted(task.data):
        total.update(task.data[key].detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return total.hexdigest()[:12]


def in_memory(sources: Sequence[object]) -> bool:
    """True if sources are objects in memory, not paths; all text is a path but that of an XML document.

    Raises:
        ValueError: some are paths, others are not.
    """
    count = sum(not _is_path(source) for source in sources)
    if 0 < count < len(sources):
        raise ValueError(f"{count} of {len(sources)} sources are no paths, expected all or none of them.")
    return count > 0


def sources_of_objects(app: str, objects: Sequence[object], arguments: Mapping[str, object]) -> list[Source]:
    """The sources of objects in memory, which are read at once.

    Args:
        app: name of the application.
        objects: as its function for objects takes them.
        arguments: of readers, by name.

    Raises:
        ValueError: something else than the application takes; as readers of files, with the object's name.
    """
    entry = registry().objects.get(app)
    if entry is None:
        raise ValueError(f"{type(objects[0]).__name__}: no path, expected one; {app} reads files and folders.")
    task_of_object, names = entry.load(), _names(objects)
    tasks = [task_of_object(source, name, **arguments) for source, name in zip(objects, names, strict=True)]
    return [Source(str(number), task._replace, True) for number, task in enumerate(tasks)]


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
