"""Count how often pieces of photographs come again: repeats.py PHOTO...

A line a photo, read at 256 px a side: in a picture of its size and in one of four times its sides by the baseline
`quilting`, and in the layout that fits by `full` read. Each is the px of what is made over the distinct px in it.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.photos import read_task
from metapp.appearance.quilting import block_of, origins, repeats
from metapp.networks.layout import blocks_of, shrunk

SIDE, LAYOUT, LARGER = 256, 128, 4


def counted(picture: Tensor, side: int, blocks: tuple[int, int], *, tiles: bool = False) -> float:
    """How often pieces of a picture [3, H, W] come in a square one quilted of it."""
    block, overlap = blocks
    pixels, numbers = picture.movedim(0, -1).numpy(), np.random.default_rng(0)
    return repeats(origins(pixels, (side, side), numbers, block=block, overlap=overlap, tiles=tiles))


def main(photos: list[str]) -> None:
    """Print the counts of each photo, and their means."""
    rows = []
    for photo in photos:
        exemplar = read_task(Path(photo), SIDE).data["image"].float() / 255
        small, quilt = shrunk(exemplar, (LAYOUT, LAYOUT)), block_of(exemplar.movedim(0, -1).numpy())
        layout = counted(small, LAYOUT, blocks_of(small, (LAYOUT, LAYOUT)), tiles=True)
        rows.append([counted(exemplar, side, quilt) for side in (SIDE, LARGER * SIDE)] + [layout])
        print(Path(photo).stem, *(f"{count:.2f}" for count in rows[-1]), flush=True)
    print("mean", *(f"{count:.2f}" for count in torch.tensor(rows).mean(0).tolist()))


if __name__ == "__main__":
    main(sys.argv[1:])
