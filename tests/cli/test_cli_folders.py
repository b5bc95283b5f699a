"""What each command does with each kind of folder: it takes it, or one line says what it is and what takes it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.learning.task import Task
from metapp.runs.stored_fits import read_fits
from metapp.storage.folders import FolderKind, mark_folder
from metapp.storage.shards import write_data_set
from tests.cli.messages import says
from tests.extensions.capture.ball_photos import detailed_light, write_linear_png
from tests.extensions.capture.ball_photos import photograph_ball as photograph_of_ball
from tests.kept_fits import fit_of, spec_with, write_fit
from tests.pictures import write_noise_photo

NETWORKS = 1
# what metapp writes: a folder of each kind; tests/storage/test_folders.py has what a refusal says of each
RUNS = ("runs/texture/meta", "runs/texture/meta/bark")
FOLDERS = ("set", "set/found", "set/found/0060.png", *RUNS)
# commands that take a folder, {} its place, and the kinds that they take
COMMANDS = {
    "meta texture {} --quiet": (),
    "general svbrdf_nonstationary {} --quiet": (),
    "quickft brdf {} --quiet": (),
    "meta illumination {} --quiet": (),
    "baseline texture {} --method nearest --quiet": (),
    "meta texture --data {} --quiet": (),
    "evaluate texture --data {} --no-run": (),
    "data images {} --out out --quiet": (),
    "data merl {} --out out --quiet": (),
    "data nbrdf {} --out out --quiet": (),
    "data flash {} --out out --quiet": (),
    "data maps {} --out out --quiet": (),
    "data strips {} --out out --quiet": (),
    "data laval {} --out out --quiet": (),
    "data gonio {} --out out --quiet": (),
    "data bsdf {} --out out --quiet": (),
    "data rectify {} --out out --quiet": (),
    "data ball {} --out out --quiet": (),
    "data lights {} --out out/coin.lp --quiet": (),
    "data check {}": ("set",),
    "data join {} other --out out --quiet": ("set",),
    "export {} merl --quiet": RUNS,
    "view {} --no-open --quiet": RUNS,
    "compare {} {} --quiet": RUNS,
}
# commands that take the data set itself, as their own application's
TAKEN = ("meta texture", "baseline texture", "meta texture --data", "evaluate texture --data")
FILES = ("meta", "general", "quickft", "baseline", "data images", "data ball", "data lights", "data rectify")


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """Write a folder of each kind, of textures."""
    for name in ("set", "other"):
        tasks = [(Task(f"{name}-bark", {"image": torch.randint(256, (3, 64, 64), dtype=torch.uint8)}), "test", "")]
        write_data_set(tmp_path / name, "texture", {"image": "sRGB"}, tasks, {"files": ["found"]})
    mark_folder(tmp_path / "set/found", FolderKind.RESULTS)
    write_noise_photo(tmp_path / "set/found/0060.png")
    spec = spec_with(app="texture", paradigm="meta", rule="meta-basis")
    kept = write_fit(tmp_path / "runs/texture/meta", fit_of("bark", spec=spec), {"w": torch.zeros(2)})
    for place in (kept.folder / "texture.png", tmp_path / "runs/texture/meta/pictures.png"):
        write_noise_photo(place)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_folders_are_taken_or_refused_by_a_line(metapp: Callable, folders: Path, command: str) -> None:
    for place in FOLDERS:
        if place in COMMANDS[command] or (place == "set" and command.startswith(TAKEN)):
            continue
        if place.endswith(".png") and ("--data" in command or not command.startswith(FILES)):
            continue  # they take folders alone
        result = metapp(*command.format(place, place).split())
        assert f"{place}: " in result.error, result
        assert "metapp " in result.error or "expected" in result.error, result
    assert not (folders / "out").exists()


@pytest.mark.parametrize(
    "command", ["meta texture runs", "data images runs --out out", "data rectify runs --out out", "data check runs"]
)
def test_a_folder_of_runs_holds_no_input(metapp: Callable, folders: Path, command: str) -> None:
    assert "runs: no" in metapp(*command.split()).error


def test_commands_do_not_refuse_the_folders_they_take(metapp: Callable, folders: Path) -> None:
    assert metapp("data", "check", "set").code == 0
    assert metapp("data", "join", "set", "other", "--out", "out").code == 0
    for place in RUNS:
        for words in (["export", place, "png16"], ["view", place, "--no-open"]):
            result = metapp(*words)
            assert not says(result.err, "expected", "folder"), result


def test_a_data_set_as_input_is_fitted_as_by_its_option(
    metapp: Callable, ten_materials: Path, small_spheres: None
) -> None:
    """The table of kinds, for fits: files and records are those of --data."""
    shutil.copytree(ten_materials, "set")
    given, options = ["--recipe", "quick", "--quiet", "--json"], ["--out", "by-option"]
    by_option = metapp("meta", "brdf", "--data", "set", *given, *options).json_result
    by_input = metapp("meta", "brdf", "set", *given).json_result
    assert [task["error"] for task in by_input["tasks"]] == [task["error"] for task in by_option["tasks"]]
    assert Path(by_input["out"]).name == Path(by_option["out"]).name == f"meta-{by_input['data']}-quick"
    (one, other) = (read_fits(Path(result["out"])) for result in (by_input, by_option))
    assert [fit.inputs for fit in one] == [fit.inputs for fit in other]
    # and where it has moved, a page, an export and a comparison find it as --data or as an input
    Path("moved").mkdir()
    Path("set").rename("moved/set")
    for words in (["--data", "moved/set"], ["--input", "moved/set"]):
        result = metapp("view", by_input["out"], "--no-open", "--overwrite", "--most", "1", *words)
        assert result.code == 0
        assert "not at hand" not in result.err
    compared = metapp("compare", by_input["out"], by_option["out"], "moved/set", "--overwrite")
    assert compared.code == 0
    assert "no picture" not in compared.err


@pytest.mark.parametrize(
    ("words", "facts"),
    [
        (["set", "--layer", "beauty"], ["--layer", "data set set"]),
        (["set", "bark.png", "--layer", "beauty"], ["--layer", "data set set"]),
    ],
)
def test_options_about_files_are_not_about_a_data_set(
    metapp: Callable, folders: Path, words: list[str], facts: list[str]
) -> None:
    shutil.copytree("set", "set2")
    write_noise_photo(Path("bark.png"))
    assert says(metapp("meta", "texture", *words).misuse, *facts)


def test_runs_among_photos_are_no_inputs(metapp: Callable, folders: Path) -> None:
    """`metapp data images .` in the folder where runs, data sets and photographs lie."""
    write_noise_photo(Path("bark.png"))
    result = metapp("data", "images", ".", "--out", "out", "--size", "32", "--json").json_result
    assert result["train"] + result["test"] == ["bark"]


@pytest.mark.long
def test_light_of_a_ball_is_filled_in_from_its_data_set(metapp: Callable, tmp_path: Path, second_scene: Path) -> None:
    """`metapp data ball PHOTO --out garden; metapp meta illumination garden` fits the ball, and nothing else."""
    from metapp.extensions.capture.ball.ball_geometry import Ball

    photo = write_linear_png(tmp_path / "a.png", photograph_of_ball(Ball(80, 75, 60), 150, 160, 0.02, detailed_light))
    ball = ["--ball", "80,75,60", "--rows", "64"]
    assert metapp("data", "ball", photo, *ball, "--out", "garden", "--quiet").code == 0
    assert Path("garden/found/a.png").is_file()
    result = metapp("meta", "illumination", "garden", "--recipe", "quick", "--json", "--quiet").json_result
    assert [task["name"] for task in result["tasks"]] == ["garden"]
    assert result["failures"] == []
    assert "garden/found: " in metapp("meta", "illumination", "garden/found", "--quiet").error
