"""An application that lies in two folders beside metapp: every command takes it, nothing else is edited."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / "examples" / "seventh_application"
LINES = """
import json, sys
import metapp.apps, data_tools.formats
metapp.apps.__path__.append(sys.argv[1] + "/metapp/apps")
data_tools.formats.__path__.append(sys.argv[1] + "/data_tools/formats")
from metapp.cli.commands import app
from metapp.cli.console import run
from metapp.evaluation.figures import style
style.DPI = 40  # nobody looks at these figures
for line in sys.stdin:
    words = json.loads(line)
    code = run(lambda: app(words, standalone_mode=False, prog_name="metapp"))
    print(f"\\n== {code}", flush=True)
"""


def commands(*lines: list[str]) -> list[str]:
    """What commands print, in a program that has the application."""
    done = subprocess.run(
        [sys.executable, "-c", LINES, EXAMPLE],
        input="\n".join(json.dumps(list(map(str, line))) for line in lines),
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1"},
    )
    assert "Traceback" not in done.stderr
    parts = done.stdout.split("\n== ")
    codes = [part.partition("\n")[0] for part in parts[1:]]
    assert codes == ["0"] * len(lines), done.stderr
    return [parts[0], *(part.partition("\n")[2] for part in parts[1:-1])]


@pytest.fixture
def curves(tmp_path: Path) -> Path:
    """A folder of 20 curves: sums of two sines."""
    folder = tmp_path / "curves"
    folder.mkdir()
    for i in range(20):
        values = [0.5 * math.sin(i + x / 6) + 0.3 * math.sin((1 + i % 3) * x / 10) for x in range(32)]
        (folder / f"c{i:02d}.curve").write_text("\n".join(map(str, values)))
    return folder


def test_it_is_converted_trained_and_fitted(curves: Path, tmp_path: Path) -> None:
    data, runs = tmp_path / "set", tmp_path / "runs"
    said = commands(
        ["meta", "curve", "--help"],
        ["data", "curve", curves, "--out", data, "--json", "--quiet"],
        ["data", "check", data],
        ["general", "curve", "--data", data, "--out", runs, "--quiet", "--json", "--train", "--train-steps", "5"],
    )
    assert "What to fit: .curve files of 32 numbers" in " ".join(said[0].replace("│", " ").split())
    assert json.loads(said[1])["app"] == "curve"
    assert "no problems" in said[2]
    assert math.isfinite(json.loads(said[3])["error"])
    assert list(runs.rglob("outputs/*/curve.png"))


@pytest.mark.long
def test_every_command_takes_it(curves: Path, tmp_path: Path) -> None:
    data, runs = tmp_path / "set", tmp_path / "runs"
    shared = ["--data", data, "--out", runs, "--quiet"]
    train = [*shared, "--json", "--train", "--train-steps"]
    said = commands(
        ["meta", "curve", "--help"],
        ["data", "--help"],
        ["data", "curve", curves, "--out", data, "--json", "--quiet"],
        ["data", "check", data],
        ["general", "curve", *train, "200"],
        ["quickft", "curve", *train, "5"],
        ["meta", "curve", *train, "10"],
        ["overfit", "curve", *shared, "--json"],
        ["finetune", "curve", *shared, "--json"],
        ["evaluate", "curve", *shared, "--json"],
        ["evaluate", "curve", *shared, "--which", "storage", "--format", "markdown"],
        ["evaluate", "curve", *shared, "--figures", tmp_path / "figures", "--report", tmp_path / "report"],
    )  # fmt: skip
    assert "What to fit: .curve files of 32 numbers" in " ".join(said[0].replace("│", " ").split())
    assert "Convert curves, text files of 32 numbers." in said[1]
    assert json.loads(said[2])["app"] == "curve"
    assert "no problems" in said[3]
    error = {name: json.loads(said[4 + i])["error"] for i, name in
             enumerate(("general", "quickft", "meta", "overfit", "finetune"))}  # fmt: skip
    assert max(error["overfit"], error["finetune"]) < error["general"]
    rows = {row["paradigm"]: row for row in json.loads(said[9])["rows"]}
    assert {name: rows[name]["error"] for name in error} == error
    assert {row["paper_error"] for row in rows.values()} == {None}
    assert "| curve |" in said[10]
    assert list((tmp_path / "figures").glob("*.png"))
    assert "Curve" in (tmp_path / "report" / "index.html").read_text()
    outputs = list(runs.rglob("outputs/*/curve.png"))
    assert len(outputs) >= 4 * 5


def test_its_cost_is_as_documented() -> None:
    files = {path: len(path.read_text().splitlines()) for path in EXAMPLE.rglob("*.py")}
    assert len(files) == 4
    assert sum(files.values()) < 220
