"""`metapp examples`: what it prints works as it is."""

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from metapp.apps.transport.recipes import RECIPES
from metapp.extensions.examples.examples_command import EXAMPLE_INPUTS_FOLDER, VGG_APPS, example_lines
from tests.needs_mitsuba import skip_without_mitsuba
from tests.recipe_apps import app_names


@pytest.fixture
def inputs(request: pytest.FixtureRequest, metapp: Callable, app: str) -> None:
    """The input files of an application, and what a user has after the first run."""
    if app == "illumination":
        request.getfixturevalue("second_scene")
    assert metapp("examples", app, "--make", EXAMPLE_INPUTS_FOLDER).code == 0


@pytest.fixture
def works(metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable:
    """Runs a command of a script and looks for the files that it makes, whose noise does not matter."""
    full = RECIPES["full"]
    monkeypatch.setitem(RECIPES, "full", replace(full, app=replace(full.app, shown_spp=4)))

    def run(line: str) -> None:
        if "transport" in line or "--render" in line:
            skip_without_mitsuba()
        program, *words = shlex.split(line)
        assert program == "metapp"
        before = set(tmp_path.rglob("*"))
        result = metapp(*words, "--quiet")
        assert result.code == 0, result.err
        assert any(path.is_file() for path in set(tmp_path.rglob("*")) - before)

    return run


def test_every_application_has_five_commands() -> None:
    assert {len({line for line, _ in example_lines(name, EXAMPLE_INPUTS_FOLDER)}) for name in app_names()} == {5}


def test_the_printed_script_makes_its_input_files_first(metapp: Callable, tmp_path: Path) -> None:
    for words, count in ((["texture"], 7), (["brdf"], 6), ([], 14)):
        lines = [line for line in metapp("examples", *words).out.splitlines() if not line.startswith("#")]
        assert len(lines) == count
    metapp(*shlex.split(metapp("examples", "texture").out.splitlines()[1])[1:])
    assert [file.name for file in EXAMPLE_INPUTS_FOLDER.iterdir()] == ["bricks.png"]
    result = metapp("examples", "illumination", "--make", tmp_path / "my files", "--json").json_document
    assert len(result["commands"]) == 5
    assert [Path(file).name for file in result["files"]] == ["lobby.exr", "ball.png"]
    assert shlex.split(result["commands"][0]["command"])[-1] == result["files"][0]


def test_an_application_that_is_nearly_right_is_suggested(metapp: Callable) -> None:
    assert "Did you mean 'brdf'?" in metapp("examples", "bdrf").misuse


@pytest.mark.long
@pytest.mark.usefixtures("inputs")
@pytest.mark.parametrize("app", app_names())
def test_the_first_command_of_an_application_works(works: Callable, app: str) -> None:
    works(example_lines(app, EXAMPLE_INPUTS_FOLDER)[0][0])


@pytest.mark.slow
@pytest.mark.usefixtures("inputs")
@pytest.mark.parametrize("app", app_names())
def test_other_commands_of_an_application_work(request: pytest.FixtureRequest, works: Callable, app: str) -> None:
    if app in VGG_APPS:
        request.getfixturevalue("vgg_weights")
    for line, _ in example_lines(app, EXAMPLE_INPUTS_FOLDER)[1:]:
        works(line)
