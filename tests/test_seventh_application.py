"""An application in a package of its own: installed beside metapp, every command takes it; uninstalled, none does."""

from __future__ import annotations

import json
import math
import os
import shutil
import site
import subprocess
import sys
import venv
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / "examples" / "seventh_application"
LINES = """
import json, sys
from metapp.cli.commands import app
from metapp.cli.console import run
from metapp.evaluation import style
style.DPI = 40  # nobody looks at these figures
for line in sys.stdin:
    words = json.loads(line)
    code = run(lambda: app(words, standalone_mode=False, prog_name="metapp"))
    print(f"\\n== {code}", flush=True)
"""


class Environment:
    """A virtual environment that has what this one has, and the application's package."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder, with_pip=False, symlinks=True)
        self.python = folder / "bin" / "python"
        places = [str(ROOT), *site.getsitepackages()]
        (packages,) = folder.glob("lib/python*/site-packages")
        (packages / "beside.pth").write_text("".join(f"import site; site.addsitedir({place!r})\n" for place in places))
        source = folder / "source"
        shutil.copytree(EXAMPLE, source, ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info"))
        self.pip("install", "--quiet", "--no-deps", "--no-build-isolation", str(source))

    def pip(self, *words: str) -> None:
        """Run pip on this environment."""
        command = [sys.executable, "-m", "pip", "--python", self.python, "--disable-pip-version-check", *words]
        subprocess.run(command, check=True, capture_output=True, text=True)

    def run(self, lines: str, *words: object, given: str = "", **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a program of these lines."""
        return subprocess.run(
            [self.python, "-c", lines, *map(str, words)],
            input=given,
            capture_output=True,
            text=True,
            check=False,
            cwd=self.python.parent,
            env={**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1", **variables},
        )

    def commands(self, *lines: list[object]) -> list[str]:
        """What commands print, each of which ends well."""
        done = self.run(LINES, given="\n".join(json.dumps(list(map(str, line))) for line in lines))
        assert "Traceback" not in done.stderr
        parts = done.stdout.split("\n== ")
        codes = [part.partition("\n")[0] for part in parts[1:]]
        assert codes == ["0"] * len(lines), done.stderr
        return [parts[0], *(part.partition("\n")[2] for part in parts[1:-1])]


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    return Environment(tmp_path_factory.mktemp("environment") / "env")


@pytest.fixture
def commands(installed: Environment) -> Callable[..., list[str]]:
    return installed.commands


@pytest.fixture
def curves(tmp_path: Path) -> Path:
    """A folder of 20 curves: sums of two sines."""
    folder = tmp_path / "curves"
    folder.mkdir()
    for i in range(20):
        values = [0.5 * math.sin(i + x / 6) + 0.3 * math.sin((1 + i % 3) * x / 10) for x in range(32)]
        (folder / f"c{i:02d}.curve").write_text("\n".join(map(str, values)))
    return folder


def test_it_is_converted_trained_and_fitted(commands: Callable, curves: Path, tmp_path: Path) -> None:
    data, runs = tmp_path / "set", tmp_path / "runs"
    shared = ["--out", runs, "--quiet", "--json"]
    said = commands(
        ["meta", "curve", "--help"],
        ["data", "curve", curves, "--out", data, "--json", "--quiet"],
        ["data", "check", data],
        ["general", "curve", "--data", data, *shared, "--train", "--train-steps", "2", "--export", "csv"],
        ["baseline", "curve", curves / "c00.curve", "--method", "line", *shared],
        ["meta", "curve", "--data", data, *shared, "--train", "--train-steps", "2"],
        ["quickft", "curve", "--data", data, *shared, "--train", "--train-steps", "2"],
    )
    assert "What to fit: .curve files of 32 numbers" in " ".join(said[0].replace("│", " ").split())
    assert json.loads(said[1])["app"] == "curve"
    assert "no problems" in said[2]
    assert math.isfinite(json.loads(said[3])["error"])
    assert list(runs.rglob("outputs/*/curve.png"))
    assert len(list(runs.rglob("csv/*.csv"))) == 4
    assert json.loads(said[4])["tasks"][0]["error"] < 1
    (start,) = (runs / "curve" / "checkpoints").iterdir()
    (table,) = commands(["evaluate", "curve", "--data", data, "--checkpoint", start, *shared])[:1]
    rows = {row["paradigm"]: row["error"] for row in json.loads(table)["rows"]}
    assert (rows["meta"], rows["quickft"]) == tuple(json.loads(said[i])["error"] for i in (5, 6))


def test_help_completion_and_the_python_api_have_it(installed: Environment, curves: Path) -> None:
    assert "curve" in installed.commands(["meta", "--help"])[0]
    typed = {"_METAPP_COMPLETE": "complete_bash", "COMP_WORDS": "metapp baseline curve --method ", "COMP_CWORD": "4"}
    assert installed.run("from metapp.cli import main; main()", **typed).stdout.split() == ["line"]
    fit = "import sys, metapp; fit = metapp.fit('curve', sys.argv[1], paradigm='overfit'); print(fit.error)"
    assert float(installed.run(fit, curves / "c00.curve").stdout) < 0.1


def test_uninstalled_nothing_of_it_is_left(tmp_path: Path) -> None:
    environment = Environment(tmp_path / "env")
    names = "import metapp.apps; print('curve' in metapp.apps.app_names())"
    assert environment.run(names).stdout == "True\n"
    environment.pip("uninstall", "--quiet", "--yes", "metapp-curve")
    assert environment.run(names).stdout == "False\n"
    done = environment.run("from metapp.cli import main; main()", "meta", "curve")
    assert done.returncode != 0


def test_a_package_that_cannot_be_imported_is_left_out_and_said(tmp_path: Path) -> None:
    environment = Environment(tmp_path / "env")
    (packages,) = environment.python.parent.parent.glob("lib/python*/site-packages/metapp_curve/__init__.py")
    packages.write_text("import nothing_of_this_name\n")
    done = environment.run("import sys; from metapp.cli import main; sys.argv = ['metapp', 'doctor']; main()")
    assert "extension curve of metapp-curve: ModuleNotFoundError" in done.stdout + done.stderr


@pytest.mark.long
def test_every_command_takes_it(commands: Callable, curves: Path, tmp_path: Path) -> None:
    data, runs = tmp_path / "set", tmp_path / "runs"
    shared = ["--data", data, "--out", runs, "--quiet"]
    train = [*shared, "--json", "--train", "--train-steps"]
    said = commands(
        ["data", "--help"],
        ["data", "curve", curves, "--out", data, "--json", "--quiet"],
        ["general", "curve", *train, "200"],
    )
    (folder,) = (runs / "curve" / "checkpoints").iterdir()
    general, trained = ["--checkpoint", folder / "general.safetensors"], [*shared, "--checkpoint", folder]
    said += commands(
        ["quickft", "curve", *general, *train, "5"],
        ["meta", "curve", *general, *train, "10"],
        ["overfit", "curve", *shared, "--json"],
        ["finetune", "curve", *trained, "--json"],
        ["evaluate", "curve", *trained, "--whole", "--json"],
        ["evaluate", "curve", *trained, "--which", "storage", "--format", "markdown"],
        ["evaluate", "curve", *trained, "--figures", tmp_path / "figures", "--report", tmp_path / "report"],
    )  # fmt: skip
    assert "Convert curves, text files of 32 numbers." in said[0]
    error = {name: json.loads(said[2 + i])["error"] for i, name in
             enumerate(("general", "quickft", "meta", "overfit", "finetune"))}  # fmt: skip
    assert max(error["overfit"], error["finetune"]) < error["general"]
    rows = {row["paradigm"]: row for row in json.loads(said[7])["rows"]}
    assert {name: rows[name]["error"] for name in error} == error
    assert {row["paper_error"] for row in rows.values()} == {None}
    assert "| curve |" in said[8]
    assert list((tmp_path / "figures").glob("*.png"))
    assert "Curve" in (tmp_path / "report" / "index.md").read_text()
    assert len(list(runs.rglob("outputs/*/curve.png"))) >= 4 * 5
