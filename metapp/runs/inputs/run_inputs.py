"""The inputs of fits: a user's files, objects in memory, or the test tasks of a data set, each read when needed.

What a path means was decided in `metapp.runs.inputs.finding`; here its reader is called with the arguments of the fits.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import torch

from data_tools.readers.input_source import DEFAULT_PHOTO_PX, Source
from metapp.application import Application
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs.choice import Choice
from metapp.runs.data_sets.embedded import make_embedded_set, make_embedded_test_set
from metapp.runs.inputs.finding import MEMORY_FORMAT, absolute_place, bind_reader_arguments, read_named_manifest
from metapp.runs.reporter import say
from metapp.storage.files import check_readable, error_about_file, file_name, printable_name, to_json_value
from metapp.storage.fit_store import name_with_digest
from metapp.storage.folders import cache_lookups
from metapp.storage.shards import fingerprint, read_data_set

FILES_LABEL = "files"  # the entry "data" in settings of fits to files, which belong to no data set


class Input(NamedTuple):
    """An input of a run that becomes one task, read when its turn comes.

    Attributes:
        place: the path of the input as text, or the name of its task in a data set; records name the input by it.
        read: the function that reads the task; it raises ValueError or OSError if the input is damaged.
        is_named: whether the user named the input, so that it must be good; False for a file that was found in a
            folder.
        given_paths: the paths, as the user gave them, that the input was found in.
    """

    place: str
    read: Callable[[], Task]
    is_named: bool = False
    given_paths: Sequence[Path] = ()

    def read_task(self) -> Task:
        """Read the task of this input, with a name that can be printed.

        Raises:
            ValueError: the input is damaged.
            OSError: the input cannot be read.
        """
        task = self.read()
        return task._replace(name=printable_name(task.name))


def training_data_folder(application: Application, data: Path | None, quiet: bool) -> Path:
    """Return the folder of a data set with training tasks, made first if it is the embedded set.

    Args:
        application: the application.
        data: the data set of --data; None for the whole embedded set.
        quiet: whether no progress is shown.
    """
    return data or make_embedded_set(application, quiet=quiet)


def data_label(folder: Path) -> str:
    """Return the name of a data set in run folders and settings: its folder's name and a digest of its content."""
    return f"{printable_name(folder.resolve().name)}-{fingerprint(folder)[:6]}"


def read_test_tasks(application: Application, app: App, data: Path | None, quiet: bool) -> tuple[list[Task], str]:
    """Read the test tasks of a data set.

    Args:
        application: the application.
        app: its fits, which say which tensors are read.
        data: the folder of the data set; None for the embedded set.
        quiet: whether no progress is shown.

    Returns:
        The tasks, and the label of the data set, see :func:`data_label`.

    Raises:
        ValueError: the data set has no test tasks, or cannot be read.
    """
    folder = data or make_embedded_test_set(application, quiet)
    tasks = read_data_set(folder, "test", application.name, app.tensors)
    if not tasks:
        raise ValueError(f"{folder}: 0 test tasks, expected some; convert the data again with --split auto or test.")
    return [task._replace(name=printable_name(task.name)) for task in tasks], data_label(folder)


def find_inputs(choice: Choice) -> tuple[list[Input], str]:
    """Find the inputs of a choice: its files, its objects in memory, or the test tasks of its data set.

    Returns:
        The inputs, and the label of the data in settings of fits.

    Raises:
        ValueError: a path is missing, or there is no test task.
    """
    options, application = choice.options, choice.options.application
    if options.objects:
        return inputs_of_objects(application, options.objects, _reader_arguments(choice)), MEMORY_FORMAT
    if not options.paths:
        tasks, label = read_test_tasks(application, choice.app, options.data, options.quiet)
        return inputs_of_tasks(tasks), label
    merge_options = [option for option in application.merges if option in options.app_options.non_default_values()]
    for path in options.paths:
        if not path.exists():
            found = "a link to nowhere" if path.is_symlink() else "no such file or folder"
            raise ValueError(f"{path}: {found}; give existing input files.")
    if options.data:
        read_named_manifest(options.data)  # the set that a checkpoint was trained on: a mistyped folder is an error
    if merge_options:
        return [_merge_sources(choice, merge_options[0])], FILES_LABEL
    arguments = _reader_arguments(choice)
    with cache_lookups():
        return [_input_of_source(application, source, arguments) for source in choice.sources], FILES_LABEL


def _input_of_source(application: Application, source: Source, arguments: Mapping[str, object]) -> Input:
    """Return the input that a source becomes.

    Args:
        application: the application.
        source: the source.
        arguments: arguments of readers by name; the reader of the source's format gets those that it takes.
    """
    read_task = application.formats[source.format].load().read_task
    read = functools.partial(
        _read_file, bind_reader_arguments(read_task, {**arguments, "content": source.content}), source.path
    )
    given_paths = [source.given_path] if source.given_path else []
    return Input(to_json_value(str(absolute_place(source.path))), read, source.is_named, given_paths)


def inputs_of_tasks(tasks: Sequence[Task]) -> list[Input]:
    """Return tasks that are in memory already as inputs of a run."""
    return [Input(task.name, task._replace) for task in tasks]


