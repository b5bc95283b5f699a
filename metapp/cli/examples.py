"""`metapp examples`: commands that work as they are, and the input files that they name."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli import completion
from metapp.cli.console import out, print_json
from metapp.cli.data_convert import check_folder
from metapp.cli.options import Json
from metapp.runs.reporter import say
from metapp.storage.text import meant

FOLDER = Path("example-inputs")  # of the input files that commands name
VGG = ("texture", "svbrdf_stationary")  # whose fits read features of that network
# by application, what follows `metapp`, {} being that folder, and what it makes; the first is the quickest
COMMANDS: dict[str, tuple[tuple[str, str], ...]] = {
    "brdf": (
        ("meta brdf {}/paint.csv", "a network fitted to a table of measurements, and a picture of both"),
        ("meta brdf {}/paint.csv --export merl,mitsuba", "that network as a MERL table and as a material for Mitsuba"),
        ("quickft brdf {}/paint.csv", "the network fitted by a tuned Adam of as many steps, to compare"),
        ("baseline brdf {}/paint.csv --method ggx_2", "two GGX lobes fitted without a network"),
        ("plan brdf --samples 16 --out {}/plan.csv", "which 16 pairs of directions to measure, as a table to fill in"),
    ),
    "texture": (
        ("baseline texture {}/gravel.png --method quilting", "a texture quilted of the photo, without a network"),
        ("general texture {}/gravel.png", "a texture like the photo, by one forward pass"),
        ("meta texture {}/gravel.png", "a texture fitted in a few learned steps"),
        ("meta texture {}/gravel.png --size 512x768 --export png16", "a texture of 512 x 768 px as PNG of 16 bits"),
        ("quickft texture {}/gravel.png", "a texture fitted by a tuned Adam of as many steps, to compare"),
    ),
    "svbrdf_stationary": (
        (
            "baseline svbrdf_stationary {}/leather.png --method quilting",
            "maps quilted of a flash photo, without a network",
        ),
        ("general svbrdf_stationary {}/leather.png", "tiling maps of a flash photo, by one forward pass"),
        ("general svbrdf_stationary {}/leather.png --export gltf", "maps as a material in glTF"),
        ("meta svbrdf_stationary {}/leather.png", "maps fitted in a few learned steps"),
        ("meta svbrdf_stationary {}/leather.png --size 512x512 --export blender", "maps of 512 px for Blender"),
    ),
    "svbrdf_nonstationary": (
        ("general svbrdf_nonstationary {}/mosaic.png --observe photo", "maps of a flash photo, by one forward pass"),
        ("meta svbrdf_nonstationary {}/mosaic.png --observe photo", "maps fitted in a few learned steps"),
        (
            "meta svbrdf_nonstationary {}/mosaic.png --observe photo --export blender,gltf",
            "maps for Blender, and a material in glTF",
        ),
        ("quickft svbrdf_nonstationary {}/mosaic.png --observe photo", "maps fitted by a tuned Adam, to compare"),
        ("baseline svbrdf_nonstationary {}/mosaic.png --observe photo --method flat", "maps of one value each"),
    ),
    "illumination": (
        ("general illumination {}/courtyard.exr", "an environment map as a network, by one forward pass"),
        (
            "meta illumination {}/courtyard.exr --size 256x512",
            "a map fitted in a few learned steps, as EXR of 256 rows",
        ),
        ("meta illumination {}/ball.png --observe photo", "an HDR map of one LDR photo of a mirror ball"),
        ("data ball {}/ball.png --out {}/ball", "the light that the ball mirrors, without a network"),
        ("baseline illumination {}/courtyard.exr --method sh", "the map as spherical harmonics, to compare"),
    ),
    "transport": (
        ("general transport {}/box.xml", "the light paths of a scene as a density, by one forward pass; renders by it"),
        ("meta transport {}/box.xml", "the density fitted in a few learned steps"),
        ("meta transport {}/box.xml --render 64", "the scene guided at all bounces, and unguided in the same time"),
        ("quickft transport {}/box.xml", "the density fitted by a tuned Adam of as many steps, to compare"),
        ("data cornell --count 2 --out {}/boxes", "two random Cornell boxes, traced, as a data set"),
    ),
}


def lines_of(app: str, folder: Path, most: int | None = None) -> list[tuple[str, str]]:
    """The first commands of an application on input files in a folder, and what each makes."""
    place = shlex.quote(str(folder))
    return [(f"metapp {line.replace('{}', place)}", makes) for line, makes in COMMANDS[app][:most]]


def command(
    app: Annotated[
        str,
        typer.Argument(
            metavar="[APP]",
            autocompletion=completion.applications,
            help="An application; default: two commands of each.",
        ),
    ] = "",
    folder: Annotated[
        Path | None,
        typer.Option(
            "--make", metavar="DIR", callback=check_folder, help="Write the input files of the commands to DIR."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Print commands that can be run as printed, five per application, and what each makes.

    --make writes their input files, which are small, synthetic and no training data.
    The output is a shell script.

    Example: metapp examples brdf --make example-inputs
    """
    if app and app not in COMMANDS:
        raise typer.BadParameter(f"'{app}': expected one of {', '.join(COMMANDS)}.{meant(app, COMMANDS)}")
    apps, files = [app] if app else list(COMMANDS), []
    if folder:
        from data_tools.synthetic.examples import write_example

        files = [file for name in apps for file in write_example(name, folder)]
    found = {name: lines_of(name, folder or FOLDER, None if app else 2) for name in apps}
    if json:
        shown = [{"app": name, "command": line, "makes": makes} for name in apps for line, makes in found[name]]
        print_json({"files": [str(file) for file in files], "commands": shown})
        return
    first = [] if folder else [(f"metapp examples {f'{app} ' if app else ''}--make {FOLDER}", "the input files, first")]
    if needy := [name for name in VGG if name in apps]:
        first.append(("metapp data vgg", f"what fits of {' and '.join(needy)} read, once: 64 to 550 MB"))
    lines = [*first, *(line for name in apps for line in found[name])]
    out().print("\n".join(f"# {makes}\n{line}" for line, makes in lines), markup=False, soft_wrap=True)
    if files:
        say(f"made: {', '.join(map(str, files))}")
