"""The kinds of folders that metapp writes, and which files a walk takes."""

import json
from pathlib import Path

import pytest

from data_tools.readers.listing import files_below
from metapp.runs.inputs.refusals import check_files_of_user, path_refusal
from metapp.storage.folders import FOUND_FOLDER, MANIFEST, MARKER, RECORD, FolderKind, find_record_files, path_kind

SET = json.dumps({"app": "texture", "schema": 1, "tasks": [], "units": {}, "notes": {}})
FIT = json.dumps({"name": "gold", "error": None, "settings": {}})
RUN, RESULTS = FolderKind.RUN.value, FolderKind.RESULTS.value

FOLDERS: dict[str, tuple[FolderKind | None, dict[str, str]]] = {
    "a manifest": (FolderKind.DATA_SET, {MANIFEST: SET, "bark.png": ""}),
    "another program's manifest": (None, {MANIFEST: '{"name": "an app"}', "bark.png": ""}),
    "a manifest that is a list": (None, {MANIFEST: "[]", "bark.png": ""}),
    "a damaged manifest": (None, {MANIFEST: "[" * 100_000, "bark.png": ""}),
    "a record": (FolderKind.FIT, {RECORD: FIT, "fit.png": ""}),
    "another program's record": (None, {RECORD: '{"name": "gold", "track": 7}', "bark.png": ""}),
    "a run": (FolderKind.RUN, {MARKER: RUN, f"gold/{RECORD}": FIT, "pictures.png": ""}),
    "results": (FolderKind.RESULTS, {MARKER: f"{RESULTS}\n", "00.png": ""}),
    "another program's marker": (None, {MARKER: "x", "bark.png": ""}),
    "runs": (None, {f"brdf/meta/{MARKER}": RUN, f"brdf/meta/gold/{RECORD}": FIT}),
    "photos": (None, {f"{FOUND_FOLDER}/bark.png": ""}),
    "nothing": (None, {}),
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
    folder = write_files(tmp_path / "folder", files)
    assert path_kind(folder) is kind
    if not kind:
        check_files_of_user(folder, "maps")


def test_pictures_of_results_are_recognised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_files(tmp_path / "runs", {MARKER: RUN, "pictures.png": "", f"gold/{RECORD}": FIT, "gold/fit.png": ""})
    write_files(tmp_path / "found", {MARKER: RESULTS, "00.png": ""})
    write_files(tmp_path / "photos", {"leaf.failed.png": "", "failed.png": ""})
    monkeypatch.chdir(tmp_path / "found")
    for name in ("../runs/pictures.png", "00.png", "../photos/leaf.failed.png"):
        assert path_kind(name) is FolderKind.RESULTS
    for name in ("../runs/gold/fit.png", "../photos/failed.png", "../none"):  # a fit's picture may be named as an input
        assert path_kind(name) is None


def test_a_walk_takes_files_of_users_alone(tmp_path: Path) -> None:
    taken = ["bark.png", "found/sand.png", "leaf/00.png", "notes/record.json", "sub/deep/stone.png"]
    files = dict.fromkeys(taken, "") | {"notes/record.json": '{"track": 7}', "leaf/camera_pos.txt": "0,0,1"}
    left = {
        "garden/manifest.json": SET, "garden/garden.exr": "", "garden/found/0060.png": "",
        f"leaf/found/{MARKER}": RESULTS, "leaf/found/00.png": "", "leaf.failed.png": "",
        f"runs/texture/meta/{MARKER}": RUN, "runs/texture/meta/pictures.png": "",
        f"runs/texture/meta/bark/{RECORD}": FIT, "runs/texture/meta/bark/fit.png": "",
        "runs/texture/meta/bark/asset/bark_color.png": "",
    }  # fmt: skip
    folder = write_files(tmp_path / "all", files | left)
    found = [file.relative_to(folder).as_posix() for file in files_below(folder, (".png", ".json", ".exr"))]
    assert sorted(found) == taken
    for place in ("garden", "leaf/found", "runs/texture/meta", "runs/texture/meta/bark"):
        assert files_below(folder / place) == []
    asset = folder / "runs/texture/meta/bark/asset"  # an export, where it is named
    assert files_below(asset) == [asset / "bark_color.png"]


def test_records_below_a_folder_are_found(tmp_path: Path) -> None:
    taken = [f"{run}/gold/{RECORD}" for run in ("meta", "brdf/meta", "evaluate/brdf/meta")]
    folder = write_files(tmp_path / "runs", dict.fromkeys([*taken, f"meta/.partial-1-tin/{RECORD}"], FIT))
    (folder / "linked").symlink_to(folder / "meta")
    assert {file.relative_to(folder).as_posix() for file in find_record_files(folder)} == set(taken)


@pytest.mark.parametrize(
    ("kind", "words", "command"),
    [
        (FolderKind.DATA_SET, "a data set, expected maps", "metapp meta texture {}"),
        (FolderKind.FIT, "the folder of a fit, expected maps", "metapp view {}"),
        (FolderKind.RUN, "the folder of a run, expected maps", "metapp view {}"),
        (FolderKind.RESULTS, "made by metapp to show its results, expected maps", "give the photos"),
    ],
)
def test_a_refusal_says_what_it_is_and_which_command_takes_it(
    tmp_path: Path, kind: FolderKind, words: str, command: str
) -> None:
    folder = write_files(tmp_path / "folder", {MANIFEST: SET})
    line = path_refusal(folder, kind, "maps")
    assert line.startswith(f"{folder}: {words}; ")
    assert command.format(folder) in line


def test_a_refusal_of_a_fit_names_the_only_command_that_takes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("metapp.runs.inputs.refusals.COMMANDS_OF_FITS", ("export",))  # as without extensions
    line = path_refusal(tmp_path, FolderKind.FIT, "maps")
    assert line.endswith(f"; metapp export takes it: metapp export {tmp_path}.")
