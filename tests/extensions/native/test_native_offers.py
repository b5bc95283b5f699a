"""The engine that the extension offers, and torch's without it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
import torch

from metapp.extensions.native.fastest import COMPILED, Fastest, can_compile
from metapp.learning.adjoint import Engine, fastest


def test_the_engine_is_that_of_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fastest(compiles=True) == Fastest(compiles=True)
    monkeypatch.setenv("METAPP_WITHOUT", "native")
    assert type(fastest(compiles=True)) is Engine


def test_torch_compiles_where_nobody_else_can_write(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "compile", lambda function: function)
    monkeypatch.setattr(shutil, "which", lambda name: name)
    monkeypatch.setenv(COMPILED, "")
    assert can_compile.__wrapped__()
    assert os.environ[COMPILED] == str(cache / "torch")
    shared = cache / "shared"
    shared.mkdir()
    (shared / "code.py").touch()
    shared.chmod(0o777)
    monkeypatch.setenv(COMPILED, str(shared))
    with pytest.warns(UserWarning, match=f"{shared}: .* open to others, .* {COMPILED} name another place"):
        assert can_compile.__wrapped__()
    assert os.environ[COMPILED] != str(shared)
