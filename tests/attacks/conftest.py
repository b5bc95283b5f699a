"""What attacks share: commands in the test's folder, a network to fit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def network(neural_fits: Callable[[int], Path]) -> Path:
    return neural_fits(1) / "m0"


@pytest.fixture
def fit(metapp: Callable) -> Callable:
    return lambda paradigm, *arguments: metapp(paradigm, "brdf", *arguments, "--quiet")
