"""What the extension offers, and commands without it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from metapp import door

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 1


def test_without_it_fits_work_and_its_commands_are_refused(
    metapp: Callable, fitted: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(door.WITHOUT, "reruns")
    run = fitted("meta")
    assert "a command of the extension reruns" in metapp("rerun", run).misuse
    assert "a command of the extension reruns" in metapp("compare", run, run).misuse
