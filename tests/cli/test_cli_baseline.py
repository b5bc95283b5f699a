"""`metapp baseline`: methods of the baselines table on a user's own files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import OpenImageIO as oiio
import pytest

from metapp.storage.records import read_records
from tests.pictures import photograph


@pytest.mark.parametrize("method", ["quilting", "gpdm", "patches"])
def test_a_method_makes_a_picture_and_a_record_of_a_file(metapp: Callable, method: str) -> None:
    photograph(Path("wall.png"), 9, 80)
    done = metapp("baseline", "texture", "wall.png", "--method", method, "--recipe", "quick", "--json")
    assert done.code == 0, done.err
    out = Path(done.document["out"])
    (record,) = read_records(out / "record.jsonl")
    assert record["name"] == "wall"
    assert record["error"] == done.document["tasks"][0]["error"] > 0
    assert record["seconds"] > 0
    spec = oiio.ImageBuf(str(out / "outputs" / "wall" / "texture.png")).spec()
    assert (spec.width, spec.height) == (64, 64)
    assert "cannot" in done.err


def test_an_unknown_method_is_refused_and_the_known_ones_are_named(metapp: Callable) -> None:
    photograph(Path("wall.png"), 9, 80)
    done = metapp("baseline", "texture", "wall.png", "--method", "magic")
    assert done.code == 2
    assert "expected nearest, quilting, gpdm, patches" in done.err
    assert not Path("runs").exists()
