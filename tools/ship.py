"""Copy the entries of a trained checkpoint into one that ships: ship.py TRAINED SHIPPED.

Files shrink by half or more, and no error changes: encoders and long hyperparameters (rates of weights, bases) are
stored in half precision; hyperparameters on grids keep at most MAX_ALPHA_GRID_CELLS cells a side, or one cell where all
are equal; validation curves keep MAX_CURVE_POINTS points. An Adam whose General ships for the recipe "quick" takes the
encoder from there.
"""

import sys
from pathlib import Path

import torch
from torch.nn.functional import adaptive_avg_pool2d

from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.storage.checkpoint_files import read_entry, read_headers, tensor_digest, write_entry

MAX_ALPHA_GRID_CELLS = 64  # cells along a side of a grid of learned hyperparameters
MAX_CURVE_POINTS = 200  # points of a validation curve


def copy_checkpoint(source: Path, target: Path) -> None:
    """Copy all entries of a checkpoint, smaller; other entries of the target stay.

    Args:
        source: the trained checkpoint.
        target: the file to write.
    """
    entries = {name: read_entry(source, name) for name in read_headers(source)}
    # digests of encoders after rounding, by the digests before
    rounded = {tensor_digest(phi.encoder): tensor_digest(_round_encoder(phi.encoder)) for phi, _ in entries.values()}
    shipped = target.with_name("quick.safetensors")
    shared = []  # digests of encoders that the recipe "quick" has
    if shipped.is_file() and shipped != target:
        shared = [tensor_digest(read_entry(shipped, name)[0].encoder) for name in read_headers(shipped)]
    for name, (phi, header) in entries.items():
        phi = phi._replace(encoder=_round_encoder(phi.encoder))
        if "encoder" in header:  # the encoder that the training began at
            header["encoder"] = rounded.get(header["encoder"], header["encoder"])
        if phi.encoder and phi.alpha and tensor_digest(phi.encoder) in shared:
            phi = phi._replace(encoder={})
        header["curve"] = header["curve"][:: max(1, len(header["curve"]) // MAX_CURVE_POINTS)]
        phi = phi._replace(alpha={key: _shrink_grid(value) for key, value in phi.alpha.items()})
        tensors = {key: value.half() if _is_halved(key, value) else value for key, value in phi.flatten().items()}
        write_entry(target, name, MetaParameters.unflatten(tensors), header)


def _round_encoder(encoder: Params) -> Params:
    """Return an encoder as fits see it after it was stored in half precision."""
    return {key: value.half().float() for key, value in encoder.items()}


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


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    copy_checkpoint(source, target)
    print(target, target.stat().st_size, *read_headers(target))
