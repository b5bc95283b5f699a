"""Formats of BRDFs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from metapp.options import Option
from metapp.registry import Entry, Export, Format, Registry


@dataclass(frozen=True)
class SampleOptions:
    """Options of conversions of BRDFs."""

    samples: Annotated[
        int,
        Option(
            "Samples (pairs of directions) per material; the first half is for fits to see.",
            "N",
            low=2,
            high=10_000_000,
        ),
    ] = 65_536


MERL = """Convert MERL tables, measured BRDFs.

A table (Matusik et al. 2003) has 34,992,012 bytes. It becomes samples (angles in rad, reflectance in 1/sr, linear
RGB) at the centres of measured bins. A bad file that was named ends the conversion and nothing is written; one
found in a folder is skipped with a warning.

Examples:
  metapp data merl BRDFDatabase/brdfs --out merl
  metapp data merl gold.binary steel.binary --split test --out metals
"""
NBRDF = """Convert NBRDF networks, BRDFs as small neural networks.

A network (Sztrajman et al. 2021) is a folder with fc1.npy, fc2.npy, fc3.npy, b1.npy, b2.npy, b3.npy. It becomes
samples (angles in rad, reflectance in 1/sr, linear RGB) above the horizon, named by its folder. Several may share
a folder, each with its name in front: gold_fc1.npy. A folder without a usable network ends the conversion and
nothing is written; further bad networks are skipped with a warning.

Examples:
  metapp data nbrdf trained --out nbrdf
  metapp data nbrdf trained/gold trained/tin --split test --out metals
"""


def register(registry: Registry) -> None:
    """Add MERL tables and NBRDF networks, as inputs and as exports, and objects of programs."""
    registry.formats["merl"] = Format(
        "data_tools.readers.merl",
        app="brdf",
        inputs="MERL .binary files",
        help=MERL,
        options=SampleOptions,
    )
    registry.formats["nbrdf"] = Format(
        "data_tools.readers.nbrdf",
        app="brdf",
        inputs="folders with an NBRDF network",
        help=NBRDF,
        options=SampleOptions,
    )
    registry.exports["brdf", "merl"] = Export("data_tools.readers.merl:export")
    registry.exports["brdf", "nbrdf"] = Export(
        "data_tools.readers.nbrdf:export", holds=("w1", "w2", "w3", "b1", "b2", "b3")
    )
    registry.objects["brdf"] = Entry("data_tools.readers.brdf_objects:from_object")
