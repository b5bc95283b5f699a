"""The example inputs: small files, the same each time; tests/golden holds what the formats read of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from data_tools.synthetic.examples import EXAMPLES, write_example
from metapp.registry import app_names


@pytest.mark.parametrize("app", app_names())
def test_example_inputs_are_small_files_of_the_names_that_are_listed(app: str, tmp_path: Path) -> None:
    files = write_example(app, tmp_path / "new")
    assert files == [tmp_path / "new" / name for name in EXAMPLES[app].files]
    assert sorted((tmp_path / "new").iterdir()) == sorted(files)
    assert all(file.stat().st_size < 500_000 for file in files)


def test_an_application_without_example_inputs_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"smell: no example inputs, expected one of brdf, .*\.$"):
        write_example("smell", tmp_path)
