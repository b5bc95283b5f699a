"""The examples for clusters, on a local cluster of two workers; make test-cluster installs what they need."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import metapp

EXAMPLES = Path(__file__).parent.parent / "examples"
pytestmark = [pytest.mark.long, pytest.mark.usefixtures("compiled")]


@pytest.mark.parametrize(("script", "package"), [("dask_fits.py", "distributed"), ("ray_fits.py", "ray")])
def test_two_workers_fit_as_one_process_does(
    script: str, package: str, neural_fits: Callable[[int], Path], tmp_path: Path
) -> None:
    """Each source once, with the same error; a bad one is a row with its reason and stops no other."""
    if not importlib.util.find_spec(package):
        pytest.skip(f"{package} is not installed; make test-cluster installs it")
    networks = [str(folder) for folder in sorted(neural_fits(9).iterdir())]
    (tmp_path / "torn.binary").write_bytes(b"x")
    torn = str(tmp_path / "torn.binary")
    done = subprocess.run(
        [sys.executable, EXAMPLES / script, *networks, torn],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(EXAMPLES.parent)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    rows = {row["source"]: row for row in map(json.loads, done.stdout.splitlines())}
    assert rows.keys() == {*networks, torn}
    assert len(done.stdout.splitlines()) == 10
    assert rows[torn]["failure"].startswith(f"{torn}: 1 bytes, expected 34,992,012")
    for place in networks[::8]:
        assert rows[place]["error"] == pytest.approx(metapp.fit("brdf", place).error, rel=1e-6)
