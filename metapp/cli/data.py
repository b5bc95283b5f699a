"""`metapp data`: turn measurements and models into task shards."""

from __future__ import annotations

import enum
import functools
import importlib
import inspect
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp.cli.console import Exit, out, print_json, progress, say
from metapp.cli.convert import Converted, Reader, convert
from metapp.cli.embedded import embedded_apps, embedded_data, embedded_module, split_counts

app = typer.Typer(no_args_is_help=True, help="Make data sets from files or by drawing them, and check them.")

_SAMPLES = 65_536
_MERL_BYTES = 34_992_012


class Split(enum.StrEnum):
    """Where tasks belong."""

    TRAIN = "train"
    TEST = "test"
    AUTO = "auto"


class Form(enum.StrEnum):
    """What `synth` writes."""

    SHARDS = "shards"
    MERL = "merl"


def _command(function: Callable[..., None]) -> Callable[..., None]:
    """Register a command; for --help the paragraphs of its docstring flow, while indented examples keep their lines."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    return app.command(no_args_is_help=True, help=text)(function)


def _folder(path: Path | None) -> Path | None:
    """Refuse a folder to write to that cannot be one, before any work is done."""
    for part in (path, *path.parents) if path else ():
        if part.exists() and not part.is_dir():
            raise typer.BadParameter(f"{part}: a file, expected a folder to write to; choose another one.")
    return path


Out = Annotated[
    Path, typer.Option("--out", "-o", metavar="DIR", callback=_folder, help="Folder to write to; made if missing.")
]
SplitOption = Annotated[
    Split,
    typer.Option(
        "--split",
        help="Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16).",
    ),
]
Samples = Annotated[
    int,
    typer.Option(
        min=2, metavar="N", help="Samples (pairs of directions) per material; the first half is for fits to see."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line of standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")]


@_command
def synth(
    name: Annotated[str, typer.Argument(metavar="APP", help="The application; brdf has an embedded set.")],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            callback=_folder,
            show_default="the user's cache",
            help="Folder to write to; made if missing. All commands look in the cache, which METAPP_CACHE moves.",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", show_default="80 + 20", help="Tasks in total, training to test as 4 : 1."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="Of all random draws.")] = 0,
    form: Annotated[
        Form, typer.Option("--as", help="shards: what metapp reads. merl: .binary files in DIR/train and DIR/test.")
    ] = Form.SHARDS,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Draw an embedded data set: made-up tasks, the same on every machine.

    brdf: isotropic metals, plastics, paints, fabrics and mixtures of them, from physically based reflection models;
    about 1.6 MB and 0.1 s each, or 35 MB as a MERL file.

    Examples:
      metapp data synth brdf
      metapp data synth brdf --count 10 --seed 1 --as merl --out materials
    """
    if name not in embedded_apps():
        raise typer.BadParameter(
            f"'{name}' has no embedded data set, expected one of {', '.join(embedded_apps())}.", param_hint="APP"
        )
    if form is Form.MERL:
        done = _synth_merl(name, folder, count, seed, quiet)
    else:
        from metapp.manifest import read_manifest

        made = embedded_data(name, seed, count, folder, quiet)
        tasks = read_manifest(made).tasks
        names = {split: [task.name for task in tasks if task.split == split] for split in ("train", "test")}
        done = Converted(name, str(made), names["train"], names["test"], [])
    _report(done, quiet, as_json)


def _synth_merl(name: str, folder: Path | None, count: int | None, seed: int, quiet: bool) -> Converted:
    module = embedded_module(name)
    if not hasattr(module, "write_merl_files"):
        raise typer.BadParameter(f"merl: a format of BRDFs, expected shards for {name}.", param_hint="--as")
    if folder is None:
        raise typer.BadParameter("missing, expected a folder for the MERL files of 35 MB each.", param_hint="--out")
    counts = split_counts(name, count)
    needed = sum(counts.values()) * _MERL_BYTES
    free = shutil.disk_usage(next(part for part in (folder, *folder.absolute().parents) if part.exists())).free
    if free < needed:
        raise ValueError(
            f"{folder}: {free / 1e9:.1f} GB free, expected {needed / 1e9:.1f} GB for {sum(counts.values())} MERL "
            "files; take a smaller --count."
        )
    names: dict[str, list[str]] = {}
    with progress(quiet) as bar:
        shown = bar.add_task("MERL files", total=sum(counts.values()), note="")
        for split, number in counts.items():
            names[split] = []
            for material in module.write_merl_files(folder / split, split, number, seed):
                names[split].append(material)
                bar.update(shown, advance=1, note=material)
    return Converted(name, str(folder), names["train"], names["test"], [])


