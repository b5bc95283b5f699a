"""Scene files of Mitsuba as inputs of light transport."""

from __future__ import annotations

from pathlib import Path

from metapp.door import Format, InMemory, Option, SceneCheck

_HERE = "metapp.extensions.scene_files"


def folders(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """The same paths; ValueError unless all are folders."""
    if not all(path.is_dir() for path in paths):
        raise ValueError("not there, expected folders")
    return paths


ROOTS = Option(
    "scene_root",
    None,
    "Additional folder from which a scene may load files; may be given several times.",
    "DIR",
    several=True,
    convert=folders,
    passed_as="roots",
)
OFFERS = (
    Format(
        "mitsuba",
        "transport",
        f"{_HERE}.reading",
        "Mitsuba scenes (.xml, .json) with a perspective camera",
        options=(ROOTS,),
    ),
    InMemory("transport", f"{_HERE}.reading:from_object"),
    SceneCheck(f"{_HERE}.checking:stored"),
)
