"""Data sets drawn for `metapp data synth` and `metapp data cornell`."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import typer

from data_tools.synthetic import transport
from metapp.cli.arguments import check_new_file
from metapp.cli.synthesis_options import SHARDS_FORM, CornellOptions
from metapp.learning.task import Task
from metapp.runs.inputs.conversion import ConversionResult, conversion_result
from metapp.runs.inputs.embedded import embedded_module, make_embedded_set, split_counts
from metapp.runs.reporter import progress
from metapp.storage.shards import read_manifest, write_data_set


def draw_shards(
    name: str,
    seed: int,
    count: int | None,
    folder: Path | None,
    options: Mapping[str, object],
    *,
    overwrite: bool,
    quiet: bool,
) -> ConversionResult:
    """Draw an embedded data set as shards, which fits read; see :func:`metapp.runs.inputs.embedded.make_embedded_set`.

    Args:
        name: of the application.
        seed: of all draws.
        count: how many tasks; None for as many as the default set has.
        folder: the folder of the set; None for the cache.
        options: of the set, by name.
        overwrite: whether a data set that is in `folder` is replaced.
        quiet: no progress.

    Raises:
        ValueError: the set has not one of the options; a folder that holds other data.
    """
    made = make_embedded_set(name, seed, count, folder, quiet, options, overwrite=overwrite)
    return conversion_result(name, made, read_manifest(made).tasks)


def draw_files(
    name: str, form: str, folder: Path | None, count: int | None, seed: int, *, overwrite: bool, quiet: bool
) -> ConversionResult:
    """Draw an embedded data set and write it in another form than shards, in the folders train and test.

    Args:
        name: of the application.
        form: one of those that the set's module has in FILES.
        folder: the folder to write to.
        count: how many tasks; None for as many as the default set has.
        seed: of all draws.
        overwrite: whether files that are there are replaced.
        quiet: no progress.

    Raises:
        BadParameter: there is no such form; no folder, or one that holds files.
        ValueError: no room on the disk.
    """
    forms = getattr(embedded_module(name), "FILES", {})
    if form not in forms:
        expected = ", ".join([SHARDS_FORM, *forms])
        raise typer.BadParameter(f"'{form}': expected {expected} for {name}.", param_hint="--as")
    if folder is None:
        raise typer.BadParameter(f"missing, expected a folder for the {form} files.", param_hint="--out")
    counts = split_counts(name, count)
    for split in counts:
        check_new_file(folder / split, overwrite)
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
    return ConversionResult(name, str(folder), names["train"], names["test"], [])


def draw_cornell_boxes(
    options: CornellOptions, folder: Path, seed: int, *, overwrite: bool, quiet: bool
) -> ConversionResult:
    """Draw Cornell boxes, trace their light paths and write them as a data set.

    Args:
        options: number of scenes and of samples, and the split.
        folder: the folder of the set.
        seed: of all draws.
        overwrite: whether a data set that is in `folder` is replaced.
        quiet: no progress.

    Raises:
        ValueError: Mitsuba cannot be used here; a folder that holds other data.
    """
    tasks = transport.cornell_tasks(options.count, seed, samples=options.samples, held=options.held)
    notes = {"made_by": "metapp data cornell", "seed": seed, "count": options.count, "split": options.split}

    def boxes() -> Iterator[tuple[Task, str, str]]:
        with progress("Cornell boxes", options.count, quiet=quiet) as bar:
            for task in tasks:
                yield task, options.split, ""
                bar.advance(task.name)

    units, beside = transport.UNITS, transport.BESIDE
    written = write_data_set(folder, "transport", units, boxes(), notes, beside, overwrite=overwrite)
    return conversion_result("transport", folder, written)
