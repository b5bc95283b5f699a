"""Copy trained checkpoints to the folder of checkpoints that ship: ship.py TRAINED CHECKPOINTS.

Files shrink by half or more, and no error changes: encoders and long hyperparameters (rates of weights, bases) are
stored in half precision; hyperparameters on grids keep at most MAX_ALPHA_GRID_CELLS cells a side, or one cell where all
are equal; validation curves keep MAX_CURVE_POINTS points. A checkpoint that refers to General's encoder by its digest
then refers to the rounded encoder.
"""

import json
import sys
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch.nn.functional import adaptive_avg_pool2d

from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.storage.checkpoint_files import load_checkpoint, tensor_digest

MAX_ALPHA_GRID_CELLS = 64  # cells along a side of a grid of learned hyperparameters
MAX_CURVE_POINTS = 200  # points of a validation curve
UNFINISHED_ENDINGS = (
    ".previous",
    ".interrupted",
    ".training",
    ".aside",
)  # of file names of checkpoints that do not ship


def copy_checkpoint(source: Path, target: Path, rounded: dict[str, str]) -> None:
    """Copy one checkpoint, smaller.

    Args:
        source: the trained checkpoint.
        target: the file to write.
        rounded: digests of encoders after rounding, by the digests before; see :func:`encoder_digests`.
    """
    with safe_open(source, "pt") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        info: dict[str, Any] = json.loads(file.metadata()["metapp"])
    if "encoder" in info:
        info["encoder"] = rounded.get(info["encoder"], info["encoder"])
    info["curve"] = info["curve"][:: max(1, len(info["curve"]) // MAX_CURVE_POINTS)]
    tensors = {key: _shrink_grid(value) if key.startswith("alpha.") else value for key, value in tensors.items()}
    tensors = {key: value.half() if _is_halved(key, value) else value for key, value in tensors.items()}
    encoder = MetaParameters.unflatten(tensors).encoder
    if not source.stem.startswith("general") and encoder and _float_digest(encoder) in rounded.values():
        tensors = {key: value for key, value in tensors.items() if not key.startswith("encoder.")}
        info["general"] = _float_digest(encoder)
    save_file(tensors, target, {"metapp": json.dumps(info)})


def _shrink_grid(value: torch.Tensor) -> torch.Tensor:
    """Return hyperparameters on a grid [K, channels, rows, columns] on at most MAX_ALPHA_GRID_CELLS cells a side.

    Fits enlarge the grid again. Hyperparameters that are equal everywhere get one cell.
    """
    if value.ndim != 4 or value.shape[2] != value.shape[3]:
        return value
    if torch.equal(value, value[..., :1, :1].expand_as(value)):
        return value[..., :1, :1].clone()
    return adaptive_avg_pool2d(value, MAX_ALPHA_GRID_CELLS) if value.shape[2] > MAX_ALPHA_GRID_CELLS else value


def _is_halved(key: str, value: torch.Tensor) -> bool:
    """Return whether a tensor of a checkpoint is stored in half precision."""
    is_long = key.startswith(("alpha.rate.", "alpha.in.", "alpha.out.")) and value.numel() > 64
    is_long = is_long or (key.endswith(".place") and value.numel() > 1 << 16)
    # weights of networks whose last layer alone is fitted
    is_shared = key.startswith("theta.w") and value.numel() > 1024
    return value.dtype == torch.float32 and (key.startswith("encoder.") or is_long or is_shared)


def _float_digest(encoder: Params) -> str:
    """Return the digest of an encoder as fits see it, in single precision."""
    return tensor_digest({key: value.float() for key, value in encoder.items()})


def encoder_digests(folder: Path) -> dict[str, str]:
    """Return the digests of General's encoders as they ship, by their digests as they were trained."""
    paths = [path for path in folder.glob("general*.safetensors") if not path.stem.endswith(UNFINISHED_ENDINGS)]
    encoders = [load_checkpoint(path)[0].encoder for path in paths]
    return {
        tensor_digest(encoder): _float_digest({key: value.half() for key, value in encoder.items()})
        for encoder in encoders
    }


if __name__ == "__main__":
    folder, checkpoints = map(Path, sys.argv[1:])
    checkpoints.mkdir(parents=True, exist_ok=True)
    rounded = encoder_digests(folder)
    for source in sorted(folder.glob("*.safetensors")):
        if not source.stem.endswith(UNFINISHED_ENDINGS):
            copy_checkpoint(source, checkpoints / source.name, rounded)
            print(checkpoints / source.name, (checkpoints / source.name).stat().st_size)
