"""The commands of `metapp data` that convert files of one kind, and the options that all its commands share."""

from __future__ import annotations

import enum
import functools
import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metapp.cli.console import print_json, say
from metapp.experiments.convert import Converted, Reader, convert

if TYPE_CHECKING:
    from metapp.learning.task import Task

_SAMPLES = 65_536
_SIZE, _MIN_SIZE, _MAX_SIZE = 256, 32, 4096


class Split(enum.StrEnum):
    """Where tasks belong."""

    TRAIN = "train"
    TEST = "test"
    AUTO = "auto"


def check_folder(path: Path | None) -> Path | None:
    """Refuse a folder to write to that cannot be one, before any work is done."""
    for part in (path, *path.parents) if path else ():
        if part.exists() and not part.is_dir():
            raise typer.BadParameter(f"{part}: a file, expected a folder to write to; choose another one.")
    return path


Out = Annotated[
    Path, typer.Option("--out", "-o", metavar="DIR", callback=check_folder, help="Folder to write to; made if missing.")
]
SplitOption = Annotated[
    Split,
    typer.Option(
        "--split",
        help="Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16).",
    ),
]
Samples = Annotated[
    int,
    typer.Option(
        min=2, metavar="N", help="Samples (pairs of directions) per material; the first half is for fits to see."
    ),
]
Size = Annotated[int, typer.Option(min=_MIN_SIZE, max=_MAX_SIZE, metavar="PX", help="Side of the pictures.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line of standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")]


def merl(
    paths: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help=".binary files, and folders searched at any depth.")
    ],
    folder: Out,
    split: SplitOption = Split.AUTO,
    samples: Samples = _SAMPLES,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert MERL tables, measured BRDFs.

    A table (Matusik et al. 2003) has 34,992,012 bytes. It becomes samples (angles in rad, reflectance in 1/sr, linear
    RGB) at the centres of measured bins. A bad file that was named ends the conversion and nothing is written; one
    found in a folder is skipped with a warning.

    Examples:
      metapp data merl BRDFDatabase/brdfs --out merl
      metapp data merl gold.binary steel.binary --split test --out metals
    """
    module, tasks = (
        importlib.import_module("data_tools.formats.merl"),
        importlib.import_module("data_tools.formats.brdf_task"),
    )

    read = functools.partial(module.read_task, samples=samples)
    notes = {"made_by": "metapp data merl", "samples": samples}
    reader = Reader("brdf", "MERL file", tasks.UNITS, module.find_merl, lambda source: source.stem, read, notes)
    report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


def nbrdf(
    paths: Annotated[list[Path], typer.Argument(metavar="DIRS...", help="Folders of networks, searched at any depth.")],
    folder: Out,
    split: SplitOption = Split.AUTO,
    samples: Samples = _SAMPLES,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert NBRDF networks, BRDFs as small neural networks.

    A network (Sztrajman et al. 2021) is a folder with fc1.npy, fc2.npy, fc3.npy, b1.npy, b2.npy, b3.npy. It becomes
    samples (angles in rad, reflectance in 1/sr, linear RGB) above the horizon, named by its folder. Several may share
    a folder, each with its name in front: gold_fc1.npy. A folder without a usable network ends the conversion and
    nothing is written; further bad networks are skipped with a warning.

    Examples:
      metapp data nbrdf trained --out nbrdf
      metapp data nbrdf trained/gold trained/tin --split test --out metals
    """
    module, tasks = (
        importlib.import_module("data_tools.formats.nbrdf"),
        importlib.import_module("data_tools.formats.brdf_task"),
    )

    read = functools.partial(module.read_task, samples=samples)
    notes = {"made_by": "metapp data nbrdf", "samples": samples}
    reader = Reader(
        "brdf", "NBRDF network", tasks.UNITS, module.find_nbrdf, lambda source: source.resolve().name, read, notes
    )
    report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


