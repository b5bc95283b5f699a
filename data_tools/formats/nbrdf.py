"""NBRDF networks (Sztrajman et al. 2021)."""

from __future__ import annotations

from data_tools.formats import Format
from data_tools.formats.merl import SAMPLES

HELP = """Convert NBRDF networks, BRDFs as small neural networks.

A network (Sztrajman et al. 2021) is a folder with fc1.npy, fc2.npy, fc3.npy, b1.npy, b2.npy, b3.npy. It becomes
samples (angles in rad, reflectance in 1/sr, linear RGB) above the horizon, named by its folder. Several may share
a folder, each with its name in front: gold_fc1.npy. A folder without a usable network ends the conversion and
nothing is written; further bad networks are skipped with a warning.

Examples:
  metapp data nbrdf trained --out nbrdf
  metapp data nbrdf trained/gold trained/tin --split test --out metals
"""

FORMAT = Format(
    "nbrdf",
    "brdf",
    "data_tools.readers.nbrdf",
    "folders with an NBRDF network",
    exports=True,
    holds=("w1", "w2", "w3", "b1", "b2", "b3"),
    noun="NBRDF network",
    help=HELP,
    paths=("DIRS...", "Folders of networks, searched at any depth."),
    settings=(SAMPLES,),
)
