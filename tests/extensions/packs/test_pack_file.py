"""Packs of fits: what is written is read, to half a step; and no damage goes unseen."""

from __future__ import annotations

import lzma
import random
import tracemalloc
from pathlib import Path

import pytest
import torch
from torch import Generator, Tensor

from metapp.extensions.packs.file import LARGEST_HEADER, Pack, PackFile, in_steps, write_pack


def read_pack(path: Path) -> Pack:
    return PackFile(path).read()


@pytest.fixture
def values(rng: Generator) -> Tensor:
    return torch.randn(7, 5, 3, generator=rng)


def test_values_come_back_to_half_a_step(values: Tensor) -> None:
    for bits in range(2, 17):
        steps = in_steps(values, bits)
        assert int(steps.numbers().abs().max()) == 2 ** (bits - 1) - 1
        assert float((steps.values() - values).abs().max()) <= steps.step / 2 * (1 + 1e-6), bits
        assert steps.step == pytest.approx(float(values.abs().max()) / (2 ** (bits - 1) - 1))
    zeros = in_steps(torch.zeros(3, 4), 8)
    assert zeros.step == 0.0
    assert torch.equal(zeros.values(), torch.zeros(3, 4))


@pytest.mark.parametrize("bits", [2, 8, 9, 16])
def test_a_file_is_read_as_it_was_written(values: Tensor, bits: int, tmp_path: Path) -> None:
    names = [f"m{i}" for i in range(len(values))]
    parts = {"w": (values, bits), "z": (values[:, :1, 0], 16), "none": (torch.zeros(7, 2), 4)}
    tensors = {name: in_steps(*part) for name, part in parts.items()}
    size = write_pack(tmp_path / "a.pack", Pack(names, tensors, {"bits": bits}))
    assert size == (tmp_path / "a.pack").stat().st_size
    back = read_pack(tmp_path / "a.pack")
    assert (back.tasks, back.about) == (names, {"bits": bits})
    for name, steps in tensors.items():
        assert torch.equal(back.tensors[name].numbers(), steps.numbers())
        assert torch.equal(back.tensors[name].values(3), steps.values()[3])
        assert back.tensors[name].step == steps.step


def test_fits_that_are_alike_take_fewer_bytes_than_their_bits(rng: Generator, tmp_path: Path) -> None:
    """Laplacian values of a few steps: entropy coding must come below the plain 8 bits, and below 1.5 entropies."""
    values = torch.empty(50, 200).exponential_(1.0, generator=rng) * torch.randn(50, 200, generator=rng).sign()
    steps = in_steps(values, 6)
    counts = torch.bincount((steps.numbers() + 64).flatten()).double()
    share = counts[counts > 0] / counts.sum()
    entropy = float(-(share * share.log2()).sum()) / 8 * values.numel()
    size = write_pack(tmp_path / "a.pack", Pack([str(i) for i in range(50)], {"w": steps}, {}))
    assert size < 0.75 * values.numel()
    assert entropy < size < 1.5 * entropy


def test_mutated_and_truncated_files_are_refused_in_one_line(values: Tensor, tmp_path: Path) -> None:
    path = tmp_path / "a.pack"
    write_pack(path, Pack([str(i) for i in range(7)], {"w": in_steps(values, 8)}, {"told": "text"}))
    whole, draw = path.read_bytes(), random.Random(0)
    damaged = [whole[: draw.randrange(len(whole))] for _ in range(40)] + [b"", b"hello", whole + b"x"]
    for _ in range(150):
        place = draw.randrange(len(whole))
        damaged.append(whole[:place] + bytes([whole[place] ^ (1 + draw.randrange(255))]) + whole[place + 1 :])
    for content in damaged:
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.pack: .*(expected|update)") as error:
            read_pack(path)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x02\x00\x00\x00{}",
        b"\xff\xff\xff\xff{}",
        b'\x40\x00\x00\x00{"schema":1,"tasks":["a"],"tensors":[{"name":"w","shape":[-1],"step":1.0,"planes":1}],"about":{}}',
        b'\x4b\x00\x00\x00{"schema":1,"tasks":["a","a"],"tensors":[],"about":{}}                      ',
        b'\x32\x00\x00\x00{"schema":9,"tasks":["a"],"tensors":[],"about":{}}',
        b'\x32\x00\x00\x00{"schema":1,"tasks":["a"],"tensors":[],"about":{}}more',
    ],
)
def test_streams_that_somebody_else_made_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.pack"
    path.write_bytes(lzma.compress(content))
    with pytest.raises(ValueError, match=r"a\.pack: "):
        read_pack(path)


def test_a_file_that_unfolds_to_more_than_it_may_hold_is_neither_written_nor_read(
    values: Tensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, pack = tmp_path / "a.pack", Pack([str(i) for i in range(7)], {"w": in_steps(values, 8)}, {})
    write_pack(path, pack)
    monkeypatch.setattr("metapp.extensions.packs.file.LARGEST", 7 * 5 * 3 - 1)
    with pytest.raises(ValueError, match="105 bytes of fits, expected at most 104; pack fewer fits"):
        read_pack(path)
    with pytest.raises(ValueError, match="105 bytes of fits, expected at most 104; pack fewer fits"):
        write_pack(path, pack)


@pytest.mark.parametrize("length", [b"\xff\xff\xff\xff", b"\x10\x00\x00\x00"])
def test_what_follows_the_header_is_not_unfolded(length: bytes, tmp_path: Path) -> None:
    """19 kB that unfold to 128 MB are refused in the memory of the longest header."""
    path = tmp_path / "a.pack"
    path.write_bytes(lzma.compress(length + bytes(1 << 27), preset=0, check=lzma.CHECK_NONE))
    tracemalloc.start()
    with pytest.raises(ValueError, match="damaged or cut off"):
        read_pack(path)
    assert tracemalloc.get_traced_memory()[1] < 4 * LARGEST_HEADER
    tracemalloc.stop()
