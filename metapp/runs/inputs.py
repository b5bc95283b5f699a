"""From paths to tasks: a user's files by the readers of data_tools, or the test tasks of a data set."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from data_tools.formats import Format, inputs_of
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs.embedded import embedded_data
from metapp.runs.reporter import say
from metapp.storage.files import check_readable, named
from metapp.storage.records import file_name, safe_name
from metapp.storage.shards import fingerprint, read_shard


class Reading(NamedTuple):
    """What readers of files should know beside the paths.

    Attributes:
        roots: folders that files of scenes may come from, beside each scene's own.
        fov_rad: the field of view of cameras that took flash photos, along the shorter side; 0: as EXIF says.
    """

    roots: Sequence[Path] = ()
    fov_rad: float = 0.0


AS_FILES_SAY = Reading()


def data_folder(app: App, data: Path | None, quiet: bool) -> Path:
    """The folder of task shards: --data, or the embedded set, made on first use."""
    return data or embedded_data(app.name, quiet=quiet)


def data_label(folder: Path) -> str:
    """A data set's name in run folders: its folder's name and a digest of its content."""
    return f"{safe_name(folder.resolve().name)}-{fingerprint(folder)[:6]}"


def tasks_to_fit(
    app: App, inputs: list[Path], data: Path | None, quiet: bool, reading: Reading = AS_FILES_SAY
) -> tuple[list[Task], str]:
    """What to fit, the user's files or the data set's test tasks, and its name in run folders.

    Args:
        app: the application.
        inputs: the user's files; none: the data set's test tasks.
        data: folder of the data set; None: the embedded one.
        quiet: no progress.
        reading: what readers should know beside the paths.

    Raises:
        ValueError: a path that is missing or no input of the application, a damaged file, no test task.
    """
    if inputs:
        tasks = distinct([task for path in inputs for task in read_input(app, path, reading)])
        more = f"-and-{len(tasks) - 1}-more" if len(tasks) > 1 else ""
        return tasks, f"{file_name(tasks[0].name)[:40]}{more}-{_content(tasks)}"
    return tasks_of_data(app, data, quiet)


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


def read_input(app: App, path: Path, reading: Reading = AS_FILES_SAY) -> list[Task]:
    """The tasks of one path, by every reader that recognises it.

    A path that was named must be good; a damaged file that was found in a folder is skipped with a warning.
    """
    fitting = readers_of(app, path, reading)
    return [task for reader in fitting for task in _read(reader, path, len(fitting) == 1)]


class FoundReader(NamedTuple):
    """What finds and reads the files of a path: paths -> (sources, lines about what is none), source -> task."""

    find: Callable[[list[Path]], tuple[list[Path], list[str]]]
    read: Callable[[Path], Task]


def readers_of(app: App, path: Path, reading: Reading = AS_FILES_SAY) -> list[FoundReader]:
    """Every reader that recognises a path.

    Raises:
        ValueError: there is no such path, or it is no input of the application.
    """
    if not path.exists():
        raise ValueError(f"{path}: no such file or folder; give existing input files.")
    check_readable(path)
    known = inputs_of(app.name)
    fitting = [form for form in known if form.recognises(path)]
    if not fitting:
        expected = ", ".join(each.inputs for each in known)
        raise ValueError(f"{path}: not an input of {app.name}, expected {expected}, or a folder of these.")
    return [_reader(form, reading, app.traits.reads) for form in fitting]


def _reader(form: Format, reading: Reading, size: int) -> FoundReader:
    return FoundReader(form.find, functools.partial(form.read, size=size, **reading._asdict()))


def _read(reader: FoundReader, path: Path, alone: bool) -> list[Task]:
    sources, skipped = reader.find([path])
    for line in skipped if alone else ():
        say(f"warning: {line}")
    tasks = []
    for source in sources:
        try:
            tasks.append(reader.read(source))
        except (ValueError, OSError) as error:
            if len(sources) == 1:
                raise named(error, source) from None
            say(f"warning: skipped {named(error, source)}")
    if not tasks:
        raise ValueError(f"{path}: none of the {len(sources)} found could be read.")
    return tasks


def distinct(tasks: list[Task]) -> list[Task]:
    """The same tasks, their names made safe and short; where names repeat, later ones are numbered, and it is said."""
    tasks = [task._replace(name=safe_name(task.name)) for task in tasks]
    taken: set[str] = {task.name for task in tasks}
    seen: set[str] = set()
    renamed = []
    for task in tasks:
        name, i = task.name, 2
        if name in seen:
            while f"{task.name}-{i}" in taken | seen:
                i += 1
            name = f"{task.name}-{i}"
            say(f"warning: a second {task.name} is called {name}")
        seen.add(name)
        renamed.append(task._replace(name=name))
    return renamed


def _content(tasks: list[Task]) -> str:
    """6 hex digits of names and values."""
    total = hashlib.sha256()
    for task in tasks:
        total.update(task.name.encode(errors="surrogatepass"))
        for key in sorted(task.data):
            total.update(task.data[key].detach().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return total.hexdigest()[:6]
