"""The report and the figures of three small materials."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.evaluation.cli.conftest import data, done, evaluate, few
from tests.evaluation.cli.subjects import call, few_steps

__all__ = ["data", "done", "evaluate", "few"]


@pytest.fixture(scope="session")
def drawn(data: Path, done: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the figures and the report of these runs."""
    folder = tmp_path_factory.mktemp("drawn")
    words = ("--data", data, "--out", done / "runs", "--no-run", "--quiet", "--json")
    with few_steps():
        assert call("evaluate", "brdf", *words, "--report", folder / "report", "--figures", folder / "figures") == 0
    return folder
