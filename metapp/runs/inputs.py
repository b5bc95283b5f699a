"""From paths to tasks: a user's files by the readers of data_tools, or the test tasks of a data set."""

from __future__ import annotations

import collections
import functools
import hashlib
import itertools
import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch

from data_tools.formats import inputs_of, merge_of
from data_tools.readers.photos import SIZE
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs.embedded import embedded_data
from metapp.runs.memory import tasks_of_objects
from metapp.runs.reporter import say
from metapp.runs.request import Request
from metapp.runs.surroundings import return_memory
from metapp.storage import Document
from metapp.storage.files import check_readable, named
from metapp.storage.records import file_name, safe_name
from metapp.storage.shards import fingerprint, read_shard
from metapp.storage.text import as_text

BETWEEN = 32  # inputs that are read between two times that freed memory is returned
SOURCED = {"source": str, "stamp": str}  # what a record of a run of many inputs holds of its source


class Source(NamedTuple):
    """Something to fit, read when its turn comes.

    Attributes:
        place: its path as text, or its name in a data set: what records know it by.
        read: -> the task; ValueError or OSError where it is damaged.
        stamp: changes when the file does; "" in a data set, whose content is part of the run's name.
        mark: what its task's name needs to be its own in a run, "" where nothing.
        file: the path that a task in memory was read from; "" of a data set, and of several photos.
    """

    place: str
    read: Callable[[], Task]
    stamp: str = ""
    mark: str = ""
    file: str = ""

    def task(self) -> Task:
        """Read it.

        Raises:
            ValueError: it is damaged.
            OSError: it cannot be read.
        """
        task = self.read()
        return task._replace(name=safe_name(task.name) + self.mark)


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
    tasks = read_shard(folder, "test", app.name, app.holds)
    if not tasks:
        raise ValueError(f"{folder}: 0 test tasks, expected some; convert the data again with --split auto or test.")
    return distinct(tasks), data_label(folder)


def tasks_to_fit(app: App, request: Request) -> tuple[list[Task], str]:
    """What a request is to fit, its files or its data set's test tasks, and the name of that in run folders.

    A path that was named must be good; a damaged file that was found in a folder is skipped with a warning.

    Raises:
        ValueError: a path that is missing or no input of the application, a damaged file, no test task.
    """
    sources, label = sources_read(app, request)
    return [source.read() for source in sources], label


def sources_read(app: App, request: Request) -> tuple[list[Source], str]:
    """The same as sources whose tasks are in memory.

    Raises:
        ValueError: as of `tasks_to_fit`.
    """
    if not (request.inputs or request.objects):
        tasks, label = tasks_of_data(app, request.data, request.quiet)
        return sources_of(tasks), label
    files, tasks = list[Path | None](), list[Task]()
    for file, task in _tasks_of_inputs(app, request):
        files.append(file)
        tasks.append(task)
        if len(tasks) % BETWEEN == 0:
            return_memory()
    tasks, stamp = distinct(tasks), _stamps()
    sources = [
        source._replace(file=as_text(str(file.resolve())), stamp=stamp(file)) if file else source
        for source, file in zip(sources_of(tasks), files, strict=True)
    ]
    return sources, label_of(tasks)


def _tasks_of_inputs(app: App, request: Request) -> Iterator[tuple[Path | None, Task]]:
    """Tasks of files, each with its path; the one of several photos, and those of objects, have none."""
    how = {"observe": app.protocol, **_arguments(app, request)}
    for task in tasks_of_objects(app.name, request.objects, how) if request.objects else ():
        yield None, task
    if request.exposures:
        yield None, _merged(app, request)
        return
    for path in request.inputs:
        for places, read in _found(app, path, request):
            yield from _read(path, places, read)


def label_of(tasks: Sequence[Task]) -> str:
    """A name of tasks that are no data set's: that of the first, how many more there are, a digest of their content."""
    return _label(tasks[0].name, len(tasks), _content(tasks))


def sources_to_fit(app: App, request: Request) -> tuple[list[Source], str]:
    """The same as sources, sorted; of files nothing is read yet, and their name says nothing of their content.

    Raises:
        ValueError: a path that is missing or no input of the application; no test task.
    """
    if not request.inputs:
        tasks, label = tasks_of_data(app, request.data, request.quiet)
        return sources_of(tasks), label
    readers: dict[str, Callable[[], Task]] = {}
    for path in request.inputs:
        for places, read in _found(app, path, request):
            readers |= {str(place.resolve()): functools.partial(read, place) for place in places}
    stems = collections.Counter(map(_stem, readers))
    stamp = _stamps()
    sources = [
        Source(as_text(place), read, stamp(Path(place)), "" if stems[_stem(place)] == 1 else f"-{_digest(place)}")
        for place, read in sorted(readers.items(), key=lambda item: item[0])
    ]
    roots = sorted(str(path.resolve()) for path in request.inputs)
    # read otherwise, the same files are other tasks
    ways = [f"{name}={value:g}" for name in ("fov", "exposure") if (value := getattr(request, name))]
    return sources, _label(request.inputs[0].resolve().name, len(roots), _digest(*roots, *ways))


