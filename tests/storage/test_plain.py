"""Files that are files: links of others are not written through, pipes not read."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.storage import plain
from metapp.storage.files import append_line, partial_path, write_atomically
from metapp.storage.plain import open_regular, read_bytes, read_text, write_plainly
from metapp.storage.records import RunFolder


@pytest.fixture(autouse=True)
def _own_roots(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain, "_ROOTS", set())


@pytest.fixture
def sent(tmp_path: Path) -> Path:
    """A run folder that somebody sent, beside what it must not reach."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "keys").write_text("first\nlast")
    (tmp_path / "runs" / "run").mkdir(parents=True)
    write_plainly(tmp_path / "runs")
    return tmp_path / "runs" / "run"


def add(run: Path) -> None:
    RunFolder(run, {"steps": 1}).add({"name": "gold", "error": 1.0, "seconds": 1.0}, {"w": torch.zeros(1)})


@pytest.mark.parametrize("target", ["../../home/keys", "../../home/new"])
def test_a_linked_record_file_is_refused_and_its_target_as_it_was(sent: Path, target: str) -> None:
    (sent / "record.jsonl").symlink_to(target)
    with pytest.raises(ValueError, match=r"record\.jsonl: a link, expected a file of this folder; remove it"):
        add(sent)
    assert [path.name for path in (sent / "../../home").iterdir()] == ["keys"]
    assert (sent / "../../home/keys").read_text() == "first\nlast"


def test_a_record_file_with_another_name_is_refused_and_stays_as_it_was(sent: Path) -> None:
    (sent / "record.jsonl").hardlink_to(sent / "../../home/keys")
    with pytest.raises(ValueError, match=r"record\.jsonl: a link, expected a file of this folder; remove it"):
        add(sent)
    assert (sent / "../../home/keys").read_text() == "first\nlast"


@pytest.mark.parametrize("link", ["params", "", "."])
def test_a_linked_folder_is_refused(sent: Path, link: str) -> None:
    folder = sent / link if link != "." else sent / "outputs"
    if folder.is_dir():
        folder.rmdir()
    folder.symlink_to(sent.parents[1] / "home")
    with pytest.raises(ValueError, match=rf"{folder.name}: a link, expected a folder of this folder; remove it"):
        add(sent) if link != "." else write_atomically(folder / "a" / "b.png", Path.touch)
    assert [path.name for path in (sent.parents[1] / "home").iterdir()] == ["keys"]


def test_a_linked_file_is_replaced_and_its_target_as_it_was(sent: Path) -> None:
    target = sent.parents[1] / "home" / "keys"
    for name in (sent / "a.txt", partial_path(sent / "a.txt")):
        name.symlink_to(target)
    write_atomically(sent / "a.txt", lambda path: path.write_text("ours"))
    assert (sent / "a.txt").read_text() == "ours"
    assert not (sent / "a.txt").is_symlink()
    assert target.read_text() == "first\nlast"


@pytest.mark.parametrize("name", ["brdf", "brdf/checkpoints"])
def test_a_training_makes_no_folder_behind_a_link(metapp: Callable, sent: Path, name: str) -> None:
    home, link = sent.parents[1] / "home", sent.parent / name
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(home)
    made = metapp("general", "brdf", "--train", "--train-steps", 1, "--recipe", "quick", "--out", sent.parent)
    assert f"{link}: a link, expected a folder of this folder" in made.error
    assert [path.name for path in home.iterdir()] == ["keys"]


def test_the_folder_itself_may_be_a_link_of_its_user(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "runs").symlink_to("disk")
    write_plainly(tmp_path / "runs")
    add(tmp_path / "runs" / "run")
    assert (tmp_path / "disk" / "run" / "record.jsonl").is_file()


def test_a_pipe_is_no_record_file(sent: Path) -> None:
    os.mkfifo(sent / "record.jsonl")
    with pytest.raises(ValueError, match="a pipe or device, expected a file"):
        append_line(sent / "record.jsonl", b"{}", bool)


@pytest.mark.parametrize("read", [open_regular, read_bytes, read_text])
def test_what_is_no_file_is_not_read(read: Callable, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ValueError, match="a pipe or device, expected a file"):
            read(path)
    with pytest.raises(IsADirectoryError, match="a folder, expected a file"):
        read(tmp_path)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none")


def test_a_text_has_line_ends_of_one_kind(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"a\r\nb\rc\n")
    assert read_text(tmp_path / "a") == (tmp_path / "a").read_text() == "a\nb\nc\n"
