"""The commands of `metapp data` that convert svBRDFs whose maps are known."""

from __future__ import annotations

import enum
import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import say
from metapp.cli.data_convert import Json, Out, Quiet, Size, Split, report
from metapp.experiments.convert import Reader, convert

if TYPE_CHECKING:
    from metapp.learning.task import Task

_APP = "svbrdf_nonstationary"
_SIZE = 256


class Green(enum.StrEnum):
    """Where the green of normals points."""

    OPENGL = "opengl"
    DIRECTX = "directx"
    AUTO = "auto"


def strips(
    paths: Annotated[list[Path], typer.Argument(metavar="FILES...", help="Strips, and folders searched at any depth.")],
    folder: Out,
    split: Annotated[
        Split,
        typer.Option(
            "--split",
            help="Where the tasks belong. auto: no base material on both sides, a fifth or more for tests; what blends "
            "materials of both sides is left out.",
        ),
    ] = Split.AUTO,
    size: Size = _SIZE,
    gamma: Annotated[
        float,
        typer.Option(min=0.1, max=10, metavar="G", help="How all tiles but the normals are encoded; 1 is linear."),
    ] = 1.0,
    white: Annotated[
        float,
        typer.Option(
            min=0.01,
            max=100,
            metavar="W",
            help="How bright white would be right below the flash, 1 where the photographs clip; they are made that "
            "much darker. The default is that of the published ones.",
        ),
    ] = 1.35,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert strips, images of five squares: flash photograph, normal, diffuse, roughness, specular.

    As Deschaintre et al. 2018 publish theirs: linear, normals with y up. Each becomes maps and photograph of --size. A
    bad file that was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

    The base materials are told by <number>;<material>X<material>;<preset>X<preset>.png; any other strip is of a
    material of its own. Where base materials cannot be parted, since all are blended with all, their presets are.

    Examples:
      metapp data strips DeepMaterialsData/trainBlended --out svbrdf
      metapp data strips strips --gamma 2.2 --white 1 --split test --out svbrdf
    """
    module = importlib.import_module("data_tools.formats.strips")

    sources = {source.resolve(): source for source in module.find(paths)[0]}
    groups = module.group_strips(sources)
    sides: dict[Path, str] = {}
    left_out: set[Path] = set()
    notes = {"made_by": "metapp data strips", "size": size, "gamma": gamma, "white": white}
    if split is Split.AUTO:
        parted = module.split_strips(list(sources))
        sides, left_out = parted.sides, set(parted.left_out)
        notes |= {"split_by": parted.by, "left_out": len(left_out)}
        for line in _about(parted.by, len(left_out), len(sources)):
            say(f"warning: {line}")

    def find(named: Iterable[Path]) -> tuple[list[Path], list[str]]:
        found, skipped = module.find(named)
        return [source for source in found if source.resolve() not in left_out], skipped

    def read(source: Path) -> Task:
        return module.read_task(source, size, gamma, white)._replace(group=groups[source.resolve()])

    def split_of(source: Path) -> str:
        return sides[source.resolve()]

    reader = Reader(
        _APP, "strip", module.UNITS, find, lambda source: module.task_name(source.stem), read, notes, split_of
    )
    report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


def _about(by: str, left_out: int, count: int) -> list[str]:
    """What a person should know about how strips were split."""
    lines = []
    if by == "preset":
        lines.append("base materials are blended with all others: training and test strips show other presets of them.")
    if left_out:
        lines.append(f"{left_out} of {count} strips left out: they blend {by}s of training with {by}s of tests.")
    return lines


def maps(
    paths: Annotated[list[Path], typer.Argument(metavar="FOLDERS...", help="Folders of maps, searched at any depth.")],
    folder: Out,
    split: Annotated[
        Split,
        typer.Option(
            "--split",
            help="Where the tasks belong. auto: of the sorted names, every fifth is a test task; variants with the "
            "same normal map stay together.",
        ),
    ] = Split.AUTO,
    size: Size = _SIZE,
    normals: Annotated[
        Green,
        typer.Option(
            help="Where the green of normals points: up (opengl) or down (directx). auto: as names say (gl, dx), else "
            "as a height field could have it."
        ),
    ] = Green.AUTO,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert materials whose maps are separate images, such as rock_diffuse.png beside rock_normal.png.

    Base colour (diffuse, albedo, basecolor, color), normal, roughness or gloss, and, where there are any, specular or
    metallic; any case and format. Colours of 8 or 16 bit are sRGB. Of each map the central square is taken, scaled to
    --size, and the photograph under a flash is rendered. A bad material is skipped with a warning.

    A colour without such a word, rock.png beside rock_norm.png and rock_gloss.png, is an old game's: its gloss is how
    strongly a highlight shines, which is converted to a roughness.

    Examples:
      metapp data maps materials --out svbrdf
      metapp data maps materials/rock --normals directx --split test --out rock
    """
    module = importlib.import_module("data_tools.formats.material_maps")

    materials = {each.source.resolve(): each for each in module.find_materials(paths)[0]}
    sides = module.split_materials(materials.values())

    def name(source: Path) -> str:
        return module.task_name(materials[source.resolve()].title)

    def read(source: Path) -> Task:
        return module.read_task(source, size, normals.value)._replace(group=sides[source.resolve()][1])

    def split_of(source: Path) -> str:
        return sides[source.resolve()][0]

    notes = {"made_by": "metapp data maps", "size": size, "normals": normals.value}
    reader = Reader(_APP, "material", module.UNITS, module.find, name, read, notes, split_of)
    report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)