def _label(first: str, count: int, digest: str) -> str:
    more = f"-and-{count - 1}-more" if count > 1 else ""
    return f"{file_name(first)[:40]}{more}-{digest}"


def former_label(label: str) -> str:
    """What `sources_to_fit` called several inputs before it counted them: by the first one alone."""
    return re.sub(r"-and-\d+-more(-[0-9a-f]{6})$", r"\1", label)


def sources_of(tasks: Sequence[Task]) -> list[Source]:
    """Tasks that are read already."""
    return [Source(task.name, functools.partial(_same, task)) for task in tasks]


def source_of(record: Document, sources: Sequence[Source]) -> Source | None:
    """The source that a record is of: where it was, else the only one of its name that has not changed since."""
    place = Path(record["source"])
    same = [source for source in sources if Path(source.place).name == place.name and source.stamp == record["stamp"]]
    there = [source for source in same if source.place == str(place)] or same
    return there[0] if len(there) == 1 else None


def distinct(tasks: list[Task]) -> list[Task]:
    """The same tasks, their names made safe and short; where names repeat, later ones are numbered, and it is said."""
    tasks = [task._replace(name=safe_name(task.name)) for task in tasks]
    first: set[str] = {task.name for task in tasks}
    taken: set[str] = set()
    numbers: dict[str, Iterator[int]] = collections.defaultdict(functools.partial(itertools.count, 2))
    renamed = []
    for task in tasks:
        name = task.name
        if name in taken:
            while name in first or name in taken:
                name = f"{task.name}-{next(numbers[task.name])}"
            say(f"warning: a second {task.name} is called {name}")
        taken.add(name)
        renamed.append(task._replace(name=name))
    return renamed


def _found(app: App, path: Path, request: Request) -> Iterator[tuple[list[Path], Callable[[Path], Task]]]:
    """What each reader that recognises a path finds there, and how it reads one of these.

    Raises:
        ValueError: there is no such path, or it is no input of the application.
    """
    if not path.exists():
        raise ValueError(f"{path}: no such file or folder; give existing input files.")
    check_readable(path)
    known = inputs_of(app.name)
    readers = [form for form in known if form.recognises(path)]
    if not readers:
        expected = ", ".join(form.inputs for form in known)
        remedy = _takes_fits(app) if path.suffix == ".safetensors" else ""
        raise ValueError(f"{path}: not an input of {app.name}, expected {expected}, or a folder of these{remedy}.")
    for form in readers:
        places, skipped = form.find([path])
        for line in skipped if len(readers) == 1 else ():
            say(f"warning: {line}")
        yield places, functools.partial(form.read, **_arguments(app, request))


def _arguments(app: App, request: Request) -> dict[str, Any]:
    """What a request tells readers, as of `Format.takes`."""
    return {
        "size": app.traits.reads,
        "least": min(app.traits.reads, SIZE),
        "roots": request.scene_root,
        "fov_rad": math.radians(request.fov),
        "exposure": request.exposure,
    }


def _takes_fits(app: App) -> str:
    """What takes a fit, which somebody gave as an input."""
    plugin = ", Mitsuba's neural_brdf (import metapp.mitsuba) the file" if app.name == "brdf" else ""
    return f"; of a fit, metapp view takes the file, metapp export the run's folder{plugin}"


def _merged(app: App, request: Request) -> Task:
    """The one task of photos of different exposures."""
    merge = merge_of(app.name)
    assert merge is not None  # as was checked
    places = [place for path in request.inputs for found, _ in _found(app, path, request) for place in found]
    size = {"size": app.traits.reads} if app.traits.reads else {}
    return merge(places, request.exposures, fov_rad=math.radians(request.fov), **size)


def _read(path: Path, places: list[Path], read: Callable[[Path], Task]) -> Iterator[tuple[Path, Task]]:
    count = 0
    for place in places:
        try:
            task = read(place)
        except (ValueError, OSError) as error:
            if len(places) == 1:
                raise named(error, place) from None
            say(f"warning: skipped {named(error, place)}")
        else:
            count += 1
            yield place, task
    if not count:
        raise ValueError(f"{path}: none of the {len(places)} found could be read.")


def _same(task: Task) -> Task:
    return task


def _content(tasks: Sequence[Task]) -> str:
    """6 hex digits of names and values."""
    total = hashlib.sha256()
    for task in tasks:
        total.update(task.name.encode(errors="surrogatepass"))
        for key in sorted(task.data):
            total.update(task.data[key].detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return total.hexdigest()[:6]


def _stem(place: str) -> str:
    path = Path(place)
    return path.stem if path.is_file() else path.name


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode(errors="surrogatepass")).hexdigest()[:6]


def _stamps() -> Callable[[Path], str]:
    """What stamps places: a file or folder itself; a name in a folder as that folder, which many share, only once."""
    stamp = functools.cache(_stamp)
    return lambda path: stamp(path if path.exists() else path.parent)


def _stamp(path: Path) -> str:
    """Sizes and times of a file, or of the files that a folder holds."""
    files = [path] if path.is_file() else sorted(file for file in path.iterdir() if file.is_file())
    states = [(file.name, file.stat()) for file in files]
    return _digest(*(f"{name} {state.st_size} {state.st_mtime_ns}" for name, state in states))
