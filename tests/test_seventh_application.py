"""An application in a package of its own: installed beside metapp, every command takes it; uninstalled, none does."""

import json
import math
import os
import re
import shutil
import site
import subprocess
import sys
import venv
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.shell import run_commands

pytestmark = pytest.mark.usefixtures("compiled_in_cache")

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / "examples" / "seventh_application"
MAIN = "from metapp.cli import main; main()"


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

    def run(self, lines: str, *words: object, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a program of these lines."""
        return subprocess.run(
            [self.python, "-c", lines, *map(str, words)],
            capture_output=True,
            text=True,
            check=False,
            cwd=self.python.parent,
            env={**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1", **variables},
        )

    def commands(self, *lines: Sequence[object]) -> list[str]:
        """What commands print, each of which ends well."""
        return run_commands(*lines, folder=self.python.parent, python=self.python)


@pytest.fixture
def curves(tmp_path: Path) -> Path:
    """A folder of 20 curves: sums of two sines."""
    folder = tmp_path / "curves"
    folder.mkdir()
    for i in range(20):
        values = [0.5 * math.sin(i + x / 6) + 0.3 * math.sin((1 + i % 3) * x / 10) for x in range(32)]
        (folder / f"c{i:02d}.curve").write_text("\n".join(map(str, values)))
    return folder


@pytest.mark.long
def test_every_command_takes_the_seventh_application(curves: Path, tmp_path: Path) -> None:
    installed = Environment(tmp_path / "env")
    data, runs = tmp_path / "set", tmp_path / "runs"
    shared = ["--out", runs, "--quiet", "--json"]
    train = ["--data", data, *shared, "--train", "--train-steps", "2"]
    output = installed.commands(
        ["meta", "curve", "--help"],
        ["data", "--help"],
        ["data", "curve", curves, "--out", data, "--json", "--quiet"],
        ["data", "check", data],
        ["baseline", "curve", curves / "c00.curve", "--method", "line", *shared],
        ["general", "curve", *train, "--export", "csv"],
        ["meta", "curve", *train],
        ["quickft", "curve", *train],
        ["overfit", "curve", "--data", data, *shared],
    )
    assert "What to fit: .curve files of 32 numbers" in " ".join(output[0].replace("│", " ").split())
    assert "Convert curves, text files of 32 numbers." in output[1]
    assert json.loads(output[2])["app"] == "curve"
    assert "no problems" in output[3]
    assert json.loads(output[4])["tasks"][0]["error"] < 1
    error = {
        name: json.loads(output[5 + i])["error"] for i, name in enumerate(("general", "meta", "quickft", "overfit"))
    }
    assert error["overfit"] < error["general"]
    assert len(list(runs.rglob("curve.png"))) == 4 * 4
    assert len(list(runs.rglob("csv/*.csv"))) == 4
    (start,) = (runs / "curve" / "checkpoints").iterdir()
    trained = ["evaluate", "curve", "--data", data, "--checkpoint", start, "--out", runs, "--quiet"]
    table, storage, _ = installed.commands(
        [*trained, "--whole", "--json"],
        [*trained, "--which", "storage", "--format", "markdown"],
        [*trained, "--figures", tmp_path / "figures", "--report", tmp_path / "report"],
    )
    rows = {row["paradigm"]: row for row in json.loads(table)["rows"]}
    assert {name: rows[name]["error"] for name in error} == error
    assert {row["paper_error"] for row in rows.values()} == {None}
    assert "| curve |" in storage
    assert list((tmp_path / "figures").glob("*.png"))
    assert "Curve" in (tmp_path / "report" / "index.md").read_text()


def test_help_and_python_list_it_until_it_is_broken_or_uninstalled(curves: Path, tmp_path: Path) -> None:
    installed = Environment(tmp_path / "env")
    assert "curve" in installed.commands(["meta", "--help"])[0]
    typed = {"_METAPP_COMPLETE": "complete_bash", "COMP_WORDS": "metapp baseline curve --method ", "COMP_CWORD": "4"}
    assert installed.run(MAIN, **typed).stdout.split() == ["line"]
    fit = "import sys, metapp; fit = metapp.fit('curve', sys.argv[1], paradigm='overfit'); print(fit.error)"
    assert float(installed.run(fit, curves / "c00.curve").stdout) < 0.1
    (package,) = installed.python.parent.parent.glob("lib/python*/site-packages/metapp_curve/__init__.py")
    package.write_text("import nothing_of_this_name\n")
    result = installed.run(MAIN, "doctor")
    assert "extension curve of metapp-curve: ModuleNotFoundError" in result.stdout + result.stderr
    installed.pip("uninstall", "--quiet", "--yes", "metapp-curve")
    result = installed.run(MAIN, "doctor")
    assert "curve" not in result.stdout + result.stderr
    assert installed.run(MAIN, "meta", "curve").returncode != 0


# The smallest extensions of docs/developers/extend.md


PAGE = ROOT / "docs" / "developers" / "extend.md"


@pytest.mark.usefixtures("compiled_in_cache")
def test_the_blocks_of_the_page_work_as_one_package(
    write_nbrdf_networks: Callable[[int], Path], tmp_path: Path
) -> None:
    """Installed as a reader would, with all modules in one folder."""
    (write_nbrdf_networks(1) / "m0").rename(tmp_path / "gold")
    package = tmp_path / "package"
    package.mkdir()
    blocks = re.findall(r"```(\w+)\n(?:# (\w+\.\w+)\n)?(.*?)```", PAGE.read_text(), re.DOTALL)
    for _, name, text in blocks:
        assert name
        (package / name).write_text(text)
    installed = Environment(tmp_path / "env")
    installed.pip("install", "--quiet", "--no-deps", "--no-build-isolation", "--editable", str(package))
    quick = ("--recipe", "quick", "--quiet")
    output = run_commands(
        ("data", "synth", "brdf", "--count", 5, "--out", "set", "--quiet"),
        ("meta", "brdf", "--data", "set", "--rule", "meta-damped", "--train", "--train-steps", 1, "--json", *quick),
        ("meta", "brdf", "--help"),
        ("baseline", "brdf", "gold", "--method", "mean", "--json", "--quiet"),
        ("general", "brdf", "gold", "--export", "text", "--out", "runs", *quick),
        ("overfit", "brdf", "gold", "--recipe", "robust", "--steps", 200, "--json", "--quiet"),
        ("general", "brdf", "--data", "set", "--recipe", "robust", "--train", "--train-steps", 2, "--json", "--quiet"),
        folder=tmp_path,
        python=installed.python,
        METAPP_WITHOUT="native",  # torch would compile the rule, for a minute
    )
    fit = json.loads(output[1])
    assert fit["rule"] == "meta-damped"
    assert fit["error"] > 0
    assert "meta-damped" in output[2]
    assert 0 < json.loads(output[3])["tasks"][0]["error"] < 100
    (file,) = (tmp_path / "runs").rglob("text/gold.txt")
    assert re.fullmatch(r"gold: \[(\d\.\d+(e-\d+)?(, |\]\n)){3}", file.read_text())
    assert 0 < json.loads(output[5])["error"] < 10
    assert json.loads(output[6])["error"] > 0
