"""The joining of several data sets of one application into one, with their splits as they are.

Tasks are joined by their tensors' names and shapes; what tensors mean is not known here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import torch

from metapp.learning.task import KIND_TENSOR, Task
from metapp.registry import registry
from metapp.runs.data_sets.conversion import ConversionResult, conversion_result
from metapp.runs.inputs.finding import read_named_manifest
from metapp.runs.reporter import progress, say
from metapp.storage.shards import ManifestEntry, read_data_set, write_data_set


def join_data_sets(
    data_folders: Sequence[Path], folder: Path, *, alike: bool = False, overwrite: bool = False, quiet: bool = False
) -> ConversionResult:
    """Write the tasks of several data sets as one data set.

    Training tasks stay training tasks, test tasks stay test tasks. Tensors that not all tasks have are left out. Tasks
    of one name but different content, as two seeds draw them, get the name of their data set in front.

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
            tasks of one name are equal, or tensors of one name have different shapes.
    """
    if folder.resolve() in [data_folder.resolve() for data_folder in data_folders]:
        raise ValueError(
            f"{folder}: one of the data sets to read, expected another folder to write to; choose another --out."
        )
    manifests = [read_named_manifest(data_folder) for data_folder in data_folders]
    app = registry().application(name := manifests[0].app).app.load()
    tasks_by_name = [
        {task.name: task for task in read_data_set(data_folder, app=name, holds=app.tensors)}
        for data_folder in data_folders
    ]
    all_data = [task.data for tasks in tasks_by_name for task in tasks.values()]
    shapes = {key: value.shape for key, value in all_data[0].items() if all(key in data for data in all_data)}
    units = {key: unit for key, unit in manifests[0].units.items() if key in shapes}
    units |= {KIND_TENSOR: "uint8 [1], which of the joined data sets"} if alike else {}
    entries = [(kind, entry) for kind, manifest in enumerate(manifests) for entry in manifest.tasks]
    names = _name_tasks(data_folders, entries)
    joined_tasks = [
        _select_tensors(tasks_by_name[kind][entry.name], shapes, kind if alike else None)._replace(name=joined_name)
        for (kind, entry), joined_name in zip(entries, names, strict=True)
    ]
    notes = {"made_by": "metapp data join", "of": [data_folder.name for data_folder in data_folders]}

    def read_tasks() -> Iterator[tuple[Task, str, str]]:
        with progress(name, len(entries), quiet=quiet) as bar:
            for (_, entry), task in zip(entries, joined_tasks, strict=True):
                yield task._replace(group=entry.group), entry.split, entry.source
                bar.advance(task.name)

    renamed_count = sum(entry.name != joined for (_, entry), joined in zip(entries, names, strict=True))
    if renamed_count and not quiet:
        say(f"{name}: {renamed_count} tasks are named after their data sets, since others have their names")
    written = write_data_set(folder, name, units, read_tasks(), notes, overwrite=overwrite)
    return conversion_result(name, folder, written)


def _name_tasks(data_folders: Sequence[Path], entries: Sequence[tuple[int, ManifestEntry]]) -> list[str]:
    """Return the names of joined tasks: their own ones, or `SET-NAME` for a name that several data sets have.

    Args:
        data_folders: the folders of the data sets.
        entries: for each task, the number of its data set and its entry.

    Raises:
        ValueError: two tasks of one name have equal content, as if a data set were given twice.
    """
    counts = Counter(entry.name for _, entry in entries)
    folder_names = [folder.resolve().name for folder in data_folders]
    if len({*folder_names}) < len(folder_names):
        folder_names = [f"{name}{number}" for number, name in enumerate(folder_names, 1)]
    first_folders: dict[tuple[str, str], Path] = {}
    for kind, entry in entries:
        first = first_folders.setdefault((entry.name, entry.sha256), data_folders[kind])
        if first is not data_folders[kind]:
            raise ValueError(
                f"{data_folders[kind]}: the task {entry.name} is also in {first}, with equal content, expected "
                "different tasks; leave one of these data sets out."
            )
    return [f"{folder_names[kind]}-{entry.name}" if counts[entry.name] > 1 else entry.name for kind, entry in entries]


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
