"""Files that replace others only if that is asked for."""

from pathlib import Path

import pytest

from metapp.storage.files import move_files
from tests.pictures import write_text


def test_files_move_together_or_not_at_all(tmp_path: Path) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    for name in ("a.txt", "maps/b.txt"):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        write_text(source / name)
    (target / "maps").mkdir(parents=True)
    for name in ("maps/b.txt", "maps/own.txt"):
        (target / name).write_text("measured")
    with pytest.raises(FileExistsError, match=r"b\.txt: is there already, expected .*overwrite=True"):
        move_files(source, target, overwrite=False)
    assert not (target / "a.txt").exists()
    assert (source / "a.txt").is_file()
    assert (target / "maps/b.txt").read_text() == "measured"
    move_files(source, target, overwrite=True)
    assert (target / "a.txt").is_file()
    assert (target / "maps/b.txt").read_text() != "measured"
    assert (target / "maps/own.txt").read_text() == "measured"
