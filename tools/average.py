"""Average the weights of two checkpoints of the same shape: average.py ONE OTHER OUT.

Where a training went on from another, the mean of both often keeps what each does well (Wortsman et al. 2022).
"""

import sys
from pathlib import Path

from safetensors import safe_open
from safetensors.torch import load_file, save_file


def main(one: Path, other: Path, out: Path) -> None:
    """Write the mean, with the first one's header."""
    first, second = load_file(one), load_file(other)
    shapes = [{key: value.shape for key, value in each.items()} for each in (first, second)]
    if shapes[0] != shapes[1]:
        raise SystemExit(f"average: {one} and {other} hold other tensors, expected trainings of the same network")
    with safe_open(one, "pt") as file:
        header = file.metadata()
    mean = {key: ((value.float() + second[key].float()) / 2).to(value.dtype) for key, value in first.items()}
    save_file(mean, out, header)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
