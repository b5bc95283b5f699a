"""`metapp data markers` and `metapp data rectify`: from a sheet and photographs to a folder that fits read."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from data_tools.readers.image_files import read_pixels
from data_tools.readers.listing import files_below
from data_tools.readers.placed_photos import read_places
from metapp.extensions.capture.rectified.rectification import (
    ONE_VIEW_SIDES,
    describe_doubtful_lenses,
    describe_single_view,
)
from metapp.extensions.capture.rectified.sighting import focal_length_mm
from metapp.storage.folders import FolderKind, path_kind
from tests.cli.messages import says
from tests.extensions.capture.marker_photos import tilted_camera, write_photograph
from tests.pictures import noise_image, write_image, write_text

CAMERAS = {"a": tilted_camera(20, 30), "b": tilted_camera(1, distance=26), "c": tilted_camera(35, 200, roll=90)}
LEAF, FAILED = Path("leaf"), Path("leaf.failed.png")


@pytest.fixture(scope="module")
def photo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of CAMERAS, not to write to."""
    folder = tmp_path_factory.mktemp("taken")
    for name, camera in CAMERAS.items():
        write_photograph(folder / f"{name}.jpg", camera)
    return folder


def paths(taken: Path, names: str = "abc") -> list[Path]:
    return [taken / f"{name}.jpg" for name in names]


def test_a_sheet_is_written(metapp: Callable) -> None:
    result = metapp("data", "markers", "sheet", "--opening", 8, "--page", "letter", "--json")
    assert result.json_result == {"path": "sheet.pdf", "opening_cm": 8, "page": "letter"}
    assert Path("sheet.pdf").read_bytes().startswith(b"%PDF")
    assert result.err == "sheet.pdf: a sheet with an opening of 8 x 8 cm; print it at 100 % and measure its ruler\n"


def test_photographs_become_a_folder_that_a_fit_reads(metapp: Callable, photo_folder: Path) -> None:
    result = metapp("data", "rectify", *paths(photo_folder), "--out", LEAF, "--flash", "1,0", "--json")
    document = result.json_result
    assert [Path(photo["source"]).name for photo in document["photos"]] == ["b.jpg", "a.jpg", "c.jpg"]
    assert [photo["file"] for photo in document["photos"]] == ["00.png", "01.png", "02.png"]
    assert document["skipped"] == []
    assert document["focal_mm"] is None
    assert document["size"] == pytest.approx(10 * 26 / 43.27 * 2000 / 26, rel=0.02)  # as fine as the first photo
    lines = result.err.splitlines()
    assert lines[0].startswith("00.png: b.jpg, 12 markers, error 0.")
    assert "camera 26.0 cm away, 1 degrees aside" in lines[0]
    assert lines[-1] == f"leaf: 3 photos of 10 cm, {document['size']} px a side; look at what was found: leaf/found"
    assert sorted(file.name for file in LEAF.iterdir()) == [
        "00.png", "01.png", "02.png", "camera_pos.txt", "found", "image_size.txt", "light_pos.txt",
    ]  # fmt: skip
    places = read_places(LEAF, 3)
    assert places is not None
    for number, name in enumerate("bac"):
        camera = np.array(CAMERAS[name].position)
        assert np.linalg.norm(places[:, 0][number].numpy() * 5 - camera) < 0.005 * np.linalg.norm(camera)
        assert np.linalg.norm((places[:, 1] - places[:, 0])[number] * 5) == pytest.approx(1, abs=1e-3)
    fitted = metapp("general", "svbrdf_nonstationary", LEAF, "--observe", "photo", "--json").json_result
    output_folder = Path(fitted["out"], "leaf")
    assert {"normal.png", "diffuse.png", "photo_3.png"} <= {file.name for file in output_folder.iterdir()}


