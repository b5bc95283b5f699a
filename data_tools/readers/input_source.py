"""A source: one input that a fit can be made of, as the reader of its format finds it.

Readers return sources without the fields that only their caller knows, such as the format.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from data_tools.readers.listing import FoundFiles
from metapp.application import Facts

ANISOTROPIC_FACT, SAMPLE_COUNT_FACT, PHOTO_COUNT_FACT = "anisotropic", "samples", "photos"
LAMP_COUNT_FACT = "lamps"  # number of photographs by a camera that stands still, each under a lamp of its own
DEFAULT_PHOTO_PX = 256  # side of the picture that a reader makes of a photograph unless told otherwise
DAMAGED_FACT = "damaged"  # a source that cannot be read; it has no part in choosing a recipe
REFERENCE_FACT = "reference"  # False for a photo alone, without the thing itself, so that fits can only observe a photo


@dataclass(frozen=True)
class Source:
    """One input that a fit can be made of.

    Attributes:
        name: the name of the task that it is read as.
        path: the file or folder.
        facts: what its reader found out while it looked, by name, such as the number of photos; recipes are chosen by
            them.
        content: what the reader has parsed already and takes back as `read_task(path, content=...)`; None for nothing.

    >>> Source("gold", Path("gold.binary")).facts
    {}
    """

    name: str
    path: Path
    facts: Facts = field(default_factory=dict)
    content: object = field(default=None, repr=False, compare=False)


Sources = tuple[list[Source], list[str]]  # what a path holds, and the line of each skipped file of a folder


def sources_of_files(found: FoundFiles, facts: Facts = MappingProxyType({})) -> Sources:
    """Return files as sources named by their stems.

    Args:
        found: the files and the line of each skipped file.
        facts: what is known of each of the files.
    """
    files, skipped = found
    return [Source(file.stem, file, facts=facts) for file in files], skipped
