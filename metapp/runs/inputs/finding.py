"""Inputs: from what a user names to what is fitted, one type all the way.

Each format's reader looks at a path and finds in it what tasks are made of. What an input means is decided here once,
for all commands; its task is read when its turn comes, so that a large set need not fit into memory.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import torch

from data_tools.readers.input_source import DAMAGED_FACT, DEFAULT_PHOTO_PX, Source
from data_tools.readers.listing import files_below
from metapp.application import Application, Facts
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.registry import WITHOUT_VARIABLE, registry
from metapp.runs.data_sets.embedded import make_embedded_set, make_embedded_test_set
from metapp.runs.inputs.refusals import check_files_of_user, describe_document, is_empty
from metapp.runs.reporter import say
from metapp.runs.spec import Spec
from metapp.storage.files import (
    check_readable,
    content_digest,
    error_about_file,
    file_name,
    placeholder_line,
    printable_name,
    to_json_value,
)
from metapp.storage.fit_folders import name_with_digest
from metapp.storage.folders import MANIFEST, cache_lookups, cached_lookup, is_data_set, list_folder
from metapp.storage.shards import Manifest, fingerprint, read_data_set, read_manifest

DATA_SET_FORMAT, MEMORY_FORMAT = "data set", "memory"  # the `format` of inputs that are not files
FILES_LABEL = "files"  # the entry `data` of specifications of fits to files, which belong to no data set


class Input(NamedTuple):
    """Something that a fit is made of: a file, a folder, a task of a data set, or an object in memory.

    Attributes:
        name: the name of the fit, which differs from the names of all other inputs of a command.
        path: the absolute path of the file or folder, or of the data set; "" for an object in memory.
        format: the name of its format; DATA_SET_FORMAT or MEMORY_FORMAT for others than files.
        facts: what is known before the task is read, such as the number of samples; recipes are chosen by facts.
        read: returns the task, given arguments of readers by keyword; raises ValueError or OSError if it is damaged.
        is_named: whether the user named this very input; a damaged file that was found in a folder fails no run.
        data: the label of the data set; FILES_LABEL for files, MEMORY_FORMAT for objects.
        given: the absolute paths, as the user gave them, by which a later command finds the input again.
    """

    name: str
    path: str
    format: str
    facts: Facts
    read: Callable[..., Task]
    is_named: bool = True
    data: str = FILES_LABEL
    given: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """The path of a file or a folder, or the name of a task in a data set or in memory; failures name it."""
        return self.path if self.path and self.format != DATA_SET_FORMAT else self.name

    def read_task(self, spec: Spec, app: App) -> Task:
        """Read the task, at the size that fits have and by the options about INPUT, with a name that can be printed.

        Raises:
            ValueError: the input is damaged; the message names it.
        """
        arguments: dict[str, object] = {"observe": spec.observe} | spec.app_options.reader_keywords()
        if size := app.read_size:
            arguments = {"size": size, "rows": size, "least": min(size, DEFAULT_PHOTO_PX)} | arguments
        try:
            task = self.read(**arguments)
        except (ValueError, OSError) as error:
            raise error_about_file(error, Path(self.place)) from None
        return task._replace(name=printable_name(task.name))

    def stamp(self) -> str:
        """Return a digest of the sizes and times of change of all files that the input may be read from.

        Files beside the input count, since readers may read them; "" if files elsewhere may belong to it, or if it is
        no file.
        """
        path = Path(self.path)
        if self.format == DATA_SET_FORMAT:
            return _stamp(str(path / MANIFEST))
        is_whole = self.format != MEMORY_FORMAT and registry().find_format(self.format)[1].is_self_contained
        return _stamp(str(path if path.is_dir() else path.parent)) if is_whole else ""


@cached_lookup
def _stamp(place: str) -> str:
    """Return a digest of the names, sizes and times of change of the files in a folder, or of a single file."""
    entries = [entry for entry in list_folder(place) if entry.is_file()] if os.path.isdir(place) else [Path(place)]
    stats = sorted((entry.name, entry.stat().st_size, entry.stat().st_mtime_ns) for entry in entries)
    return content_digest(stats)


def find(spec: Spec, things: Sequence[object] = (), data: Path | None = None, *, quiet: bool = True) -> list[Input]:
    """Find the inputs in what a user names, each once, in the order of the user's.

    A line is said for each file of a folder that is skipped.

    Args:
        spec: the specification, whose application and options about INPUT count.
        things: paths of files, of folders and of data sets, or objects in memory; () for the test tasks of `data`.
        data: the data set of --data; None for the embedded data set.
        quiet: whether no progress is shown where the embedded data set is drawn.

    Raises:
        ValueError: there is no such path, it is nothing that the application reads, or two formats read it.
    """
    application = spec.application
    if count := sum(not _is_path(thing) for thing in things):
        if count < len(things):
            raise ValueError(
                f"{count} of {len(things)} inputs are objects in memory, expected all or none; fit paths by another "
                "call."
            )
        return _inputs_of_objects(spec, things)
    with cache_lookups():
        if data:
            read_named_manifest(data)  # the set that a checkpoint was trained on: a mistyped folder is an error
        if not things:
            return find_in_data_set(spec, data or make_embedded_test_set(application, quiet))
        inputs: dict[tuple[str, str], Input] = {}
        for thing in things:
            for one in _find_in_path(spec, Path(thing)):  # type: ignore[arg-type]  # _is_path has tested it
                other = inputs.setdefault((one.path, one.name if one.format == DATA_SET_FORMAT else ""), one)
                if other.format != one.format:
                    raise ValueError(
                        f"{one.path}: the formats {other.format} and {one.format} both read it, expected one; leave "
                        f"one extension out by {WITHOUT_VARIABLE}."
                    )
    merged = [name for name in application.merges if name in spec.options]
    return [_merge(spec, merged[0], list(inputs.values()))] if merged else name_apart(inputs.values())


def find_in_data_set(spec: Spec, folder: Path) -> list[Input]:
    """Return the test tasks of a data set as inputs.

    Raises:
        ValueError: the data set has no test tasks, is of another application, or cannot be read.
    """
    application = spec.application
    tensors = application.app.load().tensors
    tasks = read_data_set(folder, "test", application.name, tensors)
    if not tasks:
        raise ValueError(f"{folder}: 0 test tasks, expected some; convert the data again with --split auto or test.")
    place, label = str(folder.absolute()), data_label(folder)
    return [
        Input(
            printable_name(task.name),
            place,
            DATA_SET_FORMAT,
            application.describe_tensors(task.data),
            functools.partial(_pass_task, task),
            data=label,
            given=(place,),
        )
        for task in tasks
    ]


def data_label(folder: Path) -> str:
    """Return the name of a data set in folders and records: its folder's name and a digest of its content."""
    return f"{printable_name(folder.resolve().name)}-{fingerprint(folder)[:6]}"


