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


PIPES = {
    "brdf": ("a.binary", "a.csv", "a.bsdf"),
    "texture": ("a.png",),
    "svbrdf_nonstationary": ("a;b.png",),
    "illumination": ("a.exr", "a.png"),
    "transport": ("a.xml", "a.json"),
}


@pytest.mark.parametrize(("app", "name"), [(app, name) for app, names in PIPES.items() for name in names])
def test_a_pipe_among_inputs_does_not_hang(metapp: Callable, sent: Path, app: str, name: str) -> None:
    os.mkfifo(sent / name)
    assert f"{name}: a pipe or device, expected a file" in metapp("overfit", app, sent / name, "--quiet").error
