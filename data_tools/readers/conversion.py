"""The way from the files of one conversion to tasks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from metapp.learning.task import Task


class Label(NamedTuple):
    """A task's name, its group (of tasks that show the same), and its split where auto is asked for.

    "" for no group; a split of "" is that of the rule of `metapp.storage.shards.split_auto`.
    """

    name: str
    group: str = ""
    split: str = ""


def label_of_stem(source: Path) -> Label:
    """A task that is named by its file's stem, or by its place where that is no file."""
    return Label(source.stem if source.is_file() else source.resolve().name)


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
