"""The options of the application transport. Help and completion read this module, so it imports nothing large."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from typing_extensions import override

from metapp.options import INPUT, OUTPUT, AppOptions, Option


def require_folders(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return paths unchanged if all of them are folders.

    Raises:
        ValueError: a path is no folder.
    """
    if not all(path.is_dir() for path in paths):
        raise ValueError("expected folders that exist")
    return paths


@dataclass(frozen=True)
class TransportOptions(AppOptions):
    """The options of light transport: folders of a scene's files, and the picture that is rendered of it."""

    scene_root: Annotated[
        tuple[Path, ...],
        Option(
            "Additional folder from which a scene may load files; may be given several times.",
            "DIR",
            panel=INPUT,
            parse=require_folders,
        ),
    ] = ()
    render: Annotated[
        int,
        Option(
            "Also render each scene at this size, with path guiding and without it in equal time.",
            "PX",
            low=1,
            high=4096,
            panel=OUTPUT,
        ),
    ] = 0

    @override
    def reader_keywords(self) -> dict[str, Any]:
        """Name the folders `roots`, as the reader does."""
        return {"roots": self.scene_root} if self.scene_root else {}
