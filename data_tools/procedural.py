"""The families of procedural materials: `FAMILIES[name](rng, size)` draws one, stationary and periodic.

Each family varies colours, contrast, scale, orientation and irregularity, and most hold several kinds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from data_tools.patterns import Rng
from data_tools.procedural_built import bricks, metal, shingles, tiles, wood
from data_tools.procedural_maps import Maps as Maps
from data_tools.procedural_nature import camouflage, dots, foliage, grass, rust
from data_tools.procedural_stone import cracks, grain, granite, gravel, marble, terrazzo
from data_tools.procedural_textile import knit, leather, stripes, weave

Family = Callable[[Rng, int], Maps]

FAMILIES: dict[str, Family] = {
    "bricks": bricks,
    "weave": weave,
    "gravel": gravel,
    "wood": wood,
    "grass": grass,
    "tiles": tiles,
    "marble": marble,
    "leather": leather,
    "rust": rust,
    "dots": dots,
    "knit": knit,
    "cracks": cracks,
    "metal": metal,
    "camouflage": camouflage,
    "granite": granite,
    "shingles": shingles,
    "stripes": stripes,
    "foliage": foliage,
    "terrazzo": terrazzo,
    "grain": grain,
}


def stream(*key: int) -> Rng:
    """The random numbers of a key, whole numbers >= 0; others for every other key of the same length."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))
