"""Files are there whole or not at all."""

from pathlib import Path

import pytest

from metapp.files import write_atomically


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