def read_tasks(inputs: Sequence[Input]) -> list[Task]:
    """Read the tasks of inputs; a damaged file that was found in a folder is left out with a warning.

    Raises:
        ValueError: an input that the user named is damaged, or nothing is left.
    """
    tasks_by_place = []
    for run_input in inputs:
        try:
            tasks_by_place.append((run_input.place, run_input.read_task()))
        except (ValueError, OSError) as error:
            if run_input.is_named:
                raise error_about_file(error, Path(run_input.place)) from None
            say(f"warning: skipped {error_about_file(error, Path(run_input.place))}")
    if not tasks_by_place:
        raise ValueError(
            f"{len(inputs)} inputs were found, none can be read, expected one or more; see the warnings above."
        )
    return rename_duplicates(tasks_by_place)


def rename_duplicates(tasks_by_place: Iterable[tuple[str, Task]]) -> list[Task]:
    """Give tasks different names: a second task of a name gets a digest of its place, as its folder of a fit does.

    Args:
        tasks_by_place: pairs of an input's place and its task.
    """
    place_by_name: dict[str, str] = {}
    return [
        task
        if place_by_name.setdefault(task.name, place) == place
        else task._replace(name=name_with_digest(task.name, place))
        for place, task in tasks_by_place
    ]


def _read_file(read_task: Callable[[Path], Task], place: Path) -> Task:
    """Read a task from a file, and refuse a file that only stands for another one, such as a Git LFS pointer."""
    check_readable(place)
    return read_task(place)


def _reader_arguments(choice: Choice) -> dict[str, object]:
    """Return arguments of readers by keyword: the size that fits have, and the options about INPUT that are set.

    `size` is the side of pictures in px, `rows` the same number for panoramas, `least` the smallest side of photos in
    px.
    """
    arguments = {"observe": choice.options.observe} | choice.options.app_options.reader_keywords()
    if read_size := choice.app.read_size:
        arguments = {"size": read_size, "rows": read_size, "least": min(read_size, DEFAULT_PHOTO_PX)} | arguments
    return arguments


def _merge_sources(choice: Choice, option: str) -> Input:
    """Return the one input that all sources become by an option that merges them, such as photos of one ball.

    Args:
        choice: the options, and the sources of the inputs.
        option: the name of the option.
    """
    places = [source.path for source in choice.sources]

    def read() -> Task:
        merge = bind_reader_arguments(choice.options.application.merges[option].load(), _reader_arguments(choice))
        return merge(places, getattr(choice.options.app_options, option))

    return Input(to_json_value(str(places[0].resolve())), read, True, choice.options.paths)


def task_digest(task: Task) -> str:
    """Return 12 hexadecimal digits of a task's values, which stay when its input is moved or copied."""
    digest = hashlib.sha256()
    for key in sorted(task.data):
        digest.update(task.data[key].detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:12]


def are_objects(inputs: Sequence[object]) -> bool:
    """Test whether inputs are objects in memory, not paths; a text is a path unless it is an XML document.

    Raises:
        ValueError: some are paths, others are not.
    """
    count = sum(not _is_path(run_input) for run_input in inputs)
    if 0 < count < len(inputs):
        raise ValueError(
            f"{count} of {len(inputs)} inputs are objects in memory, expected all or none; fit paths by another call."
        )
    return count > 0


def inputs_of_objects(
    application: Application, objects: Sequence[object], arguments: Mapping[str, object]
) -> list[Input]:
    """Read objects in memory, and return them as inputs of a run.

    Args:
        application: the application.
        objects: objects that the application's reader of objects takes.
        arguments: arguments of readers, by name.

    Raises:
        ValueError: the application does not take such an object, or the object is bad.
    """
    if application.read_object is None:
        raise ValueError(
            f"{type(objects[0]).__name__}: an object in memory, expected a path, since {application.name} reads files "
            "alone; save it to one."
        )
    task_of_object, names = application.read_object.load(), _object_names(objects)
    tasks = [task_of_object(user_object, name, **arguments) for user_object, name in zip(objects, names, strict=True)]
    return [Input(str(number), task._replace, True) for number, task in enumerate(tasks)]


def _is_path(user_input: object) -> bool:
    return isinstance(user_input, PathLike) or (isinstance(user_input, str) and not user_input.lstrip().startswith("<"))


def _object_names(objects: Sequence[object]) -> list[str]:
    """Name the tasks of objects: by a function's name, by the file of a picture that PIL opened, else "object".

    Several objects without a name are numbered.
    """
    names = [_object_name(user_object) for user_object in objects]
    nameless_count = sum(not name for name in names)
    numbers = iter(range(1, nameless_count + 1))
    return [
        file_name(name) if name else f"object-{next(numbers)}" if nameless_count > 1 else "object" for name in names
    ]


def _object_name(user_object: object) -> str:
    """Return the name of a function, or the stem of the file of a picture; "" if the object has neither."""
    place = getattr(user_object, "filename", "")
    name = Path(place).stem if isinstance(place, str | PathLike) else ""
    return str(getattr(user_object, "__name__", name)).strip("<>")
