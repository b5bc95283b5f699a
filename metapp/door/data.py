"""Records of data: formats of files, their conversion, objects of programs, embedded sets."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from metapp.door.finding import module_of

Task = Any  # metapp.learning.task.Task, which imports torch


class Label(NamedTuple):
    """A task's name, its group (of tasks that show the same), and its split where auto is asked for.

    "" for no group; a split of "" is that of the rule of `metapp.storage.shards.split_auto`.
    """

    name: str
    group: str = ""
    split: str = ""


def label_of_stem(source: Path) -> Label:
    """A task that is named by its file's stem."""
    return Label(source.stem)


class Conversion(NamedTuple):
    """The way from the files of one conversion to tasks.

    Attributes:
        app: the application of the tasks.
        noun: what one source is called, such as "MERL file".
        units: of the tasks' tensors, by name.
        find: paths -> sources, and a line for each file of a folder that is none; ValueError for a bad named path.
        read: source -> the task; ValueError where it is damaged.
        notes: what the manifest should say about the conversion.
        label: source -> the task's name, group and split.
        remarks: what a person should know about the split.
    """

    app: str
    noun: str
    units: Mapping[str, str]
    find: Callable[[Iterable[Path]], tuple[list[Path], list[str]]]
    read: Callable[[Path], Task]
    notes: Mapping[str, object]
    label: Callable[[Path], Label] = label_of_stem
    remarks: tuple[str, ...] = ()


SPLIT = "Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16)."


class Converter(NamedTuple):
    """The command `metapp data NAME` of a format.

    Attributes:
        help: paragraphs and examples.
        noun: what one source is called, such as "MERL file".
        metavar, paths: of its arguments, and their help.
        options: a dataclass of its own options, as of `metapp.options`; None for none.
        split_help: of --split, where files or names tell more than the general rule.
    """

    help: str
    noun: str
    metavar: str
    paths: str
    options: type | None = None
    split_help: str = SPLIT


class Format(NamedTuple):
    """A format of files that tasks come from.

    Attributes:
        name: of its command.
        app: the application whose tasks its files hold.
        module: of what finds and reads them, by `recognises(path)`, `find(paths)` and `read_task(source, ...)` as the
            methods here. Where it converts files it has UNITS, of the tasks' tensors by name, and where that takes more
            than these, `conversion(paths, split, **options)`.
        inputs: what the files are, in words, for help and errors; "" where fits do not take them as INPUT.
        takes: what fits tell `read_task` of themselves: "size", px a side or rows of what the file becomes; "least",
            what smaller photos are enlarged to; further names are keywords of `AppOptions.reading`.
        command: that converts files, if any.
    """

    name: str
    app: str
    module: str
    inputs: str = ""
    takes: tuple[str, ...] = ()
    command: Converter | None = None

    def files(self) -> ModuleType:
        """The module that finds and reads the files."""
        return module_of(self.module)

    def recognises(self, path: Path) -> bool:
        """True if a path is of this format, or a folder with such files."""
        result: bool = self.files().recognises(path)
        return result

    def find(self, paths: Iterable[Path]) -> tuple[list[Path], list[str]]:
        """Sources, and a line for each file of a folder that is none; ValueError for a bad path."""
        result: tuple[list[Path], list[str]] = self.files().find(paths)
        return result

    def read(self, source: Path, arguments: Mapping[str, object]) -> Task:
        """Read one source, by those of the arguments of readers, by keyword, that the format takes.

        Raises:
            ValueError: it is damaged.
        """
        return self.files().read_task(source, **self.taken(arguments))

    def taken(self, arguments: Mapping[str, object]) -> dict[str, object]:
        """Those of the arguments of readers, by keyword, that the format takes."""
        return {key: arguments[key] for key in set(self.takes) & arguments.keys()}

    def conversion(self, paths: list[Path], split: str, options: Mapping[str, object]) -> Conversion:
        """The conversion of files to tasks by the command's options; ValueError for bad paths."""
        assert self.command is not None
        files = self.files()
        if hasattr(files, "conversion"):
            result: Conversion = files.conversion(paths, split, **options)
            return result
        read = functools.partial(files.read_task, **options)
        notes = {"made_by": f"metapp data {self.name}", **options}
        return Conversion(self.app, self.command.noun, files.UNITS, files.find, read, notes)


class Merge(NamedTuple):
    """Makes one task of all INPUT photos, where its option is given.

    Attributes:
        app: the application.
        option: the application's own option whose value says how.
        merge: `merge(paths, value, size=..., **options of the format) -> task`.
    """

    app: str
    option: str
    merge: str


class InMemory(NamedTuple):
    """Takes objects of a program as inputs.

    Attributes:
        app: the application.
        task: `task(object, name, **arguments) -> Task`; the arguments are those of readers, and `observe`.
    """

    app: str
    task: str


class SceneCheck(NamedTuple):
    """Checks scenes of data sets that are XML or name files; without one these are refused.

    Attributes:
        check: `check(scene) -> scene`, ValueError for something that a scene may not hold.
    """

    check: str


class Synthetic(NamedTuple):
    """An embedded data set, drawn on first use.

    Attributes:
        app: the application of its tasks.
        module: that draws them, as `metapp.runs.inputs.embedded` says.
        help: a few words for `metapp data synth --help`: kinds, size of a task, training + test tasks.
        options: names of options that `synthetic_tasks` takes as keywords.
        files: other forms that it can be written in: the value of --as, `write(folder, split, count, seed) -> names` of
            files as they are written, and a file's bytes.
    """

    app: str
    module: str
    help: str
    options: tuple[str, ...] = ()
    files: tuple[tuple[str, str, int], ...] = ()
