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
from torch import Tensor

from metapp.storage import Document
from metapp.storage.files import check_readable, write_atomically
from metapp.storage.records import holds

SCHEMA = 1
BITS = (2, 16)  # of a whole number, at least and at most
LARGEST = 1 << 30  # bytes of what a file may unfold to
PARTS = {"name": str, "shape": [int], "step": float, "planes": int}
FORM = {"schema": int, "tasks": [str], "tensors": [PARTS], "about": dict}


class Steps(NamedTuple):
    """A tensor of many fits as whole numbers of steps.

    Attributes:
        numbers: int32 [T, ...].
        step: what one is worth, >= 0.
    """

    numbers: Tensor
    step: float

    def values(self) -> Tensor:
        """What they stand for, float32 [T, ...]."""
        return (self.numbers.double() * self.step).float()


class Pack(NamedTuple):
    """What a file holds: names of fits, their tensors by name, and what is said about them, JSON-ready."""

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
    return Steps(numbers.to(torch.int32), step)


def write_pack(path: Path, pack: Pack) -> int:
    """Write fits as one file, whole or not at all.

    Returns:
        Its bytes.
    """
    described, planes = [], b""
    for name, (numbers, step) in pack.tensors.items():
        data, count = _to_planes(numbers)
        described.append({"name": name, "shape": list(numbers.shape[1:]), "step": float(step), "planes": count})
        planes += data
    head = {"schema": SCHEMA, "tasks": pack.tasks, "tensors": described, "about": pack.about}
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    content = lzma.compress(struct.pack("<I", len(text)) + text + planes, check=lzma.CHECK_SHA256, preset=_PRESET)
    write_atomically(path, lambda target: target.write_bytes(content))
    return len(content)


_PRESET = 9 | lzma.PRESET_EXTREME


def read_pack(path: Path) -> Pack:
    """Read what `write_pack` wrote.

    Raises:
        ValueError: there is no such file, or it is damaged, cut off, of a later version, or no pack.
    """
    check_readable(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such file, expected one that metapp pack wrote.")
    content = _unfolded(path)
    length = int.from_bytes(content[:4], "little")
    head = _header(path, content[4 : 4 + length])
    sizes = [math.prod([len(head["tasks"]), *each["shape"]]) * each["planes"] for each in head["tensors"]]
    if len(content) != 4 + length + sum(sizes):
        raise ValueError(f"{path}: {len(content):,} bytes, expected {4 + length + sum(sizes):,}; pack the fits again.")
    tensors, at = {}, 4 + length
    for each, size in zip(head["tensors"], sizes, strict=True):
        shape = (len(head["tasks"]), *each["shape"])
        tensors[each["name"]] = Steps(_from_planes(content[at : at + size], shape, each["planes"]), each["step"])
        at += size
    return Pack(head["tasks"], tensors, head["about"])


def _unfolded(path: Path) -> bytes:
    """The content, checked against its digest."""
    decoder = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=LARGEST)
    try:
        content = decoder.decompress(path.read_bytes(), LARGEST)
    except (lzma.LZMAError, EOFError):
        raise ValueError(_DAMAGED.format(path)) from None
    if not decoder.eof or decoder.unused_data:
        raise ValueError(_DAMAGED.format(path))
    return content


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
    good = all(
        1 <= each["planes"] <= 2 and each["step"] >= 0 and all(size > 0 for size in each["shape"])
        for each in head["tensors"]
    )
    if not good:
        raise ValueError(_DAMAGED.format(path))
    return head


def _to_planes(numbers: Tensor) -> tuple[bytes, int]:
    """Whole numbers as unsigned ones (0, -1, 1, -2 are 0, 1, 2, 3), their low bytes, then their high ones, if any.

    One place of all fits after the other: these are alike.
    """
    signed = numbers.flatten(1).T.contiguous().numpy().astype(np.int64)
    folded = np.where(signed < 0, -2 * signed - 1, 2 * signed)
    count = 1 if folded.max(initial=0) < 256 else 2
    return b"".join((folded >> 8 * plane & 255).astype(np.uint8).tobytes() for plane in range(count)), count


def _from_planes(data: bytes, shape: tuple[int, ...], count: int) -> Tensor:
    """The inverse of `_to_planes`."""
    planes = np.frombuffer(data, np.uint8).astype(np.int64).reshape(count, -1)
    folded = sum(planes[plane] << 8 * plane for plane in range(count))
    signed = np.where(folded & 1, -(folded + 1) // 2, folded // 2).astype(np.int32)
    return torch.from_numpy(signed.reshape(-1, shape[0]).T.copy()).reshape(shape)
