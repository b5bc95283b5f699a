"""Options of the commands that draw data sets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from metapp.options import Converter, Option

SHARDS_FORM = "shards"  # the form that fits read


@dataclass(frozen=True)
class SynthOptions:
    """Options of embedded sets; None and False stand for the set's own value."""

    count: Annotated[
        int | None,
        Option("Tasks in total, of both splits in its proportion; default: the default set's.", low=1, high=1_000_000),
    ] = None
    size: Annotated[
        int | None,
        Option(
            "Side of the pictures of texture, svbrdf_stationary (256) and svbrdf_nonstationary (128).",
            "PX",
            low=32,
            high=4096,
        ),
    ] = None
    rows: Annotated[int | None, Option("Rows of the maps of illumination (64).", low=32, high=1024)] = None
    photos: Annotated[
        int | None,
        Option(
            "Flash photos of each material of svbrdf_nonstationary, all but the first from places of their own (1).",
            low=1,
            high=9,
        ),
    ] = None
    anisotropic: Annotated[bool, Option("Of brdf: brushed metals, cloths and others that depend on phi_h.")] = False


@dataclass(frozen=True)
class CornellOptions(Converter):
    """Options of Cornell boxes."""

    count: Annotated[int, Option("Scenes.", low=1, high=100_000)] = 10
    samples: Annotated[int, Option("Samples per scene for fits to see; the paper has 288,000.", low=1)] = 32_768
    held: Annotated[int, Option("Samples per scene for tests alone.", "M", low=1)] = 8_192
