"""Links and pipes among a user's files: what is written follows no link, what is read is a regular file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.storage.files import (
    append_line,
    check_readable,
    open_regular,
    partial_path,
    read_bytes,
    read_text,
    write_atomically,
)
from metapp.storage.records import RunFolder

KEYS = "first\nlast"  # its last line has no end, as one that was cut off: a record would take its place


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """A file elsewhere, which a folder that somebody sent must not reach."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "keys").write_text(KEYS)
    return tmp_path / "home" / "keys"


@pytest.fixture
def sent(tmp_path: Path) -> Path:
    (tmp_path / "sent").mkdir()
    return tmp_path / "sent"


def link_record(sent: Path, target: Path, hard: bool) -> None:
    (sent / "record.jsonl").hardlink_to(target) if hard else (sent / "record.jsonl").symlink_to(target)


@pytest.mark.parametrize(("name", "hard"), [("keys", False), ("new", False), ("keys", True)])
def test_a_linked_record_does_not_cut_another_file(sent: Path, keys: Path, name: str, hard: bool) -> None:
    link_record(sent, keys.with_name(name), hard)
    with pytest.raises(ValueError, match=r"record\.jsonl: a link, expected a file of this folder; remove it"):
        RunFolder(sent, {"steps": 1}).add({"name": "gold", "error": 1.0, "seconds": 1.0}, {"w": torch.zeros(1)})
    assert [path.name for path in keys.parent.iterdir()] == ["keys"]
    assert keys.read_text() == KEYS


def test_a_linked_file_is_replaced_and_its_target_as_it_was(sent: Path, keys: Path) -> None:
    for path in (sent / "a.txt", partial_path(sent / "a.txt")):
        path.symlink_to(keys)
    write_atomically(sent / "a.txt", lambda path: path.write_text("ours"))
    assert (sent / "a.txt").read_text() == "ours"
    assert not (sent / "a.txt").is_symlink()
    assert keys.read_text() == KEYS


def test_a_failed_write_leaves_the_old_file_and_no_temporary_one(sent: Path) -> None:
    path = sent / "new" / "picture.png"
    write_atomically(path, lambda partial: partial.write_text("one"))

    def fail(partial: Path) -> None:
        assert (partial.parent, partial.suffix) == (path.parent, ".png")
        partial.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, fail)
    assert path.read_text() == "one"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("read", [open_regular, read_bytes, read_text])
def test_what_is_no_file_is_not_read(read: Callable, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ValueError, match="a pipe or device, expected a file"):
            read(path)
        with pytest.raises(ValueError, match="a pipe or device, expected a file"):
            check_readable(path)
    with pytest.raises(IsADirectoryError, match="a folder, expected a file"):
        read(tmp_path)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none")


def test_a_pipe_is_no_record_file(sent: Path) -> None:
    os.mkfifo(sent / "record.jsonl")
    with pytest.raises(ValueError, match="a pipe or device, expected a file"):
        append_line(sent / "record.jsonl", b"{}", bool)


@pytest.mark.parametrize("name", ["a.binary", "a.csv", "a.bsdf"])
def test_a_pipe_among_inputs_does_not_hang(metapp: Callable, sent: Path, name: str) -> None:
    os.mkfifo(sent / name)
    assert f"{name}: a pipe or device, expected a file" in metapp("overfit", "brdf", sent / name, "--quiet").error
