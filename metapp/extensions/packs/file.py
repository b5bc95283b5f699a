"""Many fits in one small file: tensors as whole numbers of steps, in byte planes, under one entropy coder.

The file is an XZ stream (LZMA with a CHECK of SHA-256, of the standard library) of a length, a JSON header, and the
planes. No part of it is run or unpickled.
"""

from __future__ import annotations

import json
import lzma
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from metapp.storage import Document
from metapp.storage.files import write_atomically
from metapp.storage.forms import holds
from metapp.storage.plain import check_readable, read_bytes

SCHEMA = 1
BITS = (2, 16)  # of a whole number, at least and at most
LARGEST = 1 << 30  # bytes of planes that a file may hold
LARGEST_HEADER = 1 << 24  # bytes; 100,000 fits take less
MEMORY = 1 << 27  # bytes that a decoder may take: twice what the preset's takes
PARTS = {"name": str, "shape": [int], "step": float, "planes": int}
FORM = {"schema": int, "tasks": [str], "tensors": [PARTS], "about": dict}


class Steps(NamedTuple):
    """A tensor of many fits as whole numbers of steps, in byte planes: those of a fit are unfolded when asked for.

    Attributes:
        planes: uint8 [planes, places, T], the numbers' low bytes, then their high ones, if any, where 0, -1, 1, -2 are
            0, 1, 2, 3; fits are beside each other, as these are alike.
        shape: of a fit's tensor.
        step: what one is worth, >= 0.
    """

    planes: NDArray[np.uint8]
    shape: tuple[int, ...]
    step: float

    def numbers(self, fit: int | slice = slice(None)) -> Tensor:
        """The whole numbers, int32 [...] of a fit, [T, ...] of several."""
        low, *high = self.planes[..., fit].astype(np.int32)
        folded = low + 256 * high[0] if high else low
        signed = np.where(folded & 1, -(folded + 1) // 2, folded // 2)
        return torch.from_numpy(signed.T.reshape(*signed.shape[1:], *self.shape).copy())

    def values(self, fit: int | slice = slice(None)) -> Tensor:
        """The values that they stand for, float32 [...] of a fit, [T, ...] of several."""
        return (self.numbers(fit).double() * self.step).float()


class Pack(NamedTuple):
    """The content of a file: names of fits, their tensors by name, and what is said about them, JSON-ready."""

    tasks: list[str]
    tensors: Mapping[str, Steps]
    about: Document


def in_steps(values: Tensor, bits: int) -> Steps:
    """The nearest whole numbers of `bits` bits, sign included, of one step for all of a tensor.

    Args:
        values: [T, ...], finite.
        bits: within BITS.
    """
    step = float(values.abs().max()) / (2 ** (bits - 1) - 1) if values.numel() else 0.0
    numbers = torch.round(values.double() / step) if step else torch.zeros_like(values)
    signed = numbers.flatten(1).T.contiguous().numpy().astype(np.int64)
    folded = np.where(signed < 0, -2 * signed - 1, 2 * signed)
    count = 1 if folded.max(initial=0) < 256 else 2
    planes = np.stack([(folded >> 8 * plane & 255).astype(np.uint8) for plane in range(count)])
    return Steps(planes, tuple(values.shape[1:]), step)


def write_pack(path: Path, pack: Pack) -> int:
    """Write fits as one file, whole or not at all.

    Returns:
        Its bytes.

    Raises:
        ValueError: more fits than a file may hold.
    """
    described = [
        {"name": name, "shape": list(of.shape), "step": float(of.step), "planes": len(of.planes)}
        for name, of in pack.tensors.items()
    ]
    head = {"schema": SCHEMA, "tasks": pack.tasks, "tensors": described, "about": pack.about}
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    planes = b"".join(of.planes.tobytes() for of in pack.tensors.values())
    if len(text) > LARGEST_HEADER or len(planes) > LARGEST:
        raise ValueError(f"{path}: {len(planes):,} bytes of fits, expected at most {LARGEST:,}; pack fewer fits.")
    content = lzma.compress(struct.pack("<I", len(text)) + text + planes, check=lzma.CHECK_SHA256, preset=_PRESET)
    write_atomically(path, lambda target: target.write_bytes(content))
    return len(content)


_PRESET = 9 | lzma.PRESET_EXTREME


class PackFile:
    """A pack whose header is read and whose planes are not, so that they can be refused before they are unfolded.

    Attributes:
        tasks: names of the fits.
        about: what is said about them.
        shapes: that the tensors of a fit are to have, by name.
    """

    def __init__(self, path: Path) -> None:
        """Read and check the header.

        Raises:
            ValueError: there is no such file, or it is damaged, cut off, of a later version, or no pack.
        """
        check_readable(path)
        if not path.is_file():
            raise ValueError(f"{path}: no such file, expected one that metapp pack wrote.")
        if path.stat().st_size > LARGEST + LARGEST_HEADER:
            raise ValueError(_DAMAGED.format(path))
        self._path, self._content = path, read_bytes(path)
        self._decoder = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=MEMORY)
        length = int.from_bytes(self._take(4), "little")
        head = _header(path, self._take(min(length, LARGEST_HEADER)))
        self.tasks: list[str] = head["tasks"]
        self.about: Document = head["about"]
        self._parts = head["tensors"]
        self.shapes = {part["name"]: tuple(part["shape"]) for part in self._parts}

    def read(self) -> Pack:
        """Unfold the planes, as many bytes as the header declares; once.

        Raises:
            ValueError: the file is damaged, cut off, or declares more than LARGEST.
        """
        places = [(part["planes"], math.prod(part["shape"]), len(self.tasks)) for part in self._parts]
        size = sum(map(math.prod, places))
        if size > LARGEST:
            raise ValueError(f"{self._path}: {size:,} bytes of fits, expected at most {LARGEST:,}; pack fewer fits.")
        whole, at, tensors = np.frombuffer(self._take(size), np.uint8), 0, {}
        if self._unfold(1) or not self._decoder.eof or self._decoder.unused_data:  # the check of SHA-256 comes last
            raise ValueError(_DAMAGED.format(self._path))
        for part, shape in zip(self._parts, places, strict=True):
            planes = whole[at : at + math.prod(shape)].reshape(shape)
            tensors[part["name"]] = Steps(planes, self.shapes[part["name"]], part["step"])
            at += planes.size
        return Pack(self.tasks, tensors, self.about)

    def _take(self, count: int) -> bytes:
        """The next bytes."""
        parts = []
        while count:
            parts.append(self._unfold(count))
            if not parts[-1]:
                raise ValueError(_DAMAGED.format(self._path))
            count -= len(parts[-1])
        return b"".join(parts)

    def _unfold(self, most: int) -> bytes:
        """Some more bytes, as long as there are any."""
        content, self._content = self._content, b""
        try:
            return b"" if self._decoder.eof else self._decoder.decompress(content, most)
        except (lzma.LZMAError, EOFError):
            raise ValueError(_DAMAGED.format(self._path)) from None


_DAMAGED = "{}: damaged or cut off, expected a whole file that metapp pack wrote; pack the fits again."


def _header(path: Path, text: bytes) -> Document:
    try:
        head: Document = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError(_DAMAGED.format(path)) from None
    if not holds(head, FORM) or not head["tasks"] or len(set(head["tasks"])) < len(head["tasks"]):
        raise ValueError(_DAMAGED.format(path))
    if head["schema"] > SCHEMA:
        raise ValueError(f"{path}: schema {head['schema']}, expected at most {SCHEMA}; update metapp.")
    names = {part["name"] for part in head["tensors"]}
    if len(names) < len(head["tensors"]) or not all(map(_is_good, head["tensors"])):
        raise ValueError(_DAMAGED.format(path))
    return head


def _is_good(part: Document) -> bool:
    """Test for a tensor that can be one: of few axes, so that its size is soon known."""
    shape = part["shape"]
    return 1 <= part["planes"] <= 2 and part["step"] >= 0 and len(shape) < 16 and all(0 < n <= LARGEST for n in shape)