@_command
def merl(
    paths: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help=".binary files, and folders searched at any depth.")
    ],
    folder: Out,
    split: SplitOption = Split.AUTO,
    samples: Samples = _SAMPLES,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert MERL tables, measured BRDFs.

    A table (Matusik et al. 2003) has 34,992,012 bytes. It becomes samples (angles in rad, reflectance in 1/sr, linear
    RGB) at the centres of measured bins. A bad file that was named ends the conversion and nothing is written; one
    found in a folder is skipped with a warning.

    Examples:
      metapp data merl BRDFDatabase/brdfs --out merl
      metapp data merl gold.binary steel.binary --split test --out metals
    """
    module, tasks = importlib.import_module("data_tools.merl"), importlib.import_module("data_tools.brdf_task")

    read = functools.partial(module.read_task, samples=samples)
    notes = {"made_by": "metapp data merl", "samples": samples}
    reader = Reader("brdf", "MERL file", tasks.UNITS, module.find_merl, lambda source: source.stem, read, notes)
    _report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


@_command
def nbrdf(
    paths: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Folders of networks, searched at any depth.")],
    folder: Out,
    split: SplitOption = Split.AUTO,
    samples: Samples = _SAMPLES,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert NBRDF networks, BRDFs as small neural networks.

    A network (Sztrajman et al. 2021) is a folder with fc1.npy, fc2.npy, fc3.npy, b1.npy, b2.npy, b3.npy. It becomes
    samples (angles in rad, reflectance in 1/sr, linear RGB) above the horizon, named by its folder. Several may share
    a folder, each with its name in front: gold_fc1.npy. A folder without a usable network ends the conversion and
    nothing is written; further bad networks are skipped with a warning.

    Examples:
      metapp data nbrdf trained --out nbrdf
      metapp data nbrdf trained/gold trained/tin --split test --out metals
    """
    module, tasks = importlib.import_module("data_tools.nbrdf"), importlib.import_module("data_tools.brdf_task")

    read = functools.partial(module.read_task, samples=samples)
    notes = {"made_by": "metapp data nbrdf", "samples": samples}
    reader = Reader(
        "brdf", "NBRDF network", tasks.UNITS, module.find_nbrdf, lambda source: source.resolve().name, read, notes
    )
    _report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


@_command
def join(
    folders: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Data sets of one application.")],
    folder: Out,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Put several data sets into one; training tasks stay training tasks, test tasks stay test tasks.

    Example:
      metapp data join synthetic merl --out joint
    """
    from metapp.manifest import read_manifest
    from metapp.shards import ShardWriter, read_shard

    manifests = [read_manifest(each) for each in folders]
    name = manifests[0].app
    if folder.resolve() in [each.resolve() for each in folders]:
        raise ValueError(f"{folder}: one of the data sets to join, expected another folder to write to.")
    shapes: dict[str, Any] = {}
    notes = {"made_by": "metapp data join", "of": [each.name for each in folders]}
    with ShardWriter(folder, name, manifests[0].units, notes) as writer, progress(quiet) as bar:
        shown = bar.add_task("join", total=sum(len(manifest.tasks) for manifest in manifests), note="")
        for each, manifest in zip(folders, manifests, strict=True):
            tasks = {task.name: task for task in read_shard(each, app=name)}
            for entry in manifest.tasks:
                shapes = shapes or {key: value.shape for key, value in tasks[entry.name].data.items()}
                for key, value in tasks[entry.name].data.items():
                    if value.shape != shapes.get(key):
                        expected = tuple(shapes.get(key, ()))
                        raise ValueError(
                            f"{entry.name}: {key} {tuple(value.shape)}, expected {expected} as in the others; "
                            "convert all with the same --samples."
                        )
                writer.add(tasks[entry.name], entry.split, entry.source)
                bar.update(shown, advance=1, note=entry.name)
        train, test = ([e.name for e in writer.entries() if e.split == split] for split in ("train", "test"))
    _report(Converted(name, str(folder), train, test, []), quiet, as_json)


@_command
def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set, with its manifest.json.")],
    as_json: Json = False,
) -> None:
    """Verify a data set.

    Compares files with their SHA-256 hashes, looks for missing and foreign ones and for values that are not finite.
    Prints what it holds, then its problems, one a line; exit code 1 if there are any.

    Example:
      metapp data check merl
    """
    from metapp.manifest import read_manifest
    from metapp.shards import check_shard

    problems = check_shard(folder)
    try:
        manifest = read_manifest(folder)
    except ValueError:
        if not as_json:
            raise
        print_json({"app": None, "folder": str(folder), "problems": problems})
        raise typer.Exit(Exit.FAILED) from None
    counts = {split: sum(task.split == split for task in manifest.tasks) for split in ("train", "test")}
    files = [folder / task.file for task in manifest.tasks]
    size = sum(file.stat().st_size for file in files if file.is_file())
    if as_json:
        document = {"app": manifest.app, "folder": str(folder), **counts, "bytes": size, "units": manifest.units}
        print_json({**document, "problems": problems})
    else:
        lines = [
            f"{folder}: {manifest.app}, {counts['train']} train + {counts['test']} test tasks, {size / 1e6:,.1f} MB"
        ]
        lines += [f"  {key}: {unit}" for key, unit in manifest.units.items()]
        out.print("\n".join(lines), markup=False, soft_wrap=True)
        for problem in problems:
            say(f"problem: {problem}")
        out.print(f"{len(problems)} problems" if problems else "no problems", markup=False)
    if problems:
        raise typer.Exit(Exit.FAILED)


def _report(done: Converted, quiet: bool, as_json: bool) -> None:
    if not quiet:
        skipped = f"; {len(done.skipped)} skipped" if done.skipped else ""
        say(f"{done.app}: {len(done.train)} train + {len(done.test)} test tasks in {done.out}{skipped}")
    if as_json:
        print_json(done._asdict())
