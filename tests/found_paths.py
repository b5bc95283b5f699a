"""The sources that readers find, as paths, which tests compare more easily."""

from collections.abc import Callable
from pathlib import Path

from data_tools.readers.input_source import Sources


def find_paths(find: Callable[[Path], Sources], path: Path) -> tuple[list[Path], list[str]]:
    """Return the paths of the sources that a reader's `find` returns, and its lines about skipped files."""
    sources, skipped = find(path)
    return [source.path for source in sources], skipped
