"""What readers find, as paths."""

from collections.abc import Callable
from pathlib import Path

from data_tools.readers.input_source import Sources


def paths_of(find: Callable[[Path], Sources], path: Path) -> tuple[list[Path], list[str]]:
    """The paths of the sources that a reader's `find` returns, and its lines about skipped files."""
    sources, skipped = find(path)
    return [source.path for source in sources], skipped
