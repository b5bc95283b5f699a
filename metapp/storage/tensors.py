"""Safetensors files under any name, as the library takes names in UTF-8 alone; tensors that are computed once."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from metapp.storage.cache import cache_folder
from metapp.storage.files import open_regular, write_atomically


@contextlib.contextmanager
def opened_tensors(path: str | Path, device: str = "cpu") -> Iterator[Any]:
    """A file as `safetensors.safe_open` gives it.

    Raises:
        OSError: it cannot be opened.
        ValueError: it is no file.
        SafetensorError: it is damaged.
    """
    with open_regular(path) as file:
        place = path if str(path).isprintable() else f"/dev/fd/{file.fileno()}"  # it takes no bytes that are not UTF-8
        with safe_open(place, "pt", device=device) as stored:
            yield stored


def read_tensors(path: str | Path) -> dict[str, Tensor]:
    """All tensors of a file, on the CPU.

    Raises:
        OSError, SafetensorError: as `opened_tensors`.
    """
    with opened_tensors(path) as stored:
        return {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118  (not a mapping)


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
