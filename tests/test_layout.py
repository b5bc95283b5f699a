"""How the code hangs together: who imports whom, who prints, what is installed, and that nothing is unpickled."""

import configparser
import os
import re
import subprocess
import sys
from pathlib import Path

import grimp
import pytest

from metapp.names import app_names

ROOT = Path(__file__).parent.parent
FILES = [path for package in ("metapp", "data_tools") for path in sorted((ROOT / package).rglob("*.py"))]
PRINTS = r"^ *(?:print|exit|quit|sys\.exit|os\._exit|sys\.std(?:out|err)\.write)\("
UNPICKLES = (
    r"^ *(?:import|from) (?:pickle|cPickle|dill|cloudpickle|joblib|shelve|marshal)\b"
    r"|torch\.load\(|allow_pickle=(?!False)"
)


def files_with(pattern: str) -> list[str]:
    """Our files in which a line matches."""
    found = (path for path in FILES if re.search(pattern, path.read_text(encoding="utf-8"), re.MULTILINE))
    return [str(path.relative_to(ROOT)) for path in found]


def test_layers() -> None:
    """The contracts of setup.cfg hold: who imports whom, who knows a terminal."""
    done = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as lint; lint()", "--no-cache"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stdout


def test_no_circles_among_files() -> None:
    graph = grimp.build_graph("metapp", "data_tools", cache_dir=None)
    needed = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    while leaves := {name for name, others in needed.items() if not others & needed.keys()}:
        needed = {name: others for name, others in needed.items() if name not in leaves}
    assert sorted(needed) == []


def test_paradigms_name_no_application() -> None:
    named = files_with("|".join(f'"{name}"' for name in app_names()))
    assert not [file for file in named if file.startswith("metapp/paradigms")]


def test_only_the_command_line_prints_or_exits() -> None:
    assert not [file for file in files_with(PRINTS) if not file.startswith("metapp/cli/")]


def test_nothing_is_unpickled() -> None:
    """But the public weights of VGG: tests/extensions/vgg holds that their hashes come first, classes are refused."""
    assert files_with(UNPICKLES) == ["metapp/extensions/vgg/weights.py"]


def test_every_extension_is_offered() -> None:
    """A folder that no entry point is called as would be installed and never found."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg", "utf-8")
    points = setup["options.entry_points"]["metapp.extensions"].split("\n")
    offered = dict(point.split(" = ") for point in points if point)
    folders = {path.parent.name for path in (ROOT / "metapp" / "extensions").glob("*/__init__.py")}
    assert offered == {name: f"metapp.extensions.contents:{name}" for name in folders}


@pytest.mark.parametrize("arguments", [[], ["data"], ["data", "merl"], ["meta", "brdf"]])
def test_help_answers_at_once(arguments: list[str]) -> None:
    lines = "import sys\nfrom metapp.cli import main\ntry:\n    main()\nfinally:\n"
    lines += "    print({'torch', 'mitsuba', 'colour', 'matplotlib', 'numpy', 'scipy'} & sys.modules.keys())"
    done = subprocess.run(
        [sys.executable, "-c", lines, *arguments, "--help"], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.splitlines()[-1] == "set()"
