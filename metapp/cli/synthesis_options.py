"""Options of the commands that draw data sets.

They are apart from the work, so that help and completion import nothing large to read them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from metapp.options import Converter, Option

SHARDS_FORM = "shards"  # value of --as for the format that fits read


@dataclass(frozen=True)
class SynthOptions:
    """Options of `metapp data synth`; None and False stand for the set's own default."""

    count: Annotated[
        int | None,
        Option("Number of tasks, training and test tasks together; default: as stated above.", low=1, high=1_000_000),
    ] = None
    size: Annotated[
        int | None,
        Option(
            "Side of pictures of texture, svbrdf_stationary (default: 256) and svbrdf_nonstationary (default: 128).",
            "PX",
            low=32,
            high=4096,
        ),
    ] = None
    rows: Annotated[int | None, Option("Rows of the maps of illumination; default: 64.", low=32, high=1024)] = None
    photos: Annotated[
        int | None,
        Option(
            "Flash photos of each material of svbrdf_nonstationary, from random places but for the first; default: 1.",
            low=1,
            high=9,
        ),
    ] = None
    maps: Annotated[
        bool,
        Option("Store the true maps of training materials of svbrdf_stationary, by which General of `full` learns."),
    ] = False
    anisotropic: Annotated[
        bool, Option("Draw anisotropic BRDFs: brushed metals, cloths and others that depend on phi_h.")
    ] = False


@dataclass(frozen=True)
class CornellOptions(Converter):
    """Options of `metapp data cornell`."""

    count: Annotated[int, Option("Number of scenes.", low=1, high=100_000)] = 10
    samples: Annotated[int, Option("Samples per scene that fits may see; the paper has 288,000.", low=1)] = 32_768
    held_out: Annotated[int, Option("Held-out samples per scene, on which errors are measured.", "M", low=1)] = 8_192
