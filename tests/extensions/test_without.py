"""Without an extension the core works, and commands of the extension are refused."""

import json
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from metapp.registry import ENTRY_POINT_GROUP, WITHOUT_VARIABLE, registry
from tests import forks
from tests.recipe_apps import app_names

NETWORKS = 1
pytestmark = pytest.mark.usefixtures("compiled_in_cache")


def call_all(*lines: list[str]) -> None:
    """Be the `metapp` command for each line of words, and print its exit code before them."""
    from metapp.cli.command_process import run_command
    from metapp.cli.command_tree import app

    for words in lines:
        code = run_command(lambda words=words: app(words, standalone_mode=False, prog_name="metapp"))
        print(f"\n== {json.dumps([int(code), *words])}", flush=True)


def test_without_extensions_the_core_works_and_their_commands_are_refused(
    networks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A data set, fits, tables and help; contracts of import-linter hold that no extension needs another."""
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
    names = [
        entry_point.name
        for entry_point in entry_points(group=ENTRY_POINT_GROUP)
        if entry_point.value.startswith("metapp.extensions.")
    ]
    commands = list(registry().commands)
    monkeypatch.setenv(WITHOUT_VARIABLE, ",".join(names))
    theirs = [words.split() for words in commands if words not in registry().commands]
    assert theirs
    environment = {"COLUMNS": "150", WITHOUT_VARIABLE: ",".join(names)}
    code, out, errors = forks.start_in_fork(
        call_all, *core, *theirs, output_folder=tmp_path / "said", extra_environment=environment
    ).wait_for_output()
    assert code == 0, errors
    assert "Traceback" not in errors
    codes = [json.loads(line[3:]) for line in out.splitlines() if line.startswith("== ")]
    assert [words for _, *words in codes] == [*core, *theirs]
    assert [words for code, *words in codes if code] == theirs, errors
