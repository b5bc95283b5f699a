"""Kinds of folders: what each is, whatever lies beside, and which of their files a walk takes."""

import json
from pathlib import Path

import pytest

from data_tools.readers.listing import files_below
from metapp.runs.inputs.refusals import check_files_of_user, path_refusal
from metapp.storage.folders import (
    CAMERA_TEXT,
    DIAGNOSTIC_FOLDER,
    LIGHT_TEXT,
    MANIFEST,
    PARAMS,
    RECORD,
    PathKind,
    path_kind,
)

SET = json.dumps({"app": "texture", "schema": 1, "tasks": [], "units": {}, "notes": {}})
FIT = json.dumps({"name": "gold", "error": None, "settings": {}})


FOLDERS: dict[str, tuple[PathKind, dict[str, str]]] = {
    "a manifest": (PathKind.DATA_SET, {MANIFEST: SET, "bark.png": ""}),
    "a damaged manifest beside tasks": (PathKind.DATA_SET, {MANIFEST: "{", "gold.safetensors": ""}),
    "another program's manifest": (PathKind.FILES, {MANIFEST: '{"name": "an app"}', "bark.png": ""}),
    "a text called manifest": (PathKind.FILES, {MANIFEST: "", "bark.png": ""}),
    "a manifest that is a list": (PathKind.FILES, {MANIFEST: "[]"}),
    "a record": (PathKind.FIT, {RECORD: FIT, "fit.png": ""}),
    "a damaged record beside parameters": (PathKind.FIT, {RECORD: "{", PARAMS: ""}),
    "another program's record": (PathKind.FILES, {RECORD: '{"track": 7}', "bark.png": ""}),
    "fits": (PathKind.RUN_FOLDER, {f"gold/{RECORD}": FIT, f"tin/{RECORD}": FIT, "pictures.png": ""}),
    "runs of an application": (PathKind.FOLDER_OF_RUNS, {f"meta/gold/{RECORD}": FIT}),
    "runs": (PathKind.FOLDER_OF_RUNS, {f"brdf/meta/gold/{RECORD}": FIT}),
    "runs of evaluate": (PathKind.FOLDER_OF_RUNS, {f"evaluate/brdf/meta/gold/{RECORD}": FIT}),
    "photos beside all runs": (PathKind.FILES, {f"runs/brdf/meta/gold/{RECORD}": FIT, "bark.png": ""}),
    "an unfinished fit": (PathKind.FILES, {f".partial-1-gold/{RECORD}": FIT}),
    "cameras": (PathKind.RECTIFIED, {CAMERA_TEXT: "0,0,1", "00.png": ""}),
    "flashes": (PathKind.RECTIFIED, {LIGHT_TEXT: "0,0,1", "00.png": ""}),
    "a name that ends alike": (PathKind.FILES, {f"my_{CAMERA_TEXT}": "0,0,1"}),
    "photos": (PathKind.FILES, {"bark.png": ""}),
    "nothing": (PathKind.FILES, {}),
}


def write_files(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir()
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize("name", FOLDERS)
def test_each_folder_has_one_kind(tmp_path: Path, name: str) -> None:
    kind, files = FOLDERS[name]
    assert path_kind(write_files(tmp_path / "folder", files)) is kind


@pytest.mark.parametrize("relative", [False, True])
def test_result_pictures_are_recognised_by_their_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, relative: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    base = Path() if relative else tmp_path
    for above, is_ours in ({MANIFEST: SET}, True), ({CAMERA_TEXT: "0,0,1"}, True), ({"a.txt": ""}, False):
        place = f"{len(list(tmp_path.iterdir()))}"
        write_files(tmp_path / place, above | {f"{DIAGNOSTIC_FOLDER}/00.png": ""})
        kinds = [path_kind(base / place / DIAGNOSTIC_FOLDER), path_kind(base / place / DIAGNOSTIC_FOLDER / "00.png")]
        assert kinds == ([PathKind.DIAGNOSTIC] * 2 if is_ours else [PathKind.FILES, PathKind.FILE])
    write_files(tmp_path / "run", {f"gold/{RECORD}": FIT, "pictures.png": "", "gold/fit.png": ""})
    assert path_kind(base / "run/pictures.png") is PathKind.DIAGNOSTIC
    assert path_kind(base / "run/gold/fit.png") is PathKind.FILE  # which may be an input, where it is named
    assert path_kind(base / "none") is PathKind.NOTHING
    write_files(tmp_path / "photos", {"leaf.failed.png": "", "failed.png": ""})
    assert path_kind(base / "photos/leaf.failed.png") is PathKind.DIAGNOSTIC
    assert path_kind(base / "photos/failed.png") is PathKind.FILE


def test_a_walk_takes_files_of_users_alone(tmp_path: Path) -> None:
    taken = ["bark.png", "found/sand.png", "leaf/00.png", "notes/record.json", "sub/deep/stone.png"]
    files = dict.fromkeys(taken, "") | {"notes/record.json": '{"track": 7}', "leaf/camera_pos.txt": "0,0,1"}
    left = {
        "garden/manifest.json": SET, "garden/garden.exr": "", "garden/found/0060.png": "",
        "leaf/found/00.png": "", "runs/texture/meta/pictures.png": "", "runs/texture/meta/comparison.png": "",
        f"runs/texture/meta/bark/{RECORD}": FIT, "leaf.failed.png": "", "runs/texture/meta/bark/fit.png": "",
        "runs/texture/meta/bark/asset/bark_color.png": "",
    }  # fmt: skip
    folder = write_files(tmp_path / "all", files | left)
    found = [file.relative_to(folder).as_posix() for file in files_below(folder, (".png", ".json", ".exr"))]
    assert sorted(found) == taken
    for place in ("garden", "leaf/found", "runs/texture/meta", "runs/texture/meta/bark"):
        assert files_below(folder / place) == []
    asset = folder / "runs/texture/meta/bark/asset"  # an export, where it is named
    assert files_below(asset) == [asset / "bark_color.png"]


@pytest.mark.parametrize(
    ("name", "words", "command"),
    [
        ("a manifest", "a data set, expected maps", "metapp meta texture {}"),
        ("a record", "the folder of a fit, expected maps", "metapp view {}"),
        ("fits", "the folder of a run, expected maps", "metapp view {}"),
        ("cameras", "a folder of rectified photos, expected maps", "metapp meta svbrdf_nonstationary {}"),
        ("runs", "a folder of runs, expected maps", "metapp view {}"),
    ],
)
def test_a_refusal_says_what_it_is_and_which_command_takes_it(
    tmp_path: Path, name: str, words: str, command: str
) -> None:
    folder = write_files(tmp_path / "folder", FOLDERS[name][1])
    line = path_refusal(folder, "maps")
    assert line.startswith(f"{folder}: {words}; ")
    assert command.format(folder) in line


def test_a_refusal_of_a_fit_names_the_only_command_that_takes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("metapp.runs.inputs.refusals.COMMANDS_OF_FITS", ("export",))  # as without extensions
    folder = write_files(tmp_path / "folder", {RECORD: FIT})
    assert path_refusal(folder, "maps").endswith(f"; metapp export takes it: metapp export {folder}.")


def test_a_damaged_file_beside_files_of_users_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_bytes(b"\xff" * 9)
    (tmp_path / RECORD).write_bytes(b"[" * 100_000)
    (tmp_path / "bark.png").touch()
    check_files_of_user(tmp_path, "maps")
    assert files_below(tmp_path, ".png") == [tmp_path / "bark.png"]
