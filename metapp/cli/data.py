"""The commands of `metapp data` that convert files, join data sets and check them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import Exit, out, print_json
from metapp.cli.options import Json, Out, Overwrite, Quiet, takes
from metapp.options import Converter
from metapp.runs.inputs.convert import Converted, convert, converted
from metapp.runs.reporter import progress, say

if TYPE_CHECKING:
    from metapp.learning.task import Task


def convert_by(name: str, converter: type[Converter]) -> Callable[..., None]:
    """The command that converts files of the format of that name, with the converter's help and options."""

    def command(
        options: Converter,
        paths: Annotated[
            list[Path], typer.Argument(metavar="PATHS...", help="Files, and folders that are searched at any depth.")
        ],
        folder: Out,
        overwrite: Overwrite = False,
        quiet: Quiet = False,
        as_json: Json = False,
    ) -> None:
        done = convert(name, paths, folder, options.split, options.arguments(), overwrite=overwrite, quiet=quiet)
        report(done, quiet, as_json)

    command.__doc__ = converter.__doc__
    return takes(converter)(command)


def report(done: Converted, quiet: bool, as_json: bool) -> None:
    """Print the tasks that were written, for a person and for scripts."""
    if not quiet:
        skipped = f"; {len(done.skipped)} skipped" if done.skipped else ""
        say(f"{done.app}: {len(done.train)} train + {len(done.test)} test tasks in {done.out}{skipped}")
    if as_json:
        print_json(done._asdict())


def join(
    folders: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Data sets of one application.")],
    folder: Out,
    alike: Annotated[bool, typer.Option("--alike", help="Training draws as many of each, whatever they hold.")] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Put several data sets into one; training tasks stay training tasks, test tasks stay test tasks.

    Tensors that not all tasks hold, such as reference relightings of synthetic materials, are left out.

    Example:
      metapp data join drawn photographed --alike --out joint
    """
    import torch

    from metapp.apps import class_of
    from metapp.learning.task import KIND
    from metapp.storage.shards import read_manifest, read_shard, write_shard

    if folder.resolve() in [source.resolve() for source in folders]:
        raise ValueError(f"{folder}: one of the data sets to read, expected another folder to write to.")
    manifests = [read_manifest(source) for source in folders]
    app = class_of(name := manifests[0].app)
    sets = [{task.name: task for task in read_shard(source, app=name, holds=app.tensors)} for source in folders]
    every = [task.data for tasks in sets for task in tasks.values()]
    shapes = {key: value.shape for key, value in every[0].items() if all(key in data for data in every)}
    units = {key: unit for key, unit in manifests[0].units.items() if key in shapes}
    units |= {KIND: "uint8 [1], which of the joined data sets"} if alike else {}

    def shared(task: Task, kind: int) -> Task:
        data = {key: task.data[key] for key in shapes}
        for key, shape in shapes.items():
            if data[key].shape != shape:
                raise ValueError(
                    f"{task.name}: {key} {tuple(data[key].shape)}, expected {tuple(shape)} as in the others; "
                    "convert all with the same --samples or --size."
                )
        return task._replace(data=data | ({KIND: torch.tensor([kind], dtype=torch.uint8)} if alike else {}))

    pairs = [(entry, shared(sets[i][entry.name], i)) for i in range(len(sets)) for entry in manifests[i].tasks]
    notes = {"made_by": "metapp data join", "of": [source.name for source in folders]}

    def joint() -> Iterator[tuple[Task, str, str]]:
        with progress(name, len(pairs), quiet=quiet) as bar:
            for entry, task in pairs:
                yield task._replace(group=entry.group), entry.split, entry.source
                bar.advance(entry.name)

    done = converted(name, folder, write_shard(folder, name, units, joint(), notes, overwrite=overwrite))
    report(done, quiet, as_json)


def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set, with its manifest.json.")],
    as_json: Json = False,
) -> None:
    """Verify a data set.

    Compares files with their SHA-256 hashes, looks for missing and foreign ones, for tensors that the application
    cannot use (missing, of another shape or type) and for values that are not finite.
    Prints its content, then its problems, one a line; exit code 1 if there are any.

    Example:
      metapp data check merl
    """
    from metapp.apps import class_of
    from metapp.storage.shards import check_shard, read_manifest

    try:
        manifest = read_manifest(folder)
        problems = check_shard(folder, class_of(manifest.app).tensors)
    except ValueError as error:
        if not as_json:
            raise
        print_json({"app": None, "folder": str(folder), "problems": [str(error)]})
        raise typer.Exit(Exit.FAILED) from None
    counts = {split: sum(task.split == split for task in manifest.tasks) for split in ("train", "test")}
    files = [folder / task.file for task in manifest.tasks]
    size = sum(file.stat().st_size for file in files if file.is_file())
    if as_json:
        document = {"app": manifest.app, "folder": str(folder), **counts, "bytes": size, "units": manifest.units}
        print_json({**document, "problems": problems})
    else:
        head = f"{folder}: {manifest.app}, {counts['train']} train + {counts['test']} test tasks, {size / 1e6:,.1f} MB"
        lines = [head] + [f"  {key}: {unit}" for key, unit in manifest.units.items()]
        out().print("\n".join(lines), soft_wrap=True)
        for problem in problems:
            say(f"problem: {problem}")
        out().print(f"{len(problems)} problem{'s' * (len(problems) != 1)}" if problems else "no problems")
    if problems:
        raise typer.Exit(Exit.FAILED)
