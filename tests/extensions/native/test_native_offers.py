"""The engine that the extension offers, and torch's without it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from data_tools.synthetic.examples import write_example
from metapp.extensions.native.fastest import Fastest
from metapp.learning.adjoint import Engine, fastest


def test_the_engine_is_that_of_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fastest(compiles=True) == Fastest(compiles=True)
    monkeypatch.setenv("METAPP_WITHOUT", "native")
    assert type(fastest(compiles=True)) is Engine


def test_fits_go_on_by_torch(metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (table,) = write_example("brdf", Path())
    errors = []
    for left_out in ("", "native"):
        monkeypatch.setenv("METAPP_WITHOUT", left_out)
        done = metapp("meta", "brdf", table, "--json", "--out", f"runs{left_out}").done
        errors.append(done["tasks"][0]["error"])
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)
