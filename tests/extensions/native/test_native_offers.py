"""The engine that the extension offers, and torch's without it."""

from __future__ import annotations

import pytest

from metapp.extensions.native.fastest import Fastest
from metapp.learning.adjoint import Engine, fastest


def test_the_engine_is_that_of_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fastest(compiles=True) == Fastest(compiles=True)
    monkeypatch.setenv("METAPP_WITHOUT", "native")
    assert type(fastest(compiles=True)) is Engine
