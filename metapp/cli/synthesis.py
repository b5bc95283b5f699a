"""The work of `metapp data synth` and `metapp data cornell`: data sets are drawn and written.

The generators are in :mod:`data_tools.synthetic`; here are folders, file formats, progress and refusals.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import typer

from data_tools.synthetic import transport
from metapp.application import Application
from metapp.cli.arguments import check_new_file
from metapp.cli.synthesis_options import SHARDS_FORM, CornellOptions
from metapp.learning.task import Task
from metapp.runs.data_sets.conversion import ConversionResult, conversion_result
from metapp.runs.data_sets.embedded import embedded_module, make_embedded_set, split_counts
from metapp.runs.reporter import progress
from metapp.storage.cache_folders import make_cache_folder
from metapp.storage.shards import read_manifest, write_data_set


def draw_shards(
    application: Application,
    seed: int,
    count: int | None,
    folder: Path | None,
    options: Mapping[str, object],
    *,
    overwrite: bool,
    quiet: bool,
) -> ConversionResult:
    """Draw an embedded data set as shards, which fits read.

    See :func:`metapp.runs.data_sets.embedded.make_embedded_set`.

    Args:
        application: the application.
        seed: the seed of all random draws.
        count: the number of tasks; None takes as many as the default set has.
        folder: the folder of the set; None takes the user's cache.
        options: options of the set, by name.
        overwrite: whether a data set in `folder` is replaced.
        quiet: whether no progress is shown.

    Raises:
        ValueError: the set lacks one of the options, the folder holds other data, or the cache cannot be written to.
    """
    if folder is None:
        make_cache_folder()  # refused here: a temporary one would keep the set for this command alone
    set_folder = make_embedded_set(application, seed, count, folder, quiet, options, overwrite=overwrite)
    return conversion_result(application.name, set_folder, read_manifest(set_folder).tasks)


def draw_files(
    application: Application,
    form: str,
    folder: Path | None,
    count: int | None,
    seed: int,
    *,
    overwrite: bool,
    quiet: bool,
) -> ConversionResult:
    """Draw an embedded data set and write it in another format than shards, in the folders train and test.

    Args:
        application: the application.
        form: a format that the set's module has in FILES.
        folder: the folder to write to.
        count: the number of tasks; None takes as many as the default set has.
        seed: the seed of all random draws.
        overwrite: whether existing files are replaced.
        quiet: whether no progress is shown.

    Raises:
        BadParameter: the format is unknown, no folder is given, or the folder holds files.
        ValueError: the disk has not enough room.
    """
    formats = getattr(embedded_module(application), "FILES", {})
    if form not in formats:
        expected = ", ".join([SHARDS_FORM, *formats])
        raise typer.BadParameter(f"'{form}': expected {expected} for {application.name}.", param_hint="--as")
    if folder is None:
        raise typer.BadParameter(f"missing, expected a folder for the {form} files.", param_hint="--out")
    counts = split_counts(application, count)
    for split in counts:
        check_new_file(folder / split, overwrite)
    write_files, file_bytes = formats[form]
    needed_bytes = sum(counts.values()) * file_bytes
    free_bytes = shutil.disk_usage(
        next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    ).free
    if free_bytes < needed_bytes:
        raise ValueError(
            f"{folder}: {free_bytes / 1e9:.1f} GB free, expected {needed_bytes / 1e9:.1f} GB for "
            f"{sum(counts.values())} {form} files; take a smaller --count."
        )
    names: dict[str, list[str]] = {}
    folder.mkdir(parents=True, exist_ok=True)
    with progress(f"{form} files", sum(counts.values()), quiet=quiet) as bar:
        for split, task_count in counts.items():
            names[split] = []
            for task_name in write_files(folder / split, split, task_count, seed):
                names[split].append(task_name)
                bar.advance(task_name)
    return ConversionResult(application.name, str(folder), names["train"], names["test"], [])


def draw_cornell_boxes(
    options: CornellOptions, folder: Path, seed: int, *, overwrite: bool, quiet: bool
) -> ConversionResult:
    """Draw Cornell boxes, trace their light paths and write them as a data set.

    Args:
        options: number of scenes and of samples, and the split.
        folder: the folder of the set.
        seed: the seed of all random draws.
        overwrite: whether a data set in `folder` is replaced.
        quiet: whether no progress is shown.

    Raises:
        ValueError: Mitsuba cannot be used here, or the folder holds other data.
    """
    tasks = transport.cornell_tasks(options.count, seed, samples=options.samples, held_out=options.held_out)
    notes = {"made_by": "metapp data cornell", "seed": seed, "count": options.count, "split": options.split}

    def yield_boxes() -> Iterator[tuple[Task, str, str]]:
        with progress("Cornell boxes", options.count, quiet=quiet) as bar:
            for task in tasks:
                yield task, options.split, ""
                bar.advance(task.name)

    units, beside = transport.UNITS, transport.BESIDE
    written = write_data_set(folder, "transport", units, yield_boxes(), notes, beside, overwrite=overwrite)
    return conversion_result("transport", folder, written)
