"""`metapp data synth` and `metapp data cornell`: draw data sets."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.data import report
from metapp.cli.options import Json, Out, Overwrite, Quiet, Seed, app_words, check_folder, check_new, takes
from metapp.names import did_you_mean
from metapp.options import Converter, Option
from metapp.registry import registry
from metapp.runs.inputs.convert import Converted, converted
from metapp.runs.inputs.embedded import embedded_apps, embedded_data, embedded_module, split_counts
from metapp.runs.reporter import progress

if TYPE_CHECKING:
    from metapp.learning.task import Task

SHARDS = "shards"


@dataclass(frozen=True)
class SynthOptions:
    """Options of embedded sets; None and False stand for the set's own value."""

    count: Annotated[
        int | None,
        Option("Tasks in total, of both splits in its proportion; default: the default set's.", low=1, high=1_000_000),
    ] = None
    size: Annotated[
        int | None,
        Option(
            "Side of the pictures of texture, svbrdf_stationary (256) and svbrdf_nonstationary (128).",
            "PX",
            low=32,
            high=4096,
        ),
    ] = None
    rows: Annotated[int | None, Option("Rows of the maps of illumination (64).", low=32, high=1024)] = None
    photos: Annotated[
        int | None,
        Option(
            "Flash photos of each material of svbrdf_nonstationary, all but the first from places of their own (1).",
            low=1,
            high=9,
        ),
    ] = None
    anisotropic: Annotated[bool, Option("Of brdf: brushed metals, cloths and others that depend on phi_h.")] = False


@takes(SynthOptions)
def synth(
    options: SynthOptions,
    name: Annotated[
        str,
        typer.Argument(metavar="APP", autocompletion=app_words, help=f"{', '.join(embedded_apps())}."),
    ],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            callback=check_folder,
            show_default="the user's cache",
            help="Folder to write to; made if missing.",
        ),
    ] = None,
    seed: Seed = 0,
    form: Annotated[
        str,
        typer.Option(
            "--as",
            metavar="FORM",
            help="shards, what metapp reads, or merl: files in DIR/train and DIR/test.",
        ),
    ] = SHARDS,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Draw an embedded data set: synthetic tasks, the same on every machine."""
    count, own = options.count, {key: value for key, value in vars(options).items() if value and key != "count"}
    apps = embedded_apps()
    if name not in apps:
        raise typer.BadParameter(
            f"'{name}' has no embedded data set, expected one of {', '.join(apps)}.{did_you_mean(name, apps)}",
            param_hint="APP",
        )
    if form == SHARDS:
        from metapp.storage.shards import read_manifest

        made = embedded_data(name, seed, count, folder, quiet, own, overwrite=overwrite)
        done = converted(name, made, read_manifest(made).tasks)
    else:
        if own:
            flag = f"--{next(iter(own))}".replace("_", "-")
            raise typer.BadParameter(f"{form}: has no {flag}, expected shards with it.", param_hint="--as")
        done = _write_files(name, form, folder, split_counts(name, count), seed, overwrite=overwrite, quiet=quiet)
    report(done, quiet, as_json)


def _write_files(
    name: str, form: str, folder: Path | None, counts: dict[str, int], seed: int, *, overwrite: bool, quiet: bool
) -> Converted:
    """Write an embedded set in another form than shards."""
    forms = getattr(embedded_module(name), "FILES", {})
    if form not in forms:
        expected = ", ".join([SHARDS, *forms])
        raise typer.BadParameter(f"'{form}': expected {expected} for {name}.", param_hint="--as")
    if folder is None:
        raise typer.BadParameter(f"missing, expected a folder for the {form} files.", param_hint="--out")
    for split in counts:
        check_new(folder / split, overwrite)
    write, size = forms[form]
    needed = sum(counts.values()) * size
    free = shutil.disk_usage(next(part for part in (folder, *folder.absolute().parents) if part.exists())).free
    if free < needed:
        raise ValueError(
            f"{folder}: {free / 1e9:.1f} GB free, expected {needed / 1e9:.1f} GB for {sum(counts.values())} {form} "
            "files; take a smaller --count."
        )
    names: dict[str, list[str]] = {}
    folder.mkdir(parents=True, exist_ok=True)
    with progress(f"{form} files", sum(counts.values()), quiet=quiet) as bar:
        for split, number in counts.items():
            names[split] = []
            for task in write(folder / split, split, number, seed):
                names[split].append(task)
                bar.advance(task)
    return Converted(name, str(folder), names["train"], names["test"], [])


synth.__doc__ = "\n\n".join(
    [
        str(synth.__doc__),
        "\n".join(["Sets:", *(f"  {name}: {embedded.help}" for name, embedded in registry().synthetic.items())]),
        "Examples:\n  metapp data synth brdf\n  metapp data synth brdf --count 10 --seed 1 --as merl --out materials",
    ]
)


@dataclass(frozen=True)
class CornellOptions(Converter):
    """Options of Cornell boxes."""

    count: Annotated[int, Option("Scenes.", low=1, high=100_000)] = 10
    samples: Annotated[int, Option("Samples per scene for fits to see; the paper has 288,000.", low=1)] = 32_768
    held: Annotated[int, Option("Samples per scene for tests alone.", "M", low=1)] = 8_192


@takes(CornellOptions)
def cornell(
    options: CornellOptions,
    folder: Out,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Draw Cornell boxes and trace their light paths.

    In each are one to five spheres of diffuse, glass or metal material, a mirror on a side wall and an area light on
    the ceiling, all at random places. Its samples are points of primary sample space, in proportion to the luminance
    that their paths carry; 2 s each. The scene, a dictionary of Mitsuba 3, is a .json file beside its shard.

    Examples:
      metapp data cornell --count 20 --seed 7 --out boxes
      metapp data cornell --count 4 --samples 288000 --split test --out boxes
    """
    from data_tools.synthetic import transport
    from metapp.storage.shards import write_shard

    tasks = transport.cornell_tasks(options.count, seed, samples=options.samples, held=options.held)
    notes = {"made_by": "metapp data cornell", "seed": seed, "count": options.count, "split": options.split}

    def boxes() -> Iterator[tuple[Task, str, str]]:
        with progress("Cornell boxes", options.count, quiet=quiet) as bar:
            for task in tasks:
                yield task, options.split, ""
                bar.advance(task.name)

    units, beside = transport.UNITS, transport.BESIDE
    written = write_shard(folder, "transport", units, boxes(), notes, beside, overwrite=overwrite)
    done = converted("transport", folder, written)
    report(done, quiet, as_json)
