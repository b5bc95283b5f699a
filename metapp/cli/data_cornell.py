"""The command of `metapp data` that draws Cornell boxes and traces their light paths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from metapp.cli.data_convert import Out, Quiet, Split, SplitOption, report
from metapp.cli.options import Json, takes
from metapp.runs.convert import converted
from metapp.runs.reporter import progress


@dataclass(frozen=True)
class Cornell:
    """The options of `cornell`."""

    folder: Out
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Scenes.")] = 10
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="Of all random draws.")] = 0
    split: SplitOption = Split.AUTO
    samples: Annotated[
        int, typer.Option(min=1, metavar="N", help="Samples per scene for fits to see; the paper has 288,000.")
    ] = 32_768
    held: Annotated[int, typer.Option(min=1, metavar="M", help="Samples per scene for tests alone.")] = 8_192
    dimensions: Annotated[
        int,
        typer.Option(min=4, max=6, metavar="D", help="Of a sample: 4, film and a direction; 6, a second direction."),
    ] = 4
    quiet: Quiet = False
    as_json: Json = False


@takes(Cornell)
def cornell(options: Cornell) -> None:
    """Draw Cornell boxes and trace their light paths.

    In each are one to five spheres of diffuse, glass or metal material, a mirror on a side wall and an area light on
    the ceiling, all at random places. Its samples are points of primary sample space, in proportion to the luminance
    that their paths carry; 2 s each. The scene, a dictionary of Mitsuba 3, is a .json file beside its shard.

    Examples:
      metapp data cornell --count 20 --seed 7 --out boxes
      metapp data cornell --count 4 --samples 288000 --dimensions 6 --split test --out boxes
    """
    from data_tools.synthetic import transport
    from metapp.storage.shards import ShardWriter

    if options.dimensions % 2:
        raise typer.BadParameter(f"{options.dimensions}, expected 4 or 6.", param_hint="--dimensions")
    count, seed, split = options.count, options.seed, options.split.value
    tasks = transport.cornell_tasks(
        count, seed, samples=options.samples, held=options.held, dimensions=options.dimensions
    )
    notes = {"made_by": "metapp data cornell", "seed": seed, "count": count, "split": split}
    shown = progress("Cornell boxes", count, quiet=options.quiet)
    with ShardWriter(options.folder, "transport", transport.UNITS, notes, transport.BESIDE) as writer, shown as bar:
        for task in tasks:
            writer.add(task, split)
            bar.advance(task.name)
        done = converted("transport", options.folder, writer.entries())
    report(done, options.quiet, options.as_json)