def test_photographs_that_do_not_serve_are_skipped_with_a_line_each(metapp: Callable, photo_folder: Path) -> None:
    photos = Path("photos")
    shutil.copytree(photo_folder, photos)
    write_image(photos / "table.png", noise_image(300, 400))
    write_text(photos / "damaged.jpg")
    write_text(photos / "notes.txt")
    result = metapp("data", "rectify", photos, "--out", LEAF, "--json")
    assert len(result.json_result["photos"]) == 3
    skipped = [line for line in result.err.splitlines() if line.startswith("warning: skipped: ")]
    assert [line.split(": ")[2] for line in skipped] == [
        str(photos / name) for name in ("notes.txt", "damaged.jpg", "table.png")
    ]
    assert [f"warning: skipped: {line}" for line in result.json_document["skipped"]] == skipped
    assert "no marker found" in skipped[2]


@pytest.mark.parametrize("seed", range(20))
def test_one_view_is_told_from_several(seed: int) -> None:
    numbers = np.random.default_rng(seed)
    first, count = numbers.normal(size=3) + np.array([0, 0, 3]), int(numbers.integers(1, 6))
    steps = numbers.normal(size=(count, 3))
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    same = [first, *(first + 0.9 * ONE_VIEW_SIDES * numbers.random() * step for step in steps)]
    assert describe_single_view(same).startswith("all photos are taken from one place, within 0.")
    several = [*same, first + (ONE_VIEW_SIDES + 0.02 + numbers.random()) * steps[0]]
    assert not describe_single_view(several)


def test_one_photograph_under_three_names_is_said_to_show_one_view(
    metapp: Callable, photo_folder: Path, tmp_path: Path
) -> None:
    for name in "abc":
        shutil.copy(photo_folder / "b.jpg", tmp_path / f"{name}.jpg")
    result = metapp("data", "rectify", tmp_path, "--out", LEAF)
    assert "warning: leaf: all photos are taken from one place, within 0.00 sides" in result.err
    assert "one place" not in metapp("data", "rectify", *paths(photo_folder), "--out", "other").err


