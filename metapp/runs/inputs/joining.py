"""The joining of several data sets of one application into one, with their splits as they are.

Tasks are joined by their tensors' names and shapes; what tensors mean is not known here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import torch

from metapp.apps import class_of
from metapp.learning.task import KIND_TENSOR, Task
from metapp.runs.inputs.conversion import ConversionResult, conversion_result
from metapp.runs.reporter import progress
from metapp.storage.shards import read_data_set, read_manifest, write_data_set


def join_data_sets(
    data_folders: Sequence[Path], folder: Path, *, alike: bool = False, overwrite: bool = False, quiet: bool = False
) -> ConversionResult:
    """Write the tasks of several data sets as one data set.

    Training tasks stay training tasks, test tasks stay test tasks. Tensors that not all tasks have are left out.

    Args:
        data_folders: the folders of data sets of one application.
        folder: the folder to write to.
        alike: whether training draws equally many tasks from each data set, however many it has.
        overwrite: whether a data set that is in `folder` is replaced.
        quiet: whether no progress is shown.

    Returns:
        The folder and the names of the tasks that were written.

    Raises:
        ValueError: the folder is one of the data sets, a data set cannot be read or is of another application, two
            tasks have one name, or tensors of one name have different shapes.
    """
    if folder.resolve() in [data_folder.resolve() for data_folder in data_folders]:
        raise ValueError(
            f"{folder}: one of the data sets to read, expected another folder to write to; choose another --out."
        )
    manifests = [read_manifest(data_folder) for data_folder in data_folders]
    app = class_of(name := manifests[0].app)
    tasks_by_name = [
        {task.name: task for task in read_data_set(data_folder, app=name, holds=app.tensors)}
        for data_folder in data_folders
    ]
    all_data = [task.data for tasks in tasks_by_name for task in tasks.values()]
    shapes = {key: value.shape for key, value in all_data[0].items() if all(key in data for data in all_data)}
    units = {key: unit for key, unit in manifests[0].units.items() if key in shapes}
    units |= {KIND_TENSOR: "uint8 [1], which of the joined data sets"} if alike else {}
    entries = [(kind, entry) for kind, manifest in enumerate(manifests) for entry in manifest.tasks]
    joined_tasks = [
        _select_tensors(tasks_by_name[kind][entry.name], shapes, kind if alike else None) for kind, entry in entries
    ]
    notes = {"made_by": "metapp data join", "of": [data_folder.name for data_folder in data_folders]}

    def read_tasks() -> Iterator[tuple[Task, str, str]]:
        with progress(name, len(entries), quiet=quiet) as bar:
            for (_, entry), task in zip(entries, joined_tasks, strict=True):
                yield task._replace(group=entry.group), entry.split, entry.source
                bar.advance(entry.name)

    written = write_data_set(folder, name, units, read_tasks(), notes, overwrite=overwrite)
    return conversion_result(name, folder, written)


def _select_tensors(task: Task, shapes: Mapping[str, torch.Size], kind: int | None) -> Task:
    """Return a task with the tensors that all data sets have.

    Args:
        task: the task.
        shapes: the expected shape of each of these tensors, by name.
        kind: the number of the task's data set, which becomes a tensor of the task; None for no such tensor.

    Raises:
        ValueError: a tensor has another shape.
    """
    data = {key: task.data[key] for key in shapes}
    for key, shape in shapes.items():
        if data[key].shape != shape:
            raise ValueError(
                f"{task.name}: {key} {tuple(data[key].shape)}, expected {tuple(shape)} as in the others; "
                "convert all with the same --samples or --size."
            )
    return task._replace(data=data if kind is None else data | {KIND_TENSOR: torch.tensor([kind], dtype=torch.uint8)})