def training_data_folder(application: Application, data: Path | None, quiet: bool) -> Path:
    """Return the folder of a data set with training tasks, made first if it is the embedded set.

    Args:
        application: the application.
        data: the data set of --data; None for the whole embedded set.
        quiet: whether no progress is shown.
    """
    return data or make_embedded_set(application, quiet=quiet)


def read_named_manifest(folder: Path) -> Manifest:
    """Read the manifest of a folder that a user names as a data set.

    Raises:
        ValueError: the folder is another one that metapp wrote, or its manifest cannot be read.
    """
    check_files_of_user(folder, "the folder of a data set", data_sets=True)
    return read_manifest(folder)


def content_of(task: Task) -> str:
    """Return 12 hexadecimal digits of a task's values, which stay when its input is moved or copied."""
    digest = hashlib.sha256()
    for key in sorted(task.data):
        digest.update(task.data[key].detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:12]


def bind_reader_arguments(read: Callable[..., Task], arguments: Mapping[str, object]) -> Callable[..., Task]:
    """Bind arguments to a function of a format by name, and drop those that it has no parameter for.

    Args:
        read: the function, such as a format's `read_task`.
        arguments: values by parameter name.
    """
    return functools.partial(read, **{name: arguments[name] for name in _parameter_names(read) if name in arguments})


def name_apart(inputs: Iterable[Input]) -> list[Input]:
    """Give inputs different names: a second input of a name gets a digest of its path."""
    path_by_name: dict[str, str] = {}
    return [
        one
        if path_by_name.setdefault(one.name, one.path) == one.path
        else one._replace(name=name_with_digest(one.name, one.path))
        for one in inputs
    ]


@functools.cache  # called for each of perhaps 50,000 files
def _parameter_names(function: Callable[..., object]) -> tuple[str, ...]:
    return tuple(inspect.signature(function).parameters)


def _pass_task(task: Task, **_: object) -> Task:
    """Return a task that is in memory already."""
    return task


def _absolute_place(path: Path) -> str:
    """Return the absolute path of a file or a folder without links, as text that JSON can hold.

    The path of the folder that holds it is looked up once for all its files, see
    :func:`metapp.storage.folders.cached_lookup`.
    """
    if path.is_symlink() or path.name in ("", ".."):
        return str(to_json_value(str(path.resolve())))
    return str(to_json_value(str(_resolve_folder(path.parent) / path.name)))


