"""Copy trained checkpoints to where those that ship lie: ship.py TRAINED CHECKPOINTS.

Encoders and long hyperparameters (rates of weights, bases) are stored in half precision there, which halves their size
and changes no error, hyperparameters on grids on at most GRID cells a side, one where all are the same; of long
validation curves CURVE points; checkpoints that refer to General's encoder by its digest refer to the rounded one.
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

MAX_ALPHA_GRID_CELLS, MAX_CURVE_POINTS = 64, 200
UNFINISHED_ENDINGS = (".previous", ".interrupted", ".training", ".aside")


def copy_checkpoint(source: Path, target: Path, rounded: dict[str, str]) -> None:
    """Copy one checkpoint; `rounded` has the digests of encoders before and after rounding."""
    with safe_open(source, "pt") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  (not a mapping)
        info: dict[str, Any] = json.loads(file.metadata()["metapp"])
    if "encoder" in info:
        info["encoder"] = rounded.get(info["encoder"], info["encoder"])
    info["curve"] = info["curve"][:: max(1, len(info["curve"]) // MAX_CURVE_POINTS)]
    tensors = {key: _on_small_grid(value) if key.startswith("alpha.") else value for key, value in tensors.items()}
    tensors = {key: value.half() if _is_large(key, value) else value for key, value in tensors.items()}
    encoder = MetaParameters.unflatten(tensors).encoder
    if not source.stem.startswith("general") and encoder and _digest(encoder) in rounded.values():
        tensors = {key: value for key, value in tensors.items() if not key.startswith("encoder.")}
        info["general"] = _digest(encoder)
    save_file(tensors, target, {"metapp": json.dumps(info)})


def _on_small_grid(value: torch.Tensor) -> torch.Tensor:
    """Hyperparameters on a grid [K, channels, rows, columns] on one of at most GRID x GRID cells; fits enlarge it.

    Those that are the same everywhere have one cell.
    """
    if value.ndim != 4 or value.shape[2] != value.shape[3]:
        return value
    if torch.equal(value, value[..., :1, :1].expand_as(value)):
        return value[..., :1, :1].clone()
    return adaptive_avg_pool2d(value, MAX_ALPHA_GRID_CELLS) if value.shape[2] > MAX_ALPHA_GRID_CELLS else value


def _is_large(key: str, value: torch.Tensor) -> bool:
    long = key.startswith(("alpha.rate.", "alpha.in.", "alpha.out.")) and value.numel() > 64
    long = long or (key.endswith(".place") and value.numel() > 1 << 16)
    shared = key.startswith("theta.w") and value.numel() > 1024  # of networks of which a fit moves the last layer alone
    return value.dtype == torch.float32 and (key.startswith("encoder.") or long or shared)


def _digest(encoder: Params) -> str:
    return tensor_digest({key: value.float() for key, value in encoder.items()})


def encoder_digests(folder: Path) -> dict[str, str]:
    """Digests of Generals as they were trained, and as they ship."""
    paths = [path for path in folder.glob("general*.safetensors") if not path.stem.endswith(UNFINISHED_ENDINGS)]
    encoders = [load_checkpoint(path)[0].encoder for path in paths]
    return {tensor_digest(each): _digest({key: value.half() for key, value in each.items()}) for each in encoders}


if __name__ == "__main__":
    folder, checkpoints = map(Path, sys.argv[1:])
    checkpoints.mkdir(parents=True, exist_ok=True)
    rounded = encoder_digests(folder)
    for source in sorted(folder.glob("*.safetensors")):
        if not source.stem.endswith(UNFINISHED_ENDINGS):
            copy_checkpoint(source, checkpoints / source.name, rounded)
            print(checkpoints / source.name, (checkpoints / source.name).stat().st_size)
