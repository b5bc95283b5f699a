"""Tensors that take long to compute and never change: computed once for a cache."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.storage.cache import cache_folder
from metapp.storage.files import write_atomically
from metapp.storage.tensors import opened_tensors


def kept(name: str, sources: Sequence[str], make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """Tensors from the cache, where the same code made them; else made, and kept there if that can be.

    Args:
        name: of the file.
        sources: paths of the code that makes them.
        make: what does.
    """
    path, maker = cache_folder() / f"{name}.safetensors", {"maker": _maker(sources)}
    with contextlib.suppress(OSError, SafetensorError), opened_tensors(path) as stored:
        if stored.metadata() == maker:
            return {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118  (not a mapping)
    tensors = {key: value.contiguous() for key, value in make().items()}
    with contextlib.suppress(OSError):
        write_atomically(path, lambda partial: partial.write_bytes(save(tensors, maker)))
    return tensors


def _maker(sources: Sequence[str]) -> str:
    """A digest of code, and torch's version."""
    digest = hashlib.sha256(b"".join(Path(each).read_bytes() for each in sources))
    return f"{digest.hexdigest()[:16]} {torch.__version__}"
