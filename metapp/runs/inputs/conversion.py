"""Turning a user's files into a data set: one loop for every format."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from data_tools.readers.input_source import Source, Sources
from metapp.apps import class_of
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.runs.environment import torch_defaults
from metapp.runs.inputs.finding import bind_reader_arguments
from metapp.runs.reporter import progress, say
from metapp.storage.files import check_readable, error_about_file
from metapp.storage.folders import PathKind, cache_lookups, check_files_of_user, path_kind, path_refusal
from metapp.storage.shards import AUTO_SPLIT, SPLITS, ManifestEntry, write_data_set


class ConversionResult(NamedTuple):
    """The result of a conversion: names by split, and a line for each file that was skipped."""

    app: str
    out: str
    train: list[str]
    test: list[str]
    skipped: list[str]


def conversion_result(
    app: str, out: Path, entries: Sequence[ManifestEntry], skipped: Iterable[str] = ()
) -> ConversionResult:
    """The names in a data set that was written."""
    names = {split: [entry.name for entry in entries if entry.split == split] for split in ("train", "test")}
    return ConversionResult(app, str(out), names["train"], names["test"], list(skipped))


def convert_files(
    name: str,
    paths: Iterable[Path],
    out: Path,
    split: str,
    options: Mapping[str, object],
    *,
    overwrite: bool = False,
    quiet: bool = False,
) -> ConversionResult:
    """Write the tasks of files and folders to `out`, all or nothing.

    A file that was named must be good; one that was found in a folder may be bad: it is skipped with a warning.

    Args:
        name: of the format.
        paths: files, and folders to search.
        out: folder of the data set.
        split: "train", "test" or "auto".
        options: keywords of the format's `read_task`; those that are set become notes of the data set, of paths the
            base name.
        overwrite: whether a data set that is there is replaced.
        quiet: no progress.

    Raises:
        ValueError: a bad path or named file, a folder without a usable one, two tasks of one name.
    """
    form = registry().formats[name]
    reader = form.load()
    paths, expected = list(paths), f"files for metapp data {name}"
    for path in paths:
        check_files_of_user(path, expected, data_sets=form.data_sets)
    try:
        with cache_lookups():
            found, skipped = _find(reader.find, paths)
    except ValueError:
        if runs := [path for path in paths if path_kind(path) is PathKind.RUN_FOLDERS]:  # nothing of a user beside them
            raise ValueError(path_refusal(runs[0], expected)) from None
        raise
    searched = {folder for _, folder in found.values()} - {None}
    own = getattr(reader, "entries", entries_by_place)(list(found), searched, split)
    entries: dict[Path, ManifestEntry] = {place: own[place] for place in found if place in own}
    _require_distinct(entries)
    bad: dict[Path, list[str]] = {}  # by the folder that was searched
    usable: set[Path | None] = set()
    shown = {key: value.name if isinstance(value, Path) else value for key, value in options.items() if value}
    notes = {"made_by": f"metapp data {name}", **shown, "split": split}

    def read() -> Iterator[tuple[Task, str, Path]]:
        with progress(name, len(entries), quiet=quiet) as bar:
            for place, entry in entries.items():
                bar.name(entry.name)
                source, folder = found[place]
                try:
                    check_readable(place)
                    task = bind_reader_arguments(reader.read_task, {"content": source.content})(place, **options)
                except (ValueError, OSError) as error:
                    if folder is None:
                        raise error_about_file(error, place) from None
                    bad.setdefault(folder, []).append(str(error_about_file(error, place)))
                else:
                    part = entry.split or AUTO_SPLIT if split == AUTO_SPLIT else split
                    yield task._replace(name=entry.name, group=entry.group), part, place
                    usable.add(folder)
                bar.advance(entry.name)
        empty = [folder for folder in bad if folder not in usable]
        if empty and len(bad[empty[0]]) == 1:
            raise ValueError(bad[empty[0]][0])  # the one thing in it is likely what was meant
        skipped.extend(line for lines in bad.values() for line in lines)
        for line in skipped:
            say(f"warning: skipped: {line}")
        if empty:
            raise ValueError(f"{empty[0]}: {len(bad[empty[0]])} sources, none usable; expected at least one.")

    with torch_defaults(single=class_of(form.app).single_threaded):  # small tensors, for which threads only wait
        written = write_data_set(out, form.app, reader.UNITS, read(), notes, overwrite=overwrite)
    return conversion_result(form.app, out, written, skipped)


def entries_by_place(sources: Sequence[Path], folders: object, split: str) -> dict[Path, ManifestEntry]:
    """Sources by the names of their files, and their splits: those of folders train/ and test/, which is said.

    The innermost folder that stands beside the other counts; whether only one of the two was named does not matter.
    """
    entries = {source: ManifestEntry(source.stem if source.is_file() else source.resolve().name) for source in sources}
    for source in sources if split == AUTO_SPLIT else ():
        inner = Path(os.path.abspath(source.parent))
        for folder in (inner, *inner.parents):
            if folder.name in SPLITS and all((folder.parent / name).is_dir() for name in SPLITS):
                entries[source] = entries[source]._replace(split=folder.name)
                break
    if any(entry.split for entry in entries.values()):
        say("train/ and test/ keep their tasks apart; --split puts them together.")
    return entries


def _find(
    find: Callable[[Path], Sources], paths: Iterable[Path]
) -> tuple[dict[Path, tuple[Source, Path | None]], list[str]]:
    """Find all sources by their paths, each once, with the folder it was found in (None: it was named).

    Returns:
        These, and lines about skipped files.
    """
    sources_by_path: dict[Path, tuple[Source, Path | None]] = {}
    skipped: list[str] = []
    for path in paths:
        check_readable(path)
        sources, lines = find(path)
        skipped += lines
        for source in sources:
            key = source.path.resolve()
            if not path.is_dir() or key not in sources_by_path:
                sources_by_path[key] = (source, path if path.is_dir() else None)
    return {source.path: (source, folder) for source, folder in sources_by_path.values()}, skipped


def _require_distinct(entries: Mapping[Path, ManifestEntry]) -> None:
    """Refuse two tasks of one name."""
    names: dict[str, Path] = {}
    for source, entry in entries.items():
        other = names.setdefault(entry.name, source)
        if other is not source:
            raise ValueError(
                f"{other} and {source}: two tasks named '{entry.name}', expected names that differ; rename one, or "
                "convert them into two folders."
            )
