"""Copy trained starts to where those that ship lie: ship.py STARTS CHECKPOINTS.

The encoders of Meta's starts are kept in half precision there, which no error shows and halves their size; General's is
kept as it is, since others name it by its digest.
"""

import shutil
import sys
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file

SKIPPED = (".previous", ".interrupted")


def ship(source: Path, target: Path) -> None:
    """Copy one start."""
    if not source.name.startswith("meta-"):
        shutil.copyfile(source, target)
        return
    with safe_open(source, "pt") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        metadata = file.metadata()
    save_file(
        {key: value.half() if _of_encoder(key, value) else value for key, value in tensors.items()}, target, metadata
    )


def _of_encoder(key: str, value: torch.Tensor) -> bool:
    return key.startswith("encoder.") and value.dtype == torch.float32


if __name__ == "__main__":
    folder, checkpoints = map(Path, sys.argv[1:])
    checkpoints.mkdir(parents=True, exist_ok=True)
    for start in sorted(folder.glob("*.safetensors")):
        if not start.stem.endswith(SKIPPED):
            ship(start, checkpoints / start.name)
            print(checkpoints / start.name, (checkpoints / start.name).stat().st_size)
