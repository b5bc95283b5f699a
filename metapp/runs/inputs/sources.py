"""From paths to tasks: a user's files by the readers of data_tools, or the test tasks of a data set."""

from __future__ import annotations

import functools
import hashlib
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from metapp.storage import Document
from metapp.storage.files import check_readable, named
from metapp.storage.records import file_name, safe_name
from metapp.storage.shards import fingerprint, read_shard
from metapp.storage.text import as_text

SIZES = 6  # hex digits of a stamp that are of sizes


class Source(NamedTuple):
    """Something to fit, read when its turn comes.

    Attributes:
        place: its path as text, or its name in a data set: what records know it by.
        read: -> the task; ValueError or OSError where it is damaged.
        stamp: changes when the file does; "" in a data set, whose content is part of the run's name.
        mark: the folder that its task's name begins with, as another file has the same one; "" where none has.
        named: whether the user named it, so that it must be good; False of what was found in a folder.
    """

    place: str
    read: Callable[[], Task]
    stamp: str = ""
    mark: str = ""
    named: bool = False

    def task(self) -> Task:
        """Read it.

        Raises:
            ValueError: it is damaged.
            OSError: it cannot be read.
        """
        task = self.read()
        is_marked = not self.mark or task.name.removeprefix(self.mark)[:1] in ("", "-", "_")  # by its reader
        return task._replace(name=safe_name(task.name if is_marked else f"{self.mark}-{task.name}"))


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
        tasks = _renamed(tasks_of_objects(app.name, plan.options.objects, how))
        return tasks, label_of(tasks)
    sources, label = sources_to_fit(plan)
    tasks = []
    for source in sources:
        try:
            tasks.append(source.task())
        except (ValueError, OSError) as error:
            if source.named:
                raise named(error, Path(source.place)) from None
            say(f"warning: skipped {named(error, Path(source.place))}")
    if not tasks:
        raise ValueError(f"none of the {len(sources)} found could be read.")
    return _renamed(tasks), label


def sources_to_fit(plan: Plan) -> tuple[list[Source], str]:
    """The sources of a plan, its files or its data set's test tasks, and their name in run folders.

    Of files nothing is read yet, and the name says nothing of their content.

    Raises:
        ValueError: a path that is missing or no input of the application; no test task.
    """
    app, options = plan.app, plan.options
    if not options.paths:
        tasks, label = tasks_of_data(app, options.data, options.quiet)
        return sources_of(tasks), label
    merges = [option for option in registry().merges.of(app.name) if option in options.own.given()]
    sources = [_merged(plan, merges[0])] if merges else _sources_of_files(plan)
    roots = sorted(str(path.resolve()) for path in options.paths)
    # read otherwise, the same files are other tasks
    ways = [f"{name}={value}" for name, value in options.own.recorded().items()]
    return sources, _label(_stem(str(options.paths[0].resolve())), len(roots), _digest(*roots, *ways))


def _sources_of_files(plan: Plan) -> list[Source]:
    """Files and what folders hold, each once, in the order of inputs, marked by stems: parts of a run know no more."""
    sources: dict[str, Source] = {}
    stamp = _stamps()
    for path in plan.options.paths:
        for places, read in _found(plan, path):
            for place in places:
                whole, is_named = str(place.resolve()), len(places) == 1 or place == path
                one = Source(as_text(whole), functools.partial(read, place), stamp(place.resolve()), named=is_named)
                sources.setdefault(whole, one)
    marks = marks_of({whole: _stem(whole) for whole in sources})
    return [source._replace(mark=as_text(marks[whole])) for whole, source in sources.items()]


def marks_of(stems: Mapping[str, str]) -> dict[str, str]:
    """What names begin with, by path, where stems are the same: the nearest folders that differ, else the suffixes."""
    groups: dict[str, list[str]] = {}
    for place, stem in stems.items():
        groups.setdefault(stem, []).append(place)
    marks: dict[str, str] = {}
    for places in groups.values():
        own = [""] * len(places)
        folders = itertools.zip_longest(*(reversed(Path(place).parts[1:-1]) for place in places), fillvalue="")
        for parts in (*folders, [Path(place).suffix[1:] for place in places]):
            if len(set(own)) < len(own) and len(set(parts)) > 1:
                own = ["-".join(filter(None, pair)) for pair in zip(parts, own, strict=True)]
        marks |= zip(places, own, strict=True)
    return marks


def numbered(name: str, place: str, places: dict[str, str]) -> str:
    """A name, numbered where another of the `places` of names has it; they take note of it."""
    numbers, own = itertools.count(2), name
    while places.setdefault(own, place) != place:
        own = f"{name}-{next(numbers)}"
    if own != name:
        say(f"warning: a second {name} is called {own}")
    return own


def label_of(tasks: Sequence[Task]) -> str:
    """A name of tasks that are no data set's: that of the first, how many more there are, a digest of their content."""
    return _label(tasks[0].name, len(tasks), content_of(tasks))


def _label(first: str, count: int, digest: str) -> str:
    more = f"-and-{count - 1}-more" if count > 1 else ""
    return f"{file_name(first)[:40]}{more}-{digest}"


def sources_of(tasks: Sequence[Task]) -> list[Source]:
    """Tasks that are read already."""
    return [Source(task.name, task._replace) for task in tasks]


def source_of(record: Document, sources: Sequence[Source], moved: bool = False) -> Source | None:
    """The source that a record is of: where it was, else the only one of its name that has not changed since.

    Args:
        record: of a fit, with its source and stamp.
        sources: among which it is looked for.
        moved: whether files may have been copied, so that their names and sizes count alone, and not their times.
    """
    place, end = Path(record["source"]), SIZES if moved else None
    named_alike = [source for source in sources if Path(source.place).name == place.name]
    same = [source for source in named_alike if source.stamp[:end] == record["stamp"][:end]]
    there = [source for source in same if Path(source.place) == place] or same
    return there[0] if len(there) == 1 else None


def _renamed(tasks: Sequence[Task]) -> list[Task]:
    """The same tasks, with names that are safe, short and differ."""
    places: dict[str, str] = {}
    return [task._replace(name=numbered(safe_name(task.name), str(i), places)) for i, task in enumerate(tasks)]


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
    return ({"size": reads, "least": min(reads, SIZE)} if reads else {}) | plan.options.own.reading()


def _merged(plan: Plan, option: str) -> Source:
    """The one source of all inputs, as an option merges them."""
    app = plan.app
    places = [place for path in plan.options.paths for some, _ in _found(plan, path) for place in some]
    (form, *_) = (form for form in inputs_of(app.name).values() if form.load().recognises(places[0]))

    def read() -> Task:
        merge = registry().merges[app.name, option].load()
        task: Task = merge(places, getattr(plan.options.own, option), **form.taken(_arguments(plan)))
        return task

    stamp = _stamps()
    return Source(as_text(str(places[0].resolve())), read, _digest(*map(stamp, places)), named=True)


def content_of(tasks: Sequence[Task]) -> str:
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
    """A stamp of places: of a file or folder itself, of a name in a folder that of the folder, taken once."""
    stamp = functools.cache(_stamp)
    return lambda path: stamp(path if path.exists() else path.parent)


def _stamp(path: Path) -> str:
    """Digests of the sizes, then of the times, of a file or of the files that a folder holds."""
    files = [path] if path.is_file() else sorted(file for file in path.iterdir() if file.is_file())
    states = [(file.name, file.stat()) for file in files]
    sizes = _digest(*(f"{name} {state.st_size}" for name, state in states))
    return f"{sizes}-{_digest(*(f'{state.st_mtime_ns}' for _, state in states))}"
