"""Without an extension all else works, and its commands are refused with its name."""

from __future__ import annotations

import importlib.metadata
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from data_tools.readers.nbrdf import SHAPES
from metapp import door

NAMES = sorted(
    point.name
    for point in importlib.metadata.entry_points(group=door.GROUP)
    if point.value.startswith("metapp.extensions.")
)
LINES = """
import json, sys
from metapp import door
from metapp.apps import app_names
from metapp.cli.commands import app
from metapp.cli.console import run
def call(*words):
    code = run(lambda: app(list(words), standalone_mode=False, prog_name="metapp"))
    print(f"\\n== {json.dumps([int(code), *words])}", flush=True)
for name in app_names():
    call("meta", name, "--help")
call("data", "--help")
call("general", "brdf", sys.argv[1], "--recipe", "quick", "--json", "--quiet")
call("meta", "brdf", sys.argv[1], "--recipe", "quick", "--json", "--quiet")
call("evaluate", "brdf", "--data", sys.argv[2], "--no-run", "--quiet")
call("data", "check", sys.argv[2])
for words in json.loads(sys.argv[3]):
    call(*words)
"""


def offered(names: list[str]) -> list[list[str]]:
    """The commands of extensions, as words of a command line."""
    commands = [
        offer
        for extension in door.extensions()
        if extension.name in names
        for offer in extension.offers
        if isinstance(offer, door.Command)
    ]
    return [[*filter(None, [offer.under]), offer.name] for offer in commands]


def check_without(names: list[str], folder: Path) -> None:
    rng = np.random.default_rng(0)
    network = folder / "gold"
    network.mkdir()
    for part, shape in SHAPES.items():
        np.save(network / f"{part}.npy", rng.normal(0, 0.1, shape).astype(np.float32))
    metapp = [sys.executable, "-m", "metapp"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "150", door.WITHOUT: ",".join(names)}
    made = [*metapp, "data", "nbrdf", str(network), "--split", "test", "--out", str(folder / "set"), "--quiet"]
    subprocess.run(made, check=True, env=environment, cwd=folder)
    commands = offered(names)
    done = subprocess.run(
        [sys.executable, "-c", LINES, network, folder / "set", json.dumps(commands)],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env=environment,
    )
    assert "Traceback" not in done.stderr
    codes = [json.loads(line[3:]) for line in done.stdout.splitlines() if line.startswith("== ")]
    failed = [words for code, *words in codes if code]
    assert failed == commands, done.stderr
    for name in names if commands else ():
        if offered([name]):
            assert f"a command of the extension {name}" in done.stderr.replace("\n", " ")


def test_without_all_extensions_the_core_works(tmp_path: Path) -> None:
    check_without(NAMES, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_without_one_extension_all_else_works(name: str, tmp_path: Path) -> None:
    check_without([name], tmp_path)
