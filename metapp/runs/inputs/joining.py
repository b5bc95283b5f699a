"""Several data sets of an application put into one."""

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
    sources: Sequence[Path], folder: Path, *, alike: bool = False, overwrite: bool = False, quiet: bool = False
) -> ConversionResult:
    """Write the tasks of several data sets as one; training tasks stay training tasks, test tasks stay test tasks.

    Tensors that not all tasks hold are left out.

    Args:
        sources: folders of data sets of one application.
        folder: the folder to write to.
        alike: whether training draws as many tasks of each data set, whatever they hold.
        overwrite: whether a data set that is in `folder` is replaced.
        quiet: no progress.

    Returns:
        The names of the tasks that were written.

    Raises:
        ValueError: the folder is one of the data sets; one that cannot be read, or of another application; two tasks of
            one name; tensors of different shapes.
    """
    if folder.resolve() in [source.resolve() for source in sources]:
        raise ValueError(f"{folder}: one of the data sets to read, expected another folder to write to.")
    manifests = [read_manifest(source) for source in sources]
    app = class_of(name := manifests[0].app)
    sets = [{task.name: task for task in read_data_set(source, app=name, holds=app.tensors)} for source in sources]
    every = [task.data for tasks in sets for task in tasks.values()]
    shapes = {key: value.shape for key, value in every[0].items() if all(key in data for data in every)}
    units = {key: unit for key, unit in manifests[0].units.items() if key in shapes}
    units |= {KIND_TENSOR: "uint8 [1], which of the joined data sets"} if alike else {}
    entries = [(kind, entry) for kind, manifest in enumerate(manifests) for entry in manifest.tasks]
    shared = [_with_tensors(sets[kind][entry.name], shapes, kind if alike else None) for kind, entry in entries]
    notes = {"made_by": "metapp data join", "of": [source.name for source in sources]}

    def joint() -> Iterator[tuple[Task, str, str]]:
        with progress(name, len(entries), quiet=quiet) as bar:
            for (_, entry), task in zip(entries, shared, strict=True):
                yield task._replace(group=entry.group), entry.split, entry.source
                bar.advance(entry.name)

    return conversion_result(name, folder, write_data_set(folder, name, units, joint(), notes, overwrite=overwrite))


def _with_tensors(task: Task, shapes: Mapping[str, torch.Size], kind: int | None) -> Task:
    """Return a task with tensors of these shapes alone, and with the number of its data set unless that is None.

    Raises:
        ValueError: a tensor of another shape.
    """
    data = {key: task.data[key] for key in shapes}
    for key, shape in shapes.items():
        if data[key].shape != shape:
            raise ValueError(
                f"{task.name}: {key} {tuple(data[key].shape)}, expected {tuple(shape)} as in the others; "
                "convert all with the same --samples or --size."
            )
    return task._replace(data=data if kind is None else data | {KIND_TENSOR: torch.tensor([kind], dtype=torch.uint8)})
