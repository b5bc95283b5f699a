"""Safetensors files under any name: the library takes names in UTF-8 alone."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from safetensors import safe_open
from torch import Tensor


@contextlib.contextmanager
def opened_tensors(path: str | Path, device: str = "cpu") -> Iterator[Any]:
    """A file as `safetensors.safe_open` gives it.

    Raises:
        OSError: it cannot be opened.
        SafetensorError: it is damaged.
    """
    try:
        os.fspath(path).encode()
    except UnicodeEncodeError:
        with open(path, "rb") as file, safe_open(f"/dev/fd/{file.fileno()}", "pt", device=device) as stored:
            yield stored
    else:
        with safe_open(path, "pt", device=device) as stored:
            yield stored


def read_tensors(path: str | Path) -> dict[str, Tensor]:
    """All tensors of a file, on the CPU.

    Raises:
        OSError, SafetensorError: as `opened_tensors`.
    """
    with opened_tensors(path) as stored:
        return {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118  (not a mapping)
