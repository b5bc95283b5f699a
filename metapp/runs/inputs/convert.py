"""Turning a user's files into a data set: one loop for every kind of file."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from data_tools.formats import AUTO
from data_tools.readers.conversion import Conversion
from metapp.registry import Format
from metapp.runs.reporter import progress, say
from metapp.storage.files import check_readable, named

if TYPE_CHECKING:
    from metapp.storage.manifest import Entry


class Converted(NamedTuple):
    """The result of a conversion: names by split, and a line for each file that was skipped."""

    app: str
    out: str
    train: list[str]
    test: list[str]
    skipped: list[str]


def converted(app: str, out: Path, entries: Sequence[Entry], skipped: Iterable[str] = ()) -> Converted:
    """The names in a data set that was written."""
    names = {split: [entry.name for entry in entries if entry.split == split] for split in ("train", "test")}
    return Converted(app, str(out), names["train"], names["test"], list(skipped))


def conversion_of(name: str, form: Format, paths: list[Path], split: str, options: Mapping[str, object]) -> Conversion:
    """The conversion of files of a format by the options of its command; ValueError for bad paths."""
    assert form.command is not None
    module = form.load()
    if hasattr(module, "conversion"):
        result: Conversion = module.conversion(paths, split, **options)
        return result
    read = functools.partial(module.read_task, **options)
    notes = {"made_by": f"metapp data {name}", **options}
    return Conversion(form.app, form.command.noun, module.UNITS, module.find, read, notes)


def convert(
    conversion: Conversion,
    paths: Iterable[Path],
    out: Path,
    split: str,
    *,
    overwrite: bool = False,
    quiet: bool = False,
) -> Converted:
    """Write the tasks of files and folders to `out`, all or nothing.

    A file that was named must be good; one that was found in a folder may be bad: it is skipped with a warning.

    Args:
        conversion: of this kind of file.
        paths: files, and folders to search.
        out: folder of the data set.
        split: "train", "test" or "auto".
        overwrite: whether a data set that is there is replaced.
        quiet: no progress.

    Raises:
        ValueError: a bad path or named file, a folder without a usable one, two tasks of one name.
    """
    from metapp.storage.shards import ShardWriter

    sources, skipped = _find(conversion, paths)
    folders = splits_by_folder(sources) if split == AUTO else {}
    bad: dict[Path, list[str]] = {}  # by the folder that was searched
    usable: set[Path] = set()
    notes = {**conversion.notes, "split": split}
    with ShardWriter(out, conversion.app, conversion.units, notes, overwrite=overwrite) as writer:
        with progress(f"{conversion.noun}s", len(sources), quiet=quiet) as bar:
            for source, searched in sources.items():
                label = conversion.label(source)
                bar.name(label.name)
                try:
                    task = conversion.read(source)
                except (ValueError, OSError) as error:
                    if searched is None:
                        raise named(error, source) from None
                    bad.setdefault(searched, []).append(str(named(error, source)))
                else:
                    part = (label.split or folders.get(source, AUTO)) if split == AUTO else split
                    writer.add(task._replace(name=label.name, group=label.group), part, source)
                    usable |= {searched} if searched else set()
                bar.advance(label.name)
        empty = [folder for folder in bad if folder not in usable]
        if empty and len(bad[empty[0]]) == 1:
            raise ValueError(bad[empty[0]][0])  # the one thing in it is likely what was meant
        skipped += [line for lines in bad.values() for line in lines]
        for line in skipped:
            say(f"warning: skipped: {line}")
        if empty:
            raise ValueError(
                f"{empty[0]}: {len(bad[empty[0]])} {conversion.noun}s, none usable; expected at least one."
            )
        entries = writer.entries()
    return converted(conversion.app, out, entries, skipped)


def splits_by_folder(sources: Iterable[Path]) -> dict[Path, str]:
    """The splits of sources in a folder train/ or test/ that stands beside the other, which is said.

    The innermost such folder counts, and whether only one of the two was named does not matter.
    """
    from metapp.storage.manifest import SPLITS

    splits: dict[Path, str] = {}
    for source in sources:
        inner = Path(os.path.abspath(source.parent))
        for folder in (inner, *inner.parents):
            if folder.name in SPLITS and all((folder.parent / name).is_dir() for name in SPLITS):
                splits[source] = folder.name
                break
    if splits:
        say("train/ and test/ keep their tasks apart; --split puts them together.")
    return splits


def _find(conversion: Conversion, paths: Iterable[Path]) -> tuple[dict[Path, Path | None], list[str]]:
    """All sources, each once, with the folder it was found in (None: it was named), and lines about skipped files."""
    sources_by_path: dict[Path, tuple[Path, Path | None]] = {}
    skipped: list[str] = []
    for path in paths:
        check_readable(path)
        sources, lines = conversion.find([path])
        skipped += lines
        for source in sources:
            key = source.resolve()
            if not path.is_dir() or key not in sources_by_path:
                sources_by_path[key] = (source, path if path.is_dir() else None)
    names: dict[str, Path] = {}
    for source, _ in sources_by_path.values():
        name = conversion.label(source).name
        other = names.setdefault(name, source)
        if other is not source:
            raise ValueError(
                f"{other} and {source}: two tasks named '{name}', expected names that differ; "
                "rename one, or convert them into two folders."
            )
    return dict(sources_by_path.values()), skipped
