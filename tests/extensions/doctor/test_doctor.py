"""`metapp doctor`: it lists what is installed and what is missing."""

from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest


def test_doctor_lists_what_is_installed(metapp: Callable, cache: Path) -> None:
    document = metapp("doctor", "--json").json_document
    assert document["versions"]["torch"] == metadata.version("torch")
    assert document["cache"] == str(cache)
    assert document["checkpoints"]["texture full"] == "general, meta-encoder, quickft"
    assert "brdf full" not in document["checkpoints"]  # of the quick recipe's size, in its folder
    out = metapp("doctor").out
    assert out.startswith("versions")
    assert "; texture full: general, meta-encoder, quickft; " in out


def test_doctor_reports_a_missing_compiler(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(Path.cwd()))
    for _ in ("missing", "broken"):
        assert metapp("doctor", "--json").json_document["compiler"].startswith("none that works")
        Path("g++").write_text("#!/bin/sh\nexit 1\n")
        Path("g++").chmod(0o755)
