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
