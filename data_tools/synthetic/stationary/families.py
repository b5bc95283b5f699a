"""The families of procedural materials, and the draws of an embedded set's splits.

`FAMILIES[name](rng, size)` draws a stationary and periodic material. Each family varies colours, contrast, scale,
orientation and irregularity, and most hold several kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from data_tools.random_streams import Rng, random_stream
from data_tools.synthetic.random_values import Split
from data_tools.synthetic.stationary.building_materials import bricks, metal, shingles, tiles, wood
from data_tools.synthetic.stationary.nature import camouflage, dots, foliage, grass, rust
from data_tools.synthetic.stationary.periodic_maps import PeriodicMaps
from data_tools.synthetic.stationary.stone import cracks, grain, granite, gravel, marble, terrazzo
from data_tools.synthetic.stationary.textile import knit, leather, stripes, weave

Family = Callable[[Rng, int], PeriodicMaps]

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


def split_draws(
    noun: str, families: Iterable[str], counts: Mapping[Split, int], split: Split, count: int, seed: int, *more: int
) -> Iterator[tuple[str, str, Rng]]:
    """Yield the draws of one split of an embedded set, whose families take turns.

    Args:
        noun: what is drawn, for messages of errors.
        families: names of the families.
        counts: number of tasks in the default set, by split; splits have random streams of their own.
        split: one of the keys of `counts`.
        count: how many. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.
        more: further keys of the random streams, which set them apart from the streams of other sets.

    Returns:
        For each draw the family, the task's name such as "bricks-013" ("bricks-t013" in the test split), and its random
        numbers.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    if split not in counts:
        raise ValueError(f"split of the synthetic {noun}: {split!r}, expected 'train' or 'test'")
    if count < 0 or seed < 0:
        raise ValueError(f"synthetic {noun}: count {count} and seed {seed}, expected both to be 0 or more")
    names = list(families)
    for index in range(count):
        turn, family_index = divmod(index, len(names))
        name = f"{names[family_index]}-{'t' if split == 'test' else ''}{index:03d}"
        yield names[family_index], name, random_stream(seed, list(counts).index(split), family_index, turn, *more)
