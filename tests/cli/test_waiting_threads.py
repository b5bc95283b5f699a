"""How OpenMP's threads wait: commands choose it before torch is imported, and the Python API leaves it alone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from metapp.cli import WAITING_VARIABLES

ROOT = Path(__file__).parent.parent.parent
# torch is not imported: OpenMP reads the variable at that moment, so that its value there is what counts
PROGRAM = """
import importlib.abc, os, runpy, sys

class TorchImport(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "torch":
            print(os.environ.get("OMP_WAIT_POLICY"), os.environ.get("GOMP_SPINCOUNT"))
            sys.exit()

sys.meta_path.insert(0, TorchImport())
"""
COMMAND = 'sys.argv = ["metapp", "doctor"]\nrunpy.run_module("metapp", run_name="__main__")'
API = "import metapp\nmetapp.fit"


@pytest.mark.parametrize(
    ("lines", "variables", "expected"),
    [
        (COMMAND, {}, "PASSIVE 1000"),
        (COMMAND, {"OMP_WAIT_POLICY": "ACTIVE"}, "ACTIVE None"),
        (COMMAND, {"GOMP_SPINCOUNT": "0"}, "None 0"),
        (API, {}, "None None"),
        (API, {"OMP_WAIT_POLICY": "ACTIVE"}, "ACTIVE None"),
    ],
)
def test_commands_let_threads_sleep_unless_the_user_says_how_they_wait(
    lines: str, variables: dict[str, str], expected: str
) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in WAITING_VARIABLES} | variables
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM + lines],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env=environment,
    )
    assert process.stdout.splitlines() == [expected]