@cached_lookup
def _resolve_folder(folder: Path) -> Path:
    return folder.resolve()


def _find_in_path(spec: Spec, path: Path) -> list[Input]:
    """Find the inputs in a path by each format that recognises it.

    Raises:
        ValueError: there is no such path, or it is no input of the application.
    """
    application = spec.application
    if not path.exists():
        found = "a link to nowhere" if path.is_symlink() else "no such file or folder"
        raise ValueError(f"{path}: {found}; give existing input files.")
    if is_data_set(path):
        return find_in_data_set(spec, path)
    forms = application.input_formats
    check_readable(path)
    inputs = ", ".join(form.inputs for form in forms.values())
    expected = f"{inputs}, or a folder of these" if inputs else "a data set, by --data"
    check_files_of_user(path, f"an input of {application.name} ({expected})")
    readers = {name: reader for name, form in forms.items() if (reader := form.load()).recognises(path)}
    if not readers:
        raise ValueError(_input_refusal(application, path, expected))
    found_inputs = []
    for name, reader in readers.items():
        sources, skipped = reader.find(path)
        for line in skipped if len(readers) == 1 else ():
            say(f"warning: {line}")
        found_inputs += [_input_of_source(source, name, reader, path, len(sources)) for source in sources]
    return found_inputs


def _input_of_source(source: Source, form: str, reader: Any, given: Path, count: int) -> Input:
    """Return the input that a source of a reader is.

    Args:
        source: the source.
        form: the name of its format.
        reader: the module of the format.
        given: the path that the source was found in.
        count: the number of sources in this path.
    """

    def read(**arguments: object) -> Task:
        check_readable(source.path)
        return bind_reader_arguments(reader.read_task, {**arguments, "content": source.content})(source.path)

    return Input(
        printable_name(source.name),
        _absolute_place(source.path),
        form,
        {} if source.facts.get(DAMAGED_FACT) else source.facts,
        read,
        is_named=count == 1 or source.path == given,
        given=(str(to_json_value(str(given.absolute()))),),
    )


def _merge(spec: Spec, option: str, inputs: Sequence[Input]) -> Input:
    """Return the one input that all inputs become by an option that merges them, such as photos of one ball."""
    merge = spec.application.merges[option].load()

    def read(**arguments: object) -> Task:
        paths = [Path(one.path) for one in inputs]
        return bind_reader_arguments(merge, arguments)(paths, getattr(spec.app_options, option))

    given = tuple(dict.fromkeys(path for one in inputs for path in one.given))
    return inputs[0]._replace(read=read, is_named=True, given=given)


def _inputs_of_objects(spec: Spec, objects: Sequence[object]) -> list[Input]:
    """Return objects in memory as inputs. Each is read once to learn its facts, and again at the size of its fit.

    Raises:
        ValueError: the application does not take such an object, or the object is bad.
    """
    application = spec.application
    if application.read_object is None:
        raise ValueError(
            f"{type(objects[0]).__name__}: an object in memory, expected a path, since {application.name} reads files "
            "alone; save it to one."
        )
    task_of_object, names = application.read_object.load(), _object_names(objects)
    inputs = []
    for thing, name in zip(objects, names, strict=True):
        read = functools.partial(task_of_object, thing, name)
        tensors = read(observe=spec.observe, **spec.app_options.reader_keywords()).data
        facts = application.describe_tensors(tensors)
        inputs.append(Input(name, "", MEMORY_FORMAT, facts, read, data=MEMORY_FORMAT))
    return inputs


def _is_path(thing: object) -> bool:
    """Return whether a thing is a path; a text is one unless it is an XML document."""
    return isinstance(thing, PathLike) or (isinstance(thing, str) and not thing.lstrip().startswith("<"))


def _object_names(objects: Sequence[object]) -> list[str]:
    """Name the tasks of objects: by a function's name, by the file of a picture that PIL opened, else "object".

    Several objects without a name are numbered, and names that are equal.
    """
    names = [_object_name(thing) for thing in objects]
    nameless_count = sum(not name for name in names)
    numbers = iter(range(1, nameless_count + 1))
    return [
        file_name(name) if name else f"object-{next(numbers)}" if nameless_count > 1 else "object" for name in names
    ]


def _object_name(thing: object) -> str:
    """Return the name of a function, or the stem of the file of a picture; "" if the object has neither."""
    place = getattr(thing, "filename", "")
    name = Path(place).stem if isinstance(place, str | PathLike) else ""
    return str(getattr(thing, "__name__", name)).strip("<>")


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