def images(
    paths: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help="Image files, and folders searched at any depth.")
    ],
    folder: Out,
    app: Annotated[
        str, typer.Option("--app", metavar="APP", help="The application whose tasks they become.")
    ] = "texture",
    split: SplitOption = Split.AUTO,
    size: Size = _SIZE,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert photographs, such as those of textures.

    Any format of OpenImageIO: JPEG, PNG, TIFF, EXR and more. Of each the central square is taken, upright, scaled in
    linear light to --size, and kept as 8-bit sRGB. A bad file that was named ends the conversion and nothing is
    written; one found in a folder is skipped with a warning.

    Examples:
      metapp data images photographs --out textures
      metapp data images bark.jpg sand.png --split test --size 512 --out textures
    """
    from metapp.apps import app_names, load_app

    if app != "texture" and (app not in app_names() or "images" not in load_app(app).readers):
        raise typer.BadParameter(f"'{app}' reads no images, expected texture or another that does.", param_hint="--app")
    module = importlib.import_module("data_tools.formats.images")

    read = functools.partial(module.read_task, size=size)
    notes = {"made_by": "metapp data images", "size": size}
    reader = Reader(app, "image", module.UNITS, module.find, lambda source: source.stem, read, notes)
    report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


def flash(
    paths: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help="Photographs, and folders searched at any depth.")
    ],
    folder: Out,
    split: Annotated[
        Split,
        typer.Option(
            "--split",
            help="Where the tasks belong. auto: as names or folders say (train, test), if they say both; else of the "
            "sorted materials every fifth is for tests.",
        ),
    ] = Split.AUTO,
    size: Size = _SIZE,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert flash photographs of flat materials.

    Of each the central square is taken, where the flash is, upright, scaled in linear light to --size, and kept as
    8-bit sRGB. All photographs of a material belong to one split. A bad file that was named ends the conversion and
    nothing is written; one found in a folder is skipped with a warning.

    The material is told by <split>_<material>_<image>.jpg, by <split>/<material>/<image>.jpg (Henzler et al. 2021),
    or by <material>/<image>.jpg below the folder; any other photograph is of a material of its own.

    Examples:
      metapp data flash flash_images --out flash
      metapp data flash wood.jpg tiles.jpg --split test --out flash
    """
    module = importlib.import_module("data_tools.formats.flash")

    photos = module.find_shown(paths)
    splits = module.split_by_material(photos) if split is Split.AUTO else {}

    def name(source: Path) -> str:
        return photos[source.resolve()].name

    def read(source: Path) -> Task:
        return module.read_task(source, size)._replace(name=name(source), group=photos[source.resolve()].material)

    def split_of(source: Path) -> str:
        return splits[source.resolve()]

    notes = {"made_by": "metapp data flash", "size": size}
    reader = Reader("svbrdf_stationary", "photograph", module.UNITS, module.find, name, read, notes, split_of)
    report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


def laval(
    paths: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help="HDR maps (.exr, .hdr), and folders searched at any depth.")
    ],
    folder: Out,
    split: SplitOption = Split.AUTO,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Convert HDR environment maps, such as those of the Laval indoor set.

    Any lat-long map (Gardner et al. 2017 publish 2048 x 1024 EXR) with floating-point RGB or gray pixels. It becomes
    linear Rec.709 of 64 x 128 texels, averaged over solid angle, of mean luminance 1 beside the scale it had, and four
    photographs of spheres under it. A bad file that was named ends the conversion and nothing is written; one found in
    a folder is skipped with a warning.

    Examples:
      metapp data laval IndoorHDR --out laval
      metapp data laval office.exr street.hdr --split test --out maps
    """
    module = importlib.import_module("data_tools.formats.latlong")

    notes = {"made_by": "metapp data laval", "rows": module.HEIGHT}
    name, read = (lambda source: source.stem), module.read_map_task
    reader = Reader("illumination", "map", module.UNITS, module.find_maps, name, read, notes)
    report(convert(reader, paths, folder, split.value, quiet), quiet, as_json)


def report(done: Converted, quiet: bool, as_json: bool) -> None:
    """Say what was written, for a person and for scripts."""
    if not quiet:
        skipped = f"; {len(done.skipped)} skipped" if done.skipped else ""
        say(f"{done.app}: {len(done.train)} train + {len(done.test)} test tasks in {done.out}{skipped}")
    if as_json:
        print_json(done._asdict())
