"""Strips of five squares: flash photograph, normal, diffuse, roughness, specular (Deschaintre et al. 2018).

Fits take them as `svbrdf`.
"""

from __future__ import annotations

from data_tools.formats import Format, Setting
from data_tools.formats.images import SIZE

HELP = """Convert strips, images of five squares: flash photograph, normal, diffuse, roughness, specular.

As Deschaintre et al. 2018 publish theirs: linear, normals with y up. Each becomes maps and photograph of --size. A
bad file that was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

The base materials are told by <number>;<material>X<material>;<preset>X<preset>.png; any other strip is of a
material of its own. Where base materials cannot be parted, since all are blended with all, their presets are.

Examples:
  metapp data strips DeepMaterialsData/trainBlended --out svbrdf
  metapp data strips strips --gamma 2.2 --white 1 --split test --out svbrdf
"""
SPLIT = (
    "Where the tasks belong. auto: no base material on both sides, a fifth or more for tests; what blends materials of "
    "both sides is left out."
)
GAMMA = Setting("gamma", 1.0, "How all tiles but the normals are encoded; 1 is linear.", "G", low=0.1, high=10)
WHITE = Setting(
    "white",
    1.35,
    "How bright white would be right below the flash, 1 where the photographs clip; they are made that much darker. "
    "The default is that of the published ones.",
    "W",
    low=0.01,
    high=100,
)

FORMAT = Format(
    "strips",
    "svbrdf_nonstationary",
    "data_tools.readers.strips",
    noun="strip",
    help=HELP,
    paths=("FILES...", "Strips, and folders searched at any depth."),
    settings=(SIZE, GAMMA, WHITE),
    split_help=SPLIT,
)
