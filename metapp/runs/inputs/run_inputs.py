"""From paths to tasks: a user's files by the readers of data_tools, or the test tasks of a data set."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import torch

from data_tools.readers.input_source import DEFAULT_PHOTO_PX, Source
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.runs.inputs.embedded import make_embedded_set, make_embedded_test_set
from metapp.runs.inputs.finding import MEMORY_FORMAT, absolute_place, bind_reader_arguments
from metapp.runs.reporter import say
from metapp.runs.run import Run
from metapp.storage.files import check_readable, error_about_file, file_name, printable_name, to_json_value
from metapp.storage.fit_folders import name_with_digest
from metapp.storage.folders import cache_lookups
from metapp.storage.shards import fingerprint, read_data_set

FILES_LABEL = "files"  # as records call data of files


class Input(NamedTuple):
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
        return task._replace(name=printable_name(task.name))


def training_data_folder(app: App, data: Path | None, quiet: bool) -> Path:
    """Return the folder of a data set with training tasks: --data, or the whole embedded set, made on first use."""
    return data or make_embedded_set(app.name, quiet=quiet)


def data_label(folder: Path) -> str:
    """A data set's name in run folders: its folder's name and a digest of its content."""
    return f"{printable_name(folder.resolve().name)}-{fingerprint(folder)[:6]}"


def read_test_tasks(app: App, data: Path | None, quiet: bool) -> tuple[list[Task], str]:
    """The test tasks of a data set, None for the embedded one, and its name in run folders.

    Raises:
        ValueError: it has none.
    """
    folder = data or make_embedded_test_set(app.name, quiet)
    tasks = read_data_set(folder, "test", app.name, app.tensors)
    if not tasks:
        raise ValueError(f"{folder}: 0 test tasks, expected some; convert the data again with --split auto or test.")
    return [task._replace(name=printable_name(task.name)) for task in tasks], data_label(folder)


def find_inputs(run: Run) -> tuple[list[Input], str]:
    """The inputs of a run, its files, objects or test tasks of its data set, and the name of the data in records.

    Raises:
        ValueError: a path that is missing; no test task.
    """
    app, options = run.app, run.options
    if options.objects:
        return inputs_of_objects(app.name, options.objects, _arguments(run)), MEMORY_FORMAT
    if not options.paths:
        tasks, label = read_test_tasks(app, options.data, options.quiet)
        return inputs_of_tasks(tasks), label
    merges = [option for option in registry().merges.of(app.name) if option in options.own.non_default_values()]
    for path in options.paths:
        if not path.exists():
            raise ValueError(f"{path}: no such file or folder; give existing input files.")
    if merges:
        return [_merged(run, merges[0])], FILES_LABEL
    arguments = _arguments(run)
    with cache_lookups():
        return [_input_of(source, arguments) for source in run.sources], FILES_LABEL


def _input_of(source: Source, arguments: Mapping[str, object]) -> Input:
    """Return a source as something to fit, which its format's reader reads with those arguments that it takes."""
    read_task = registry().formats[source.format].load().read_task
    read = functools.partial(
        _read, bind_reader_arguments(read_task, {**arguments, "content": source.content}), source.path
    )
    given = [source.given] if source.given else []
    return Input(to_json_value(str(absolute_place(source.path))), read, source.named, given)


def inputs_of_tasks(tasks: Sequence[Task]) -> list[Input]:
    """Tasks that are read already."""
    return [Input(task.name, task._replace) for task in tasks]


def read_tasks(sources: Sequence[Input]) -> list[Task]:
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
                raise error_about_file(error, Path(source.place)) from None
            say(f"warning: skipped {error_about_file(error, Path(source.place))}")
    if not read:
        raise ValueError(f"none of the {len(sources)} found could be read.")
    return rename_duplicates(read)


def rename_duplicates(read: Iterable[tuple[str, Task]]) -> list[Task]:
    """Tasks of sources' places; the second of a name has a digest of its place, as folders of fits have."""
    first: dict[str, str] = {}
    return [
        task if first.setdefault(task.name, place) == place else task._replace(name=name_with_digest(task.name, place))
        for place, task in read
    ]


def _read(read_task: Callable[[Path], Task], place: Path) -> Task:
    """Read a file by a reader, which gets no file that stands for another one."""
    check_readable(place)
    return read_task(place)


def _arguments(run: Run) -> dict[str, object]:
    """The arguments of readers, by keyword: the size that fits have, and the options about INPUT that were given.

    `size` is px a side, or `rows`; `least` px of photos.
    """
    arguments = {"observe": run.options.observe} | run.options.own.reader_keywords()
    if reads := run.app.read_size:
        arguments = {"size": reads, "rows": reads, "least": min(reads, DEFAULT_PHOTO_PX)} | arguments
    return arguments


def _merged(run: Run, option: str) -> Input:
    """Return the one input that an option merges all sources into."""
    app = run.app
    places = [source.path for source in run.sources]

    def read() -> Task:
        merge = bind_reader_arguments(registry().merges[app.name, option].load(), _arguments(run))
        return merge(places, getattr(run.options.own, option))

    return Input(to_json_value(str(places[0].resolve())), read, True, run.options.paths)


def task_digest(task: Task) -> str:
    """12 hex digits of a task's values: the same of an input that was moved or copied."""
    total = hashlib.sha256()
    for key in sorted(task.data):
        total.update(task.data[key].detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return total.hexdigest()[:12]


def are_objects(sources: Sequence[object]) -> bool:
    """True if sources are objects in memory, not paths; all text is a path but that of an XML document.

    Raises:
        ValueError: some are paths, others are not.
    """
    count = sum(not _is_path(source) for source in sources)
    if 0 < count < len(sources):
        raise ValueError(f"{count} of {len(sources)} sources are no paths, expected all or none of them.")
    return count > 0


def inputs_of_objects(app: str, objects: Sequence[object], arguments: Mapping[str, object]) -> list[Input]:
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
    return [Input(str(number), task._replace, True) for number, task in enumerate(tasks)]


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
