"""The cache folder where it cannot be made or written to."""

import pwd
from pathlib import Path
from typing import NoReturn

import pytest

from metapp.storage import cache_folders
from metapp.storage.cache_folders import CACHE_VARIABLE, cache_folder, make_cache_folder


def test_a_cache_that_cannot_be_made_is_named_and_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    line = f"{folder}: Not a directory, expected a cache folder that can be written to; set METAPP_CACHE to one."
    with pytest.raises(ValueError, match=line):
        make_cache_folder()
    with pytest.warns(UserWarning, match=f"{line} Until then a temporary folder is used."):
        temporary_folder = cache_folder()
    assert temporary_folder.is_dir()
    assert cache_folder() == temporary_folder  # said and made once


def test_a_cache_without_right_to_write_is_read_but_for_code(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(folder: Path) -> NoReturn:
        raise PermissionError(13, "Permission denied", str(folder))

    for name in ("weights", "data/set/manifest.json", "native/library.so"):
        (cache / name).parent.mkdir(parents=True, exist_ok=True)
        (cache / name).write_text(name)
    monkeypatch.setattr(cache_folders, "make_writable_folder", refuse)
    with pytest.warns(UserWarning, match=f"{cache}: Permission denied"):
        folder = cache_folder()
    files = {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}
    assert files == {name: name for name in ("weights", "data/set/manifest.json")}
    (folder / "data" / "set" / "more").write_text("")
    assert not (cache / "data" / "set" / "more").exists()


def test_a_user_without_a_home_folder_is_told_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find_nobody(_: int) -> NoReturn:
        raise KeyError

    for name in (CACHE_VARIABLE, "HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", find_nobody)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"the user has no home folder, .*; set METAPP_CACHE to one\.$"):
        make_cache_folder()
    assert list(tmp_path.iterdir()) == []


def test_a_tilde_stands_for_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv(CACHE_VARIABLE, "~/kept")
    assert make_cache_folder() == tmp_path / "kept"
