"""Tensors that take long to compute, kept in the cache folder."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import open_tensors, write_bytes


def load_or_compute_tensors(
    name: str, sources: Sequence[str], make: Callable[[], dict[str, Tensor]]
) -> dict[str, Tensor]:
    """Return tensors of the cache if the same code made them; else make them, and keep them there if that can be.

    Args:
        name: of the file.
        sources: paths of the code that makes them.
        make: makes them.
    """
    path, maker = cache_folder() / f"{name}.safetensors", {"maker": _maker(sources)}
    with contextlib.suppress(OSError, SafetensorError), open_tensors(path) as stored:
        if stored.metadata() == maker:
            return {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118  (not a mapping)
    tensors = {key: value.contiguous() for key, value in make().items()}
    with contextlib.suppress(OSError):
        write_bytes(path, save(tensors, maker))
    return tensors


def _maker(sources: Sequence[str]) -> str:
    """Return a digest of code and the version of torch."""
    digest = hashlib.sha256(b"".join(Path(file).read_bytes() for file in sources))
    return f"{digest.hexdigest()[:16]} {torch.__version__}"
