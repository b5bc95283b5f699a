"""Files of scenes, at the limits of their names and sizes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metapp.extensions.scene_files import places as module
from metapp.extensions.scene_files.places import Places, read_text


def refused(message: str, call: Callable[..., Any], *words: Any) -> None:
    with pytest.raises(ValueError, match=message):
        call(*words)


def test_names_of_files(tmp_path: Path) -> None:
    places = Places((tmp_path / "first", tmp_path), (tmp_path,))
    for name in ("a" * 1025, "a\0b", "\0"):
        refused("a name of a file, .*, expected one of up to 1024 characters, without NUL", places.file, name)
    refused("file not found", places.file, "a/" * 512)
    (tmp_path / "first").mkdir()
    for folder, content in ((tmp_path, "second"), (tmp_path / "first", "first")):
        (folder / "x.txt").write_text(content)
        assert places.text("x.txt") == (folder / "x.txt", content)
    for odd in ("a$b", "a\u200bb"):  # a point of entry of Mitsuba's own parameters; what cannot be seen
        (tmp_path / odd).write_text("x")
        refused("expected a path that is printable and without '\\$'", places.text, odd)
    assert places.folder("first") == tmp_path / "first"
    refused("which is no folder; give one", places.folder, "x.txt")
    refused("which is no regular file", places.file, "first")
    assert places.first(tmp_path / "none").search == (tmp_path / "none", *places.search)


def test_files_are_as_long_as_is_allowed_and_no_longer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for limit in ("TEXT_BYTES", "_DATA_BYTES"):
        monkeypatch.setattr(module, limit, 10)
    file, places = tmp_path / "x.xml", Places((tmp_path,), (tmp_path,))
    for content, text in ((b"", ""), (b"x" * 10, "x" * 10), (b"\xef\xbb\xbfab", "ab")):  # without a byte order mark
        file.write_bytes(content)
        assert read_text(file) == text
        assert places.file("x.xml") == file
    file.write_bytes(b"x" * 11)
    refused("more than 10 bytes", read_text, file)
    refused("of 11 bytes, expected 10 at most", places.file, "x.xml")
    file.write_bytes(b"\xff")
    refused("not text in UTF-8", read_text, file)
    refused("No such file", read_text, tmp_path / "none")
    refused("no regular file", read_text, tmp_path)
