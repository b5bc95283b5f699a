"""The listing of folders: files are found by their endings at any depth, and foreign files are not opened."""

import os
from pathlib import Path

import pytest

from data_tools.readers.listing import files_below, find_by_suffix, has_suffix
from data_tools.readers.square_photos import find
from tests.found_paths import find_paths


def test_files_of_a_folder_by_their_endings(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / ".hidden").mkdir()
    for name in ("b/1.CSV", "a.csv", "b.csv", "b-1.csv", "c.txt", ".d.csv", ".hidden/e.csv"):
        (tmp_path / name).touch()
    (tmp_path / "linked").symlink_to(tmp_path / "b", target_is_directory=True)
    found = [str(file.relative_to(tmp_path)) for file in files_below(tmp_path, (".csv", ".bsdf"))]
    assert found == ["a.csv", str(Path("b/1.CSV")), "b-1.csv", "b.csv"]  # in the order of paths
    assert has_suffix(tmp_path, ".csv")
    assert not has_suffix(tmp_path / "c.txt", ".csv")
    assert find_by_suffix(tmp_path / "b/1.CSV", ".csv", "a table") == ([tmp_path / "b/1.CSV"], [])


def test_folders_within_each_other(tmp_path: Path) -> None:
    folders = [str(tmp_path) + "/d" * depth for depth in range(1, 1501)]
    for folder in folders:
        os.mkdir(folder)
    try:
        assert files_below(tmp_path) == []
        with pytest.raises(ValueError, match=r": no image in this folder, expected an image file"):
            find(tmp_path)
    finally:
        for folder in reversed(folders):  # what removes the folders of tests would end in a RecursionError
            os.rmdir(folder)


def test_foreign_files_are_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "data_tools.readers.square_photos.is_readable_image", lambda file: pytest.fail(f"opened {file}")
    )
    for name in ("a.jpg", "b.txt", "c.dat"):
        (tmp_path / name).touch()
    files, skipped = find_paths(find, tmp_path)
    assert [file.name for file in files] == ["a.jpg"]
    assert len(skipped) == 2
