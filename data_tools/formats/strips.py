"""Strips of five squares: flash photograph, normal, diffuse, roughness, specular (Deschaintre et al. 2018)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from data_tools.formats import AUTO, Conversion, Files, Format, Reader, Setting
from data_tools.formats.images import SIZE

if TYPE_CHECKING:
    from metapp.learning.task import Task

HELP = """Convert strips, images of five squares: flash photograph, normal, diffuse, roughness, specular.

As Deschaintre et al. 2018 publish theirs: linear, normals with y up. Each becomes maps and photograph of --size. A
bad file that was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

The base materials are told by <number>;<material>X<material>;<preset>X<preset>.png; any other strip is of a
material of its own. Where base materials cannot be parted, since all are blended with all, their presets are.

Examples:
  metapp data strips DeepMaterialsData/trainBlended --out svbrdf
  metapp data strips strips --gamma 2.2 --white 1 --split test --out svbrdf
"""
SPLIT = (
    "Where the tasks belong. auto: no base material on both sides, a fifth or more for tests; what blends materials of "
    "both sides is left out."
)
GAMMA = Setting("gamma", 1.0, "How all tiles but the normals are encoded; 1 is linear.", "G", low=0.1, high=10)
WHITE = Setting(
    "white",
    1.35,
    "How bright white would be right below the flash, 1 where the photographs clip; they are made that much darker. "
    "The default is that of the published ones.",
    "W",
    low=0.01,
    high=100,
)


def _files() -> Files:
    from data_tools.readers import strips

    return strips


def _reader(paths: list[Path], split: str, *, size: int, gamma: float, white: float) -> Reader:
    from data_tools.readers import strips

    sources = {source.resolve(): source for source in strips.find(paths)[0]}
    groups = strips.group_strips(sources)
    sides: dict[Path, str] = {}
    left_out: set[Path] = set()
    notes = {"made_by": "metapp data strips", "size": size, "gamma": gamma, "white": white}
    remarks: tuple[str, ...] = ()
    if split == AUTO:
        parted = strips.split_strips(list(sources))
        sides, left_out = dict(parted.sides), set(parted.left_out)
        notes |= {"split_by": parted.by, "left_out": len(left_out)}
        remarks = _remarks(parted.by, len(left_out), len(sources))

    def find(named: Iterable[Path]) -> tuple[list[Path], list[str]]:
        found, skipped = strips.find(named)
        return [source for source in found if source.resolve() not in left_out], skipped

    def read(source: Path) -> Task:
        return strips.read_task(source, size, gamma, white)._replace(group=groups[source.resolve()])

    def split_of(source: Path) -> str:
        return sides[source.resolve()]

    def name(source: Path) -> str:
        return strips.task_name(source.stem)

    return Reader("svbrdf_nonstationary", "strip", strips.UNITS, find, name, read, notes, split_of, remarks)


def _remarks(by: str, left_out: int, count: int) -> tuple[str, ...]:
    """Say what a person should know about how strips were split."""
    lines = []
    if by == "preset":
        lines.append("base materials are blended with all others: training and test strips show other presets of them.")
    if left_out:
        lines.append(f"{left_out} of {count} strips left out: they blend {by}s of training with {by}s of tests.")
    return tuple(lines)


FORMAT = Format(
    "strips",
    "svbrdf_nonstationary",
    "",  # `svbrdf` takes them
    _files,
    conversion=Conversion(
        HELP, _reader, ("FILES...", "Strips, and folders searched at any depth."), (SIZE, GAMMA, WHITE), SPLIT
    ),
)
