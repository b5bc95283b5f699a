"""What a run of many inputs fits: sources, read when their turn comes, of which a machine may take a part."""

from __future__ import annotations

import collections
import functools
import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs import BadOption
from metapp.runs.inputs import AS_FILES_SAY, Reading, readers_of, tasks_of_data
from metapp.runs.reporter import say
from metapp.storage.records import file_name, safe_name

SOURCED = {"source": str, "stamp": str}  # what a record holds of its source


class Source(NamedTuple):
    """Something to fit.

    Attributes:
        place: its path, or its name in a data set: what records know it by.
        stamp: changes when the file does; "" in a data set, whose content is part of the run's name.
        mark: what its task's name needs to be its own in a run, "" where nothing.
        read: -> the task; ValueError or OSError where it is damaged.
    """

    place: str
    stamp: str
    mark: str
    read: Callable[[], Task]

    def task(self) -> Task:
        """Read it.

        Raises:
            ValueError: it is damaged.
            OSError: it cannot be read.
        """
        task = self.read()
        return task._replace(name=safe_name(task.name) + self.mark)


class Shard(NamedTuple):
    """A part of a run: every `parts`-th source from the `part`-th on, both counted from 1."""

    part: int = 1
    parts: int = 1

    def take(self, sources: Sequence[Source]) -> list[Source]:
        """The sources of this part."""
        return list(sources[self.part - 1 :: self.parts])


def shard_of(text: str) -> Shard:
    """Read I/N; all of "".

    Raises:
        BadOption: it is no such text, or there is no such part.
    """
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text or "1/1")
    shard = Shard(int(found[1]), int(found[2])) if found else Shard(0, 0)
    if not 1 <= shard.part <= shard.parts:
        raise BadOption(f"--shard '{text}': expected I/N, the I-th of N parts, such as 1/4 to 4/4.")
    return shard


def sources_of(
    app: App, inputs: Sequence[Path], data: Path | None, quiet: bool, reading: Reading = AS_FILES_SAY
) -> tuple[list[Source], str]:
    """All sources, sorted, and their name in run folders; of the user's files nothing is read yet.

    Args:
        app: the application.
        inputs: the user's files and folders; none: the data set's test tasks.
        data: folder of the data set; None: the embedded one.
        quiet: no progress.
        reading: what readers should know beside the paths.

    Raises:
        ValueError: a path that is missing or no input of the application; no test task.
    """
    if not inputs:
        tasks, label = tasks_of_data(app, data, quiet)
        return [Source(task.name, "", "", functools.partial(_same, task)) for task in tasks], label
    found: dict[str, Callable[[], Task]] = {}
    for path in inputs:
        readers = readers_of(app, path, reading)
        for reader in readers:
            places, skipped = reader.find([path])
            for line in skipped if len(readers) == 1 else ():
                say(f"warning: {line}")
            found |= {str(place.resolve()): functools.partial(reader.read, place) for place in places}
    stems = collections.Counter(_stem(place) for place in found)
    sources = [
        Source(place, _stamp(Path(place)), "" if stems[_stem(place)] == 1 else f"-{_digest(place)}", found[place])
        for place in sorted(found)
    ]
    roots = sorted(str(path.resolve()) for path in inputs)
    return sources, f"{file_name(inputs[0].resolve().name)[:40]}-{_digest(*roots)}"


def source_of(record: dict[str, Any], sources: Sequence[Source]) -> Source | None:
    """The source that a record is of: where it was, else the only one of its name that has not changed since."""
    was = Path(record["source"])
    same = [each for each in sources if Path(each.place).name == was.name and each.stamp == record["stamp"]]
    there = [each for each in same if each.place == str(was)] or same
    return there[0] if len(there) == 1 else None


def _same(task: Task) -> Task:
    return task


def _stem(place: str) -> str:
    path = Path(place)
    return path.stem if path.is_file() else path.name


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode(errors="surrogatepass")).hexdigest()[:6]


def _stamp(path: Path) -> str:
    """Sizes and times of a file, or of the files that a folder holds; of a name in a folder, those of that."""
    folder = path if path.is_dir() else path.parent
    files = [path] if path.is_file() else sorted(each for each in folder.iterdir() if each.is_file())
    states = [(file.name, file.stat()) for file in files]
    return _digest(*(f"{name} {state.st_size} {state.st_mtime_ns}" for name, state in states))
