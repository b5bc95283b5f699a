"""The smallest extensions of docs/developers/extend.md, each as a package beside metapp."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "developers" / "extend.md"
RUN = "import json, sys\nfrom metapp.cli import main\nsys.argv = ['metapp', *json.loads(sys.stdin.read())]\nmain()"


def blocks() -> dict[str, str]:
    """The Python files of the page, by name."""
    return dict(re.findall(r"```python\n# (\w+\.py)\n(.*?)```", PAGE.read_text(), re.DOTALL))


@pytest.fixture
def command(neural_fits: Callable[[int], Path], tmp_path: Path) -> Callable[..., str]:
    """Runs a command where these modules of the page are installed; returns its standard output."""
    (neural_fits(1) / "m0").rename(tmp_path / "gold")

    def run(module: str, *words: object) -> str:
        packages = tmp_path / "packages"
        info = packages / "mine-0.1.dist-info"
        info.mkdir(parents=True, exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 0.1\n")
        (info / "entry_points.txt").write_text(f"[metapp.extensions]\nmine = {module}\n")
        for name, text in blocks().items():
            (packages / name).write_text(text)
        path = os.pathsep.join(filter(None, [str(packages), str(ROOT), os.environ.get("PYTHONPATH", "")]))
        done = subprocess.run(
            [sys.executable, "-c", RUN],
            input=json.dumps(list(map(str, words))),
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "COLUMNS": "200"},
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_a_rule_is_trained_and_fits(command: Callable[..., str], tmp_path: Path) -> None:
    words = ("--recipe", "quick", "--rule", "meta-damped", "--train", "--train-steps", 1, "--json", "--quiet")
    data = ("synth", "brdf", "--count", 5, "--out", tmp_path / "set", "--quiet")
    command("damped", "data", *data)
    fit = json.loads(command("damped", "meta", "brdf", "--data", tmp_path / "set", *words))
    assert fit["rule"] == "meta-damped"
    assert fit["error"] > 0
    assert "meta-damped" in command("damped", "meta", "brdf", "--help")


def test_a_baseline_is_fitted(command: Callable[..., str]) -> None:
    fit = json.loads(command("mean_colour", "baseline", "brdf", "gold", "--method", "mean", "--json", "--quiet"))
    assert 0 < fit["tasks"][0]["error"] < 100


def test_an_export_is_written(command: Callable[..., str], tmp_path: Path) -> None:
    words = ("general", "brdf", "gold", "--recipe", "quick", "--export", "text", "--quiet", "--out", tmp_path / "runs")
    command("as_text", *words)
    (file,) = (tmp_path / "runs").rglob("text/gold.txt")
    assert "w1 (21, 6)" in file.read_text()
