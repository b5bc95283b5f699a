"""The conversion of a user's files into a data set, by one loop for every format.

Readers of formats (`data_tools.readers`) decide how a file is read, and `metapp.storage.shards` how a data set lies on
disk. Here files are found, named, read one by one, and skipped if they are damaged.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from data_tools.readers.input_source import Source, Sources
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.runs.environment import torch_defaults
from metapp.runs.inputs.finding import bind_reader_arguments
from metapp.runs.inputs.refusals import check_files_of_user
from metapp.runs.reporter import progress, say
from metapp.storage.files import check_readable, error_about_file
from metapp.storage.folders import cache_lookups
from metapp.storage.shards import AUTO_SPLIT, SPLITS, ManifestEntry, write_data_set


class ConversionResult(NamedTuple):
    """The result of a conversion.

    Attributes:
        app: the name of the application.
        out: the folder of the data set, as text.
        train: names of the training tasks.
        test: names of the test tasks.
        skipped: a line for each file that was skipped.
    """

    app: str
    out: str
    train: list[str]
    test: list[str]
    skipped: list[str]


def conversion_result(
    app: str, out: Path, entries: Sequence[ManifestEntry], skipped: Iterable[str] = ()
) -> ConversionResult:
    """Return the result of a conversion by the data set that was written.

    Args:
        app: the name of the application.
        out: the folder of the data set.
        entries: the entries of its manifest.
        skipped: a line for each file that was skipped.
    """
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
    """Convert files and folders into a data set, all or nothing.

    A file that the user named must be good. A damaged file that was found in a folder is skipped with a warning.

    Args:
        name: the name of the format.
        paths: files, and folders to search.
        out: the folder of the data set.
        split: "train", "test" or "auto".
        options: keywords of the format's `read_task`. Those that are set become notes of the data set; of a path its
            base name does.
        overwrite: whether a data set that is in `out` is replaced.
        quiet: whether no progress is shown.

    Raises:
        ValueError: a path or a named file is bad, a folder has no usable file, or two tasks have one name.
    """
    application, form = registry().find_format(name)
    reader = form.load()
    paths = list(paths)
    for path in paths:
        check_files_of_user(path, f"files for metapp data {name}", data_sets=form.data_sets)
    with cache_lookups():
        sources, skipped = _find_sources(reader.find, paths)
    searched_folders = {folder for _, folder in sources.values()} - {None}
    format_entries = getattr(reader, "entries", entries_by_place)(list(sources), searched_folders, split)
    entries: dict[Path, ManifestEntry] = {place: format_entries[place] for place in sources if place in format_entries}
    _require_distinct_names(entries)
    errors_by_folder: dict[Path, list[str]] = {}  # by the folder that was searched
    usable_folders: set[Path | None] = set()
    option_notes = {key: value.name if isinstance(value, Path) else value for key, value in options.items() if value}
    notes = {"made_by": f"metapp data {name}", **option_notes, "split": split}

    def read_tasks() -> Iterator[tuple[Task, str, Path]]:
        with progress(name, len(entries), quiet=quiet) as bar:
            for place, entry in entries.items():
                bar.set_label(entry.name)
                source, folder = sources[place]
                try:
                    check_readable(place)
                    task = bind_reader_arguments(reader.read_task, {"content": source.content})(place, **options)
                except (ValueError, OSError) as error:
                    if folder is None:
                        raise error_about_file(error, place) from None
                    errors_by_folder.setdefault(folder, []).append(str(error_about_file(error, place)))
                else:
                    task_split = entry.split or AUTO_SPLIT if split == AUTO_SPLIT else split
                    yield task._replace(name=entry.name, group=entry.group), task_split, place
                    usable_folders.add(folder)
                bar.advance(entry.name)
        useless_folders = [folder for folder in errors_by_folder if folder not in usable_folders]
        if useless_folders and len(errors_by_folder[useless_folders[0]]) == 1:
            # the folder holds one file, which is likely what the user meant
            raise ValueError(errors_by_folder[useless_folders[0]][0])
        skipped.extend(line for lines in errors_by_folder.values() for line in lines)
        for line in skipped:
            say(f"warning: skipped: {line}")
        if useless_folders:
            count = len(errors_by_folder[useless_folders[0]])
            raise ValueError(
                f"{useless_folders[0]}: {count} sources, none usable, expected one or more; see the warnings above."
            )

    with torch_defaults(single=application.app.load().small_tensors):  # small tensors, for which threads only wait
        written = write_data_set(out, application.name, reader.UNITS, read_tasks(), notes, overwrite=overwrite)
    return conversion_result(application.name, out, written, skipped)


def entries_by_place(sources: Sequence[Path], folders: object, split: str) -> dict[Path, ManifestEntry]:
    """Name sources by their files, and take their splits from folders train/ and test/ if they lie in these.

    The innermost folder of such a pair counts, even if the user named only one of the two. A line says that splits were
    taken from folders.

    Args:
        sources: the files, or the folders of a single task.
        folders: the folders that were searched, which this naming does not need.
        split: "train", "test" or "auto"; folders count for "auto" alone.

    Returns:
        The entries of the manifest to be, by source.
    """
    entries = {source: ManifestEntry(source.stem if source.is_file() else source.resolve().name) for source in sources}
    for source in sources if split == AUTO_SPLIT else ():
        parent = Path(os.path.abspath(source.parent))
        for folder in (parent, *parent.parents):
            if folder.name in SPLITS and all((folder.parent / name).is_dir() for name in SPLITS):
                entries[source] = replace(entries[source], split=folder.name)
                break
    if any(entry.split for entry in entries.values()):
        say("train/ and test/ keep their tasks apart; --split puts them together.")
    return entries


def _find_sources(
    find: Callable[[Path], Sources], paths: Iterable[Path]
) -> tuple[dict[Path, tuple[Source, Path | None]], list[str]]:
    """Find all sources in files and folders, each once.

    Args:
        find: the format's function that finds sources in a path.
        paths: files, and folders to search.

    Returns:
        By its path each source with the folder it was found in, None if the user named it; and lines about skipped
        files.
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


def _require_distinct_names(entries: Mapping[Path, ManifestEntry]) -> None:
    """Refuse two tasks of one name.

    Raises:
        ValueError: there are two; the message names their sources.
    """
    sources_by_name: dict[str, Path] = {}
    for source, entry in entries.items():
        other = sources_by_name.setdefault(entry.name, source)
        if other is not source:
            raise ValueError(
                f"{other} and {source}: two tasks named '{entry.name}', expected names that differ; rename one, or "
                "convert them into two folders."
            )
