"""Files are there whole or not at all."""

import os
from pathlib import Path

import pytest

from metapp.files import check_readable, write_atomically


def test_write_atomically(tmp_path: Path) -> None:
    path = tmp_path / "new" / "picture.png"
    write_atomically(path, lambda partial: partial.write_text("one"))
    assert path.read_text() == "one"

    def fail(partial: Path) -> None:
        assert partial.parent == path.parent
        assert partial.suffix == ".png"
        partial.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, fail)
    assert path.read_text() == "one"
    assert list(path.parent.iterdir()) == [path]


def test_pipes_and_devices_are_no_inputs(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ValueError, match="a pipe or device"):
            check_readable(path)
    check_readable(tmp_path)
