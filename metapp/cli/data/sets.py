"""The commands of `metapp data` that make data sets of data sets, or of Cornell boxes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import Exit, out, print_json
from metapp.cli.data.convert import Out, Quiet, Split, SplitOption, report
from metapp.cli.options import Json, Overwrite, Seed, takes
from metapp.runs.inputs.convert import converted
from metapp.runs.reporter import progress, say

if TYPE_CHECKING:
    from metapp.learning.task import Task


@dataclass(frozen=True)
class Cornell:
    """The options of `cornell`."""

    folder: Out
    count: Annotated[int, typer.Option(min=1, max=100_000, metavar="N", help="Scenes.")] = 10
    seed: Seed = 0
    split: SplitOption = Split.AUTO
    samples: Annotated[
        int, typer.Option(min=1, metavar="N", help="Samples per scene for fits to see; the paper has 288,000.")
    ] = 32_768
    held: Annotated[int, typer.Option(min=1, metavar="M", help="Samples per scene for tests alone.")] = 8_192
    overwrite: Overwrite = False
    quiet: Quiet = False
    as_json: Json = False


@takes(Cornell)
def cornell(options: Cornell) -> None:
    """Draw Cornell boxes and trace their light paths.

    In each are one to five spheres of diffuse, glass or metal material, a mirror on a side wall and an area light on
    the ceiling, all at random places. Its samples are points of primary sample space, in proportion to the luminance
    that their paths carry; 2 s each. The scene, a dictionary of Mitsuba 3, is a .json file beside its shard.

    Examples:
      metapp data cornell --count 20 --seed 7 --out boxes
      metapp data cornell --count 4 --samples 288000 --split test --out boxes
    """
    from data_tools.synthetic import transport
    from metapp.storage.shards import ShardWriter

    count, seed, split = options.count, options.seed, options.split.value
    tasks = transport.cornell_tasks(count, seed, samples=options.samples, held=options.held)
    notes = {"made_by": "metapp data cornell", "seed": seed, "count": count, "split": split}
    bars = progress("Cornell boxes", count, quiet=options.quiet)
    new = ShardWriter(
        options.folder, "transport", transport.UNITS, notes, transport.BESIDE, overwrite=options.overwrite
    )
    with new as writer, bars as bar:
        for task in tasks:
            writer.add(task, split)
            bar.advance(task.name)
        done = converted("transport", options.folder, writer.entries())
    report(done, options.quiet, options.as_json)


def join(
    folders: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Data sets of one application.")],
    folder: Out,
    alike: Annotated[bool, typer.Option("--alike", help="Training draws as many of each, whatever they hold.")] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Put several data sets into one; training tasks stay training tasks, test tasks stay test tasks.

    What not all tasks hold, such as reference relightings of synthetic materials, is left out.

    Example:
      metapp data join drawn photographed --alike --out joint
    """
    import torch

    from metapp.apps import class_of
    from metapp.learning.task import KIND
    from metapp.storage.shards import ShardWriter, read_manifest, read_shard

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
    new = ShardWriter(folder, name, units, notes, overwrite=overwrite)
    with new as writer, progress(name, len(pairs), quiet=quiet) as bar:
        for entry, task in pairs:
            writer.add(task._replace(group=entry.group), entry.split, entry.source)
            bar.advance(entry.name)
        done = converted(name, folder, writer.entries())
    report(done, quiet, as_json)


def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set, with its manifest.json.")],
    as_json: Json = False,
) -> None:
    """Verify a data set.

    Compares files with their SHA-256 hashes, looks for missing and foreign ones, for tensors that the application
    cannot use (missing, of another shape or type) and for values that are not finite.
    Prints what it holds, then its problems, one a line; exit code 1 if there are any.

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
