"""The way from the files of one conversion to tasks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from metapp.learning.task import Task


class Label(NamedTuple):
    """A task's name, its group (of tasks that show the same; "" for none), and its split ("" for that of the rule)."""

    name: str
    group: str = ""
    split: str = ""


def label_of_stem(source: Path) -> Label:
    """A task that is named by its file's stem, or by its place where that is no file."""
    return Label(source.stem if source.is_file() else source.resolve().name)


def split_groups(labels: Mapping[Path, Label]) -> dict[Path, Label]:
    """Labels with a split each, that of their group: of the sorted groups, every fifth is for tests."""
    from metapp.storage.shards import split_auto  # here: it imports torch, and --help imports this module

    split = split_auto(label.group for label in labels.values())
    return {source: label._replace(split=split[label.group]) for source, label in labels.items()}


class Conversion(NamedTuple):
    """The way from the files of one conversion to tasks.

    Attributes:
        app: the application of the tasks.
        noun: the name of one source, such as "MERL file".
        units: of the tasks' tensors, by name.
        find, read: as of a format's module, `find` and `read_task`.
        notes: what the manifest says about the conversion.
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