def test_photographs_without_a_focal_length_are_said_before_the_work(
    metapp: Callable, photo_folder: Path, tmp_path: Path
) -> None:
    plain, part = tmp_path / "plain.jpg", tmp_path / "part.jpg"
    with Image.open(photo_folder / "a.jpg") as image:
        exif = image.getexif()
        exif.get_ifd(0x8769).update({0xA002: 4000, 0xA003: 2000})
        image.crop((0, 0, image.width, image.width // 2 + 300)).save(part, exif=exif)
        image.save(plain)
    for path, facts in ((plain, ()), (part, ("4,000 x 2,000", "a part"))):
        lines = metapp("data", "rectify", path, "--out", "other").err.splitlines()  # one alone is refused in the end
        assert says(lines[0], path.name, "no focal length in EXIF", "--fov", "tilted", *facts)
        assert not says(metapp("data", "rectify", path, "--fov", "50", "--out", "other").err, "no focal length in EXIF")
    assert describe_doubtful_lenses(paths(photo_folder)) == ""
    assert focal_length_mm(read_pixels(part), 0.0) == 0


def test_fewer_than_two_are_refused(metapp: Callable, photo_folder: Path) -> None:
    write_image(Path("table.png"), noise_image(300, 400))
    for inputs, line in (
        (paths(photo_folder, "a"), "1 of 1 photo can be used, expected two or more of one material; take more"),
        ([*paths(photo_folder, "a"), Path("table.png")], "1 of 2 photos can be used (table.png: no marker found"),
        ([Path("none.jpg")], "none.jpg: no such file"),
    ):
        FAILED.unlink(missing_ok=True)
        refusal = metapp("data", "rectify", *inputs, "--out", LEAF).error
        assert line in refusal
        assert FAILED.exists() == refusal.endswith("; see leaf.failed.png.") == (inputs != [Path("none.jpg")])
    assert not LEAF.exists()


def test_a_failure_leaves_a_picture_that_no_command_takes(metapp: Callable, photo_folder: Path) -> None:
    photos = Path("photos")
    photos.mkdir()
    shutil.copy(photo_folder / "a.jpg", photos)
    failed = photos / "leaf.failed.png"
    assert metapp("data", "rectify", photos, "--out", photos / "leaf").refusal.endswith(f"see {failed}.")
    assert sorted(file.name for file in photos.iterdir()) == ["a.jpg", failed.name]
    picture = np.asarray(Image.open(failed)).astype(int)
    for colour in ([0, 255, 0], [255, 0, 255]):  # markers, the opening
        assert (abs(picture - colour).max(-1) < 9).sum() > 300
    assert path_kind(failed) is FolderKind.RESULTS
    assert files_below(photos) == [photos / "a.jpg"]
    assert "made by metapp to show its results" in metapp("meta", "texture", failed).error
    assert "made by metapp to show its results" in metapp("data", "rectify", failed, "--out", "other").refusal
    shutil.copy(photo_folder / "b.jpg", photos)
    named = [photos / name for name in ("a.jpg", "b.jpg", failed.name)]  # as a shell names them
    assert len(metapp("data", "rectify", *named, "--out", photos / "leaf", "--json").json_result["photos"]) == 2
    assert not failed.exists()  # that of a command that failed earlier


def test_skipped_photographs_are_shown_beside_what_was_found(metapp: Callable, photo_folder: Path) -> None:
    write_image(Path("table.png"), noise_image(300, 400))
    assert metapp("data", "rectify", *paths(photo_folder), Path("table.png"), "--out", LEAF).code == 0
    assert sorted(file.name for file in (LEAF / "found").glob("*.png")) == ["00.png", "01.png", "02.png", "skipped.png"]


def test_of_many_photographs_some_are_taken_evenly_with_a_line(metapp: Callable, photo_folder: Path) -> None:
    result = metapp("data", "rectify", *paths(photo_folder), "--out", LEAF, "--most", "2", "--json")
    assert [Path(photo["source"]).name for photo in result.json_document["photos"]] == ["a.jpg", "c.jpg"]
    assert result.err.startswith("3 photos: 2 of them, spread evenly, are taken; --most 3 takes all\n")
    assert "spread evenly" not in metapp("data", "rectify", *paths(photo_folder), "--out", "all").err


def test_a_folder_with_files_is_left_alone(metapp: Callable, photo_folder: Path) -> None:
    LEAF.mkdir()
    write_text(LEAF / "notes.txt")
    refusal = metapp("data", "rectify", *paths(photo_folder), "--out", LEAF).refusal
    assert "leaf: holds files, expected a new or empty folder to write to; choose another one." in refusal
    assert [file.name for file in LEAF.iterdir()] == ["notes.txt"]


def test_without_opencv_the_line_says_what_to_install(
    metapp: Callable, photo_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    line = 'OpenCV: not installed, expected here; install it: pip install "metapp[capture]".'
    assert line in metapp("data", "markers", "sheet.pdf").refusal
    assert line in metapp("data", "rectify", *paths(photo_folder), "--out", LEAF).refusal
    assert list(Path().iterdir()) == []


def test_options_out_of_range(metapp: Callable, photo_folder: Path) -> None:
    for words in ("--opening 3", "--opening 14", "--opening 7.5", "--page a3"):
        metapp("data", "markers", "sheet.pdf", *words.split()).misuse  # noqa: B018  (it looks by itself)
    for words, line in (
        ("--flash 1", "'1': expected two numbers in cm, up to 30, such as 1.2,0."),
        ("--flash nan,0", "'nan,0': expected two numbers"),
        ("--fov nan", "--fov"),
        ("--ruler 97", "--ruler 97.0: expected 5.0 to 20.0"),
    ):
        assert line in metapp("data", "rectify", *paths(photo_folder), "--out", LEAF, *words.split()).misuse
    assert list(Path().iterdir()) == []
