"""The cache of tensors that take long to compute, one file in the cache folder for each set of tensors.

A file is taken only if its tensors were made by the code and the version of torch that run now.
"""

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
    """Load tensors from the cache if the present code made them, else compute them and keep them there if possible.

    Args:
        name: the name of the file, without suffix.
        sources: the files of the code that computes the tensors.
        make: the function that computes them.

    Returns:
        The tensors by name.
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
    """Return a text that changes with the content of code files and with the version of torch."""
    digest = hashlib.sha256(b"".join(Path(file).read_bytes() for file in sources))
    return f"{digest.hexdigest()[:16]} {torch.__version__}"
