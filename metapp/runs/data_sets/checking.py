"""The check of a data set: what it holds, and what is wrong with it.

Files are compared with the manifest, and tensors with what the application reads; nothing is fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from metapp.registry import registry
from metapp.runs.inputs.finding import read_named_manifest
from metapp.storage.shards import list_data_set_problems


class CheckedData(NamedTuple):
    """The content of a data set, and its problems.

    Attributes:
        app: the name of the application.
        counts: number of tasks in each of the splits "train" and "test".
        bytes: the size of all files of tasks that are there, in bytes.
        units: unit and meaning of each tensor, by the tensor's name.
        problems: a line for each thing that is wrong; [] for none.
    """

    app: str
    counts: Mapping[str, int]
    bytes: int
    units: Mapping[str, str]
    problems: list[str]


def check_data_set(folder: Path) -> CheckedData:
    """Compare the files of a data set with its manifest, and its tensors with those that the application reads.

    Raises:
        ValueError: the manifest cannot be read.
    """
    manifest = read_named_manifest(folder)
    files = [folder / task.file for task in manifest.tasks]
    return CheckedData(
        app=manifest.app,
        counts={split: sum(task.split == split for task in manifest.tasks) for split in ("train", "test")},
        bytes=sum(file.stat().st_size for file in files if file.is_file()),
        units=manifest.units,
        problems=list_data_set_problems(folder, registry().application(manifest.app).app.load().tensors),
    )
