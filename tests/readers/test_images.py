"""Texture tasks from photographs: what the command line relies on of a reader."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from data_tools.readers import photos
from data_tools.readers.photos import read_photo
from tests.pictures import photograph


def test_a_task_is_named_by_the_stem_and_holds_one_image(tmp_path: Path) -> None:
    path = photograph(tmp_path / "old bark.v2.png")
    task = photos.read_task(path)
    assert task.name == "old bark.v2"
    assert list(task.data) == list(photos.UNITS) == ["image"]
    assert task.data["image"].shape == (3, 256, 256)
    assert task.data["image"].dtype == torch.uint8
    assert torch.equal(task.data["image"], read_photo(path))
    assert photos.read_task(path, 40).data["image"].shape == (3, 40, 40)


def test_images_and_folders_of_them_are_recognised(tmp_path: Path) -> None:
    photograph(tmp_path / "deep" / "er" / "a.JPEG")
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("about")
    (tmp_path / "broken.jpg").write_text("about")
    for name in ("", "deep", "deep/er/a.JPEG", "broken.jpg"):
        assert photos.recognises(tmp_path / name)
    for name in ("empty", "notes.txt", "missing.png"):
        assert not photos.recognises(tmp_path / name)


def test_what_is_found_can_be_read(tmp_path: Path) -> None:
    for name in ("b.png", "a.tif", "sub/c.png"):
        photograph(tmp_path / name)
    (tmp_path / "notes.txt").write_text("about")
    sources, skipped = photos.find([tmp_path])
    assert [photos.read_task(source, 32).name for source in sources] == ["a", "b", "c"]
    assert len(skipped) == 1
    with pytest.raises(ValueError, match=r"notes.txt: not an image"):
        photos.read_task(photos.find([tmp_path / "notes.txt"])[0][0])
