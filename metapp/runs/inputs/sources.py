"""From paths to tasks: a user's files by the readers of data_tools, or the test tasks of a data set."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from data_tools.formats import formats, inputs_of
from data_tools.readers.photos import SIZE
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.registry import WITHOUT, registry
from metapp.runs.inputs.embedded import embedded_data
from metapp.runs.inputs.memory import tasks_of_objects
from metapp.runs.plan import Plan
from metapp.runs.reporter import say
from metapp.storage.files import check_readable, named
from metapp.storage.fits import marked_name
from metapp.storage.shards import fingerprint, read_shard
from metapp.storage.text import as_text, safe_name

FILES, MEMORY = "files", "memory"  # as records call data that are no data set


class Source(NamedTuple):
    """Something to fit, read when its turn comes.

    Attributes:
        place: its path as text, or its name in a data set: what records know it by.
        read: -> the task; ValueError or OSError where it is damaged.
        named: whether the user named it, so that it must be good; False of what was found in a folder.
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
    """The folder of task shards: --data, or the embedded set, made on first use."""
    return data or embedded_data(app.name, quiet=quiet)


def data_label(folder: Path) -> str:
    """A data set's name in run folders: its folder's name and a digest of its content."""
    return f"{safe_name(folder.resolve().name)}-{fingerprint(folder)[:6]}"


def tasks_of_data(app: App, data: Path | None, quiet: bool) -> tuple[list[Task], str]:
    """The test tasks of a data set, None for the embedded one, and its name in run folders.

    Raises:
        ValueError: it has none.
    """
    folder = data_folder(app, data, quiet)
    tasks = read_shard(folder, "test", app.name, app.tensors)
    if not tasks:
        raise ValueError(f"{folder}: 0 test tasks, expected some; convert the data again with --split auto or test.")
    return [task._replace(name=safe_name(task.name)) for task in tasks], data_label(folder)


def tasks_to_fit(plan: Plan) -> tuple[list[Task], str]:
    """The tasks of a plan's sources, read now, and the name of the data.

    A path that was named must be good; a damaged file that was found in a folder is skipped with a warning.

    Raises:
        ValueError: a path that is missing or no input of the application, a damaged file, no test task.
    """
    if plan.options.objects:
        app = plan.app
        how: dict[str, object] = {"observe": app.protocol}
        how |= _arguments(plan)
        tasks = tasks_of_objects(app.name, plan.options.objects, how)
        return _told_apart([(str(number), task) for number, task in enumerate(tasks)]), MEMORY
    sources, label = sources_to_fit(plan)
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
    return _told_apart(read), label


def sources_to_fit(plan: Plan) -> tuple[list[Source], str]:
    """The sources of a plan, its files or its data set's test tasks, and what records call the data.

    Of files nothing is read yet.

    Raises:
        ValueError: a path that is missing or no input of the application; no test task.
    """
    app, options = plan.app, plan.options
    if not options.paths:
        tasks, label = tasks_of_data(app, options.data, options.quiet)
        return sources_of(tasks), label
    merges = [option for option in registry().merges.of(app.name) if option in options.own.given()]
    return [_merged(plan, merges[0])] if merges else _sources_of_files(plan), FILES


def _sources_of_files(plan: Plan) -> list[Source]:
    """Files and what folders hold, each once, in the order of inputs."""
    sources: dict[str, Source] = {}
    for path in plan.options.paths:
        for places, read in _found(plan, path):
            for place in places:
                whole, is_named = str(place.resolve()), len(places) == 1 or place == path
                sources.setdefault(whole, Source(as_text(whole), functools.partial(read, place), is_named, [path]))
    return list(sources.values())


def sources_of(tasks: Sequence[Task]) -> list[Source]:
    """Tasks that are read already."""
    return [Source(task.name, task._replace) for task in tasks]


def _told_apart(read: Sequence[tuple[str, Task]]) -> list[Task]:
    """Tasks and where they are from, the second of a name with a digest of that, as the folders of fits have it."""
    first: dict[str, str] = {}
    return [
        task if first.setdefault(task.name, place) == place else task._replace(name=marked_name(task.name, place))
        for place, task in read
    ]


def _found(plan: Plan, path: Path) -> Iterator[tuple[list[Path], Callable[[Path], Task]]]:
    """Sources that each reader finds at a path that it recognises, and the function that reads one of them.

    Raises:
        ValueError: there is no such path, or it is no input of the application.
    """
    app = plan.app
    if not path.exists():
        raise ValueError(f"{path}: no such file or folder; give existing input files.")
    check_readable(path)
    forms_of_app = inputs_of(app.name).values()
    readers = [form for form in forms_of_app if form.load().recognises(path)]
    if not readers:
        inputs = ", ".join(form.inputs for form in forms_of_app)
        expected = f"{inputs}, or a folder of these" if inputs else "a data set, by --data"
        others = sorted({form.app for form in formats().values() if form.inputs and form.load().recognises(path)})
        fit = "; of a fit, metapp export takes the run's folder" if path.suffix == ".safetensors" else ""
        more = f"; it is one of {', '.join(others)}" if others else fit
        for name, part in registry().left_out.items():
            if any(form.app == app.name and form.load().recognises(path) for form in part.formats.values()):
                more = f"; the extension {name} reads it, which {WITHOUT} leaves out; unset it"
        raise ValueError(f"{path}: not an input of {app.name}, expected {expected}{more}.")
    for form in readers:
        places, skipped = form.load().find([path])
        for line in skipped if len(readers) == 1 else ():
            say(f"warning: {line}")
        yield places, functools.partial(form.load().read_task, **form.taken(_arguments(plan)))


def _arguments(plan: Plan) -> dict[str, object]:
    """The arguments of readers, by keyword: the size that fits have, and the options about INPUT that were given."""
    reads = plan.app.read_size
    return ({"size": reads, "rows": reads, "least": min(reads, SIZE)} if reads else {}) | plan.options.own.reading()


def _merged(plan: Plan, option: str) -> Source:
    """The one source of all inputs, as an option merges them."""
    app = plan.app
    places = [place for path in plan.options.paths for some, _ in _found(plan, path) for place in some]
    (form, *_) = (form for form in inputs_of(app.name).values() if form.load().recognises(places[0]))

    def read() -> Task:
        merge = registry().merges[app.name, option].load()
        task: Task = merge(places, getattr(plan.options.own, option), **form.taken(_arguments(plan)))
        return task

    return Source(as_text(str(places[0].resolve())), read, True, plan.options.paths)


def content_of(task: Task) -> str:
    """12 hex digits of a task's values: the same of an input that was moved or copied."""
    total = hashlib.sha256()
    for key in sorted(task.data):
        total.update(task.data[key].detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return total.hexdigest()[:12]
