"""Without an extension all else works, and its commands are refused with its name."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp import door
from metapp.apps import app_names
from tests import forks

NAMES = sorted(
    point.name
    for point in importlib.metadata.entry_points(group=door.GROUP)
    if point.value.startswith("metapp.extensions.")
)
NETWORKS = 1
pytestmark = pytest.mark.usefixtures("compiled")


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


def call_all(*lines: list[str]) -> None:
    """Be the `metapp` command for each line of words, and print its exit code before them."""
    from metapp.cli.commands import app
    from metapp.cli.console import run

    for words in lines:
        code = run(lambda words=words: app(words, standalone_mode=False, prog_name="metapp"))
        print(f"\n== {json.dumps([int(code), *words])}", flush=True)


@pytest.fixture
def check_without(networks: Path, tmp_path: Path) -> Callable[[list[str]], None]:
    """Runs a data set, fits, tables and help without these extensions, in a process of its own."""
    fit = ["brdf", str(networks / "m0"), "--recipe", "quick", "--json", "--quiet"]
    core = [
        ["data", "nbrdf", str(networks), "--split", "test", "--out", "set", "--quiet"],
        *(["meta", name, "--help"] for name in app_names()),
        ["data", "--help"],
        ["general", *fit],
        ["meta", *fit],
        ["evaluate", "brdf", "--data", "set", "--no-run", "--quiet"],
        ["data", "check", "set"],
    ]

    def check(names: list[str]) -> None:
        commands = offered(names)
        environment = {"COLUMNS": "150", door.WITHOUT: ",".join(names)}
        code, out, errors = forks.start(call_all, *core, *commands, said=tmp_path / "said", more=environment).end()
        assert code == 0, errors
        assert "Traceback" not in errors
        codes = [json.loads(line[3:]) for line in out.splitlines() if line.startswith("== ")]
        assert [words for _, *words in codes] == [*core, *commands]
        assert [words for code, *words in codes if code] == commands, errors
        for name in names:
            if offered([name]):
                assert f"a command of the extension {name}" in errors.replace("\n", " ")

    return check


def test_without_all_extensions_the_core_works(check_without: Callable) -> None:
    check_without(NAMES)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_without_one_extension_all_else_works(name: str, check_without: Callable) -> None:
    check_without([name])
