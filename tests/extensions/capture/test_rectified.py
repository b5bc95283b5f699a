"""Photographs of the marker sheet: rectified to the opening, with the places of camera and flash."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_tools.readers import placed_photos
from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.placed_photos import read_places
from data_tools.readers.square_photos import field_of_view_rad
from metapp.extensions.capture.rectified.rectified_photos import (
    CameraSearch,
    find_cameras,
    rectify_opening,
    write_rectified_photos,
)
from metapp.extensions.capture.rectified.sighting import Camera as Found
from metapp.extensions.capture.rectified.sighting import common_focal_length_mm, find_sheet, solve_camera
from tests.extensions.capture.marker_photos import (
    Camera,
    cv2,
    patch_picture,
    photograph,
    tilted_camera,
    write_photograph,
)  # isort: skip
from tests.pictures import STORED_BY_ORIENTATION, noise_image, write_image

LOOK = {"vignette": 0.3, "noise": 0.01}
CAMERAS = {
    "above": tilted_camera(0, distance=26),
    "aside": tilted_camera(20, 30, roll=10),
    "turned": tilted_camera(30, 120, distance=34, roll=-80),
    "steep": tilted_camera(40, 200, roll=90),
    "far": tilted_camera(40, 300, distance=45, focal_mm=52),
    "off centre": Camera((6.0, -4.0, 30.0), aim=(3.0, 2.0), roll=170),
    "upright": tilted_camera(25, 60, distance=34, height=1600, width=1200),
}


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of CAMERAS as JPEG, with noise, a vignette and the focal length in their EXIF."""
    folder = tmp_path_factory.mktemp("photos")
    for name, camera in CAMERAS.items():
        write_photograph(folder / f"{name}.jpg", camera, **LOOK)
    return folder


def off_by(place_cm: Any, camera: Camera) -> float:
    """How far a place is from the camera's, as a share of its distance."""
    return float(np.linalg.norm(place_cm - np.array(camera.position)) / np.linalg.norm(camera.position))


def expected(size: int, vignette: float, camera: Camera) -> np.ndarray:
    """The patch as a picture of so many px, darker towards the photograph's corners."""
    picture = cv2.resize(patch_picture(), (size, size), interpolation=cv2.INTER_AREA)
    y, x = ((np.mgrid[:size, :size] + 0.5) / size - 0.5) * 10
    seen = np.einsum("ij,jhw->ihw", camera.projection_matrix(), np.stack([x, -y, np.ones_like(x)]))
    off = np.hypot(seen[0] / seen[2] - camera.width / 2, seen[1] / seen[2] - camera.height / 2)
    return picture * (1 - vignette * (off / math.hypot(camera.width, camera.height) * 2) ** 2)[..., None]


@pytest.mark.parametrize("name", CAMERAS)
def test_the_patch_and_the_camera_are_found(photos: Path, name: str) -> None:
    camera, path = CAMERAS[name], photos / f"{name}.jpg"
    sighting = find_sheet(path)
    assert (sighting.opening_cm, len(sighting.markers), sighting.focal_mm) == (10, 12, camera.focal_mm)
    camera_found = solve_camera(sighting, sighting.focal_mm)
    assert off_by(camera_found.place_cm, camera) < 0.003  # asked for: 0.02
    assert camera_found.error_px < 0.4
    size = int(10 * sighting.px_per_cm()[0])
    picture = rectify_opening(read_pixels(path), sighting, size)
    rmse = np.sqrt(np.mean((picture - expected(size, LOOK["vignette"], camera)) ** 2))
    assert rmse < 0.02  # the patch's own deviation is 0.17


@pytest.mark.parametrize("name", ["aside", "far", "upright"])
def test_without_a_focal_length_one_tilted_photograph_tells_it(photos: Path, name: str) -> None:
    camera = CAMERAS[name]
    sighting = find_sheet(photos / f"{name}.jpg")._replace(focal_mm=0.0)
    focal = common_focal_length_mm([sighting])
    assert focal == pytest.approx(camera.focal_mm, rel=0.02)
    assert off_by(solve_camera(sighting, focal).place_cm, camera) < 0.02  # asked for: 0.05


def test_photographs_from_above_do_not_tell_the_focal_length(photos: Path) -> None:
    sighting, aside = (find_sheet(photos / f"{name}.jpg")._replace(focal_mm=0.0) for name in ("above", "aside"))
    with pytest.raises(ValueError, match="too little tilt to find it; give the camera's field of view: --fov"):
        common_focal_length_mm([sighting])
    together = common_focal_length_mm([sighting, aside])
    assert together == pytest.approx(26, rel=0.01)


@pytest.mark.long
def test_distances_follow_from_a_given_field_of_view(tmp_path: Path) -> None:
    cameras = [tilted_camera(0, distance=26), tilted_camera(5, 40)]
    paths = [write_photograph(tmp_path / f"{i}.png", camera, focal=False) for i, camera in enumerate(cameras)]
    found, _, _ = find_cameras(CameraSearch(paths, field_of_view_rad(26, 1200, 1600)))
    for photo, camera in zip(found, cameras, strict=True):
        assert off_by(photo.place_cm, camera) < 0.002
    with pytest.raises(ValueError, match="--fov"):
        find_cameras(CameraSearch(paths))


def test_photographs_are_read_upright(tmp_path: Path) -> None:
    camera = tilted_camera(25, 60, distance=34, height=800, width=600)
    upright = (photograph(camera) * 255 + 0.5).astype(np.uint8)
    path = write_image(tmp_path / "a.png", STORED_BY_ORIENTATION[6](upright), Orientation=6)
    sighting = find_sheet(path)
    assert (sighting.height, sighting.width) == (800, 600)
    assert off_by(solve_camera(sighting, 26).place_cm, camera) < 0.005
    picture = rectify_opening(read_pixels(path), sighting, 128)
    assert np.sqrt(np.mean((picture - expected(128, 0, camera)) ** 2)) < 0.03


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_rectifying_keeps_colours(photos: Path, dtype: type) -> None:
    """Every level of a uniform picture comes back, and of a fine pattern the mean of linear light."""
    sighting = find_sheet(photos / "steep.jpg")
    highest = np.iinfo(dtype).max
    for level in np.linspace(0, highest, 18).astype(dtype):
        values = np.full((sighting.height, sighting.width, 3), level, dtype)
        back = rectify_opening(Pixels(values, "srgb_rec709_scene", False), sighting, 100) * highest
        assert abs(back - level).max() < 0.4
    checks = (np.indices((sighting.height, sighting.width)).sum(0) % 2 * highest).astype(dtype)
    pixels = Pixels(np.repeat(checks[..., None], 3, -1), "srgb_rec709_scene", False)
    back = rectify_opening(pixels, sighting, 64)
    np.testing.assert_allclose(back.mean(), 0.735, atol=0.01)  # half the light
    assert back.std() < 0.02


def written(folder: Path, paths: list[Path], size: int, **settings: Any) -> list[Found]:
    cameras, _, _ = find_cameras(CameraSearch(paths, **settings))
    write_rectified_photos(cameras, [camera.place_cm for camera in cameras], size, folder)
    return cameras


def test_the_folder_is_read_as_photographs_with_places(photos: Path, tmp_path: Path) -> None:
    names = ["steep", "aside", "above", "turned"]
    placed = written(tmp_path / "leaf", [photos / f"{name}.jpg" for name in names], 400)
    order = ["above", "aside", "turned", "steep"]  # that from straight above first
    assert [photo.sighting.path.stem for photo in placed] == order
    assert placed[0].sighting.opening_cm == 10
    task = placed_photos.read_task(tmp_path / "leaf")
    assert task.data["photo"].shape == (3, 256, 256)
    assert task.data["others"].shape == (3, 3, 256, 256)
    for number, name in enumerate(order):
        for column in range(2):  # camera and light, in half sides
            assert off_by(task.data["places"][number, column].numpy() * 5, CAMERAS[name]) < 0.005
    pictures = [task.data["photo"], *task.data["others"]]
    for picture, name in zip(pictures, order, strict=True):
        expected_values = expected(256, LOOK["vignette"], CAMERAS[name])
        assert np.sqrt(np.mean((picture.permute(1, 2, 0).numpy() / 255 - expected_values) ** 2)) < 0.035


def test_the_flash_is_beside_the_lens_in_the_photograph(photos: Path) -> None:
    paths = [photos / "aside.jpg", photos / "turned.jpg"]
    found, _, _ = find_cameras(CameraSearch(paths))
    for photo in found:
        light_cm = photo.offset_place_cm(1.5, -0.5)
        seen = photo.axes @ (light_cm - photo.place_cm)  # right, down, forward
        np.testing.assert_allclose(seen, [1.5, 0.5, 0], atol=1e-9)
        # what is to the right in the photograph is where its homography says
        camera = CAMERAS[photo.sighting.path.stem]
        before, after = (
            camera.projection_matrix() @ np.array([*(foot(photo, light_cm, shift)), 1]) for shift in (0.0, 1.0)
        )
        assert after[0] / after[2] > before[0] / before[2]


def foot(photo: Found, light_cm: np.ndarray, share: float) -> np.ndarray:
    """A point of the sheet so much of the flash's offset from the opening's centre."""
    return share * (light_cm - photo.place_cm)[:2]


def test_a_page_that_was_printed_smaller_is_all_smaller(photos: Path, tmp_path: Path) -> None:
    paths = [photos / "aside.jpg", photos / "turned.jpg"]
    placed = written(tmp_path / "leaf", paths, 400, ruler_cm=9.7)
    assert placed[0].sighting.opening_cm == pytest.approx(9.7)
    for photo in placed:
        assert off_by(photo.place_cm / 0.97, CAMERAS[photo.sighting.path.stem]) < 0.003
    before, _, _ = find_cameras(CameraSearch(paths))
    places = read_places(tmp_path / "leaf", 2)
    assert places is not None
    np.testing.assert_allclose(places[:, 0] * 5, np.stack([photo.place_cm for photo in before]), atol=1e-3)


def hidden(path: Path, camera: Camera, *boxes: tuple[float, float, float, float]) -> Path:
    """A photograph where some of the sheet, left, right, lower, upper in cm, is under something gray."""
    values = (photograph(camera) * 255).astype(np.uint8)
    for left, right, lower, upper in boxes:
        corners = (
            np.array([[left, lower, 1], [right, lower, 1], [right, upper, 1], [left, upper, 1]])
            @ camera.projection_matrix().T
        )
        cv2.fillPoly(values, [(corners[:, :2] / corners[:, 2:]).round().astype(np.int32)], (110, 100, 90))
    return write_image(path, values)


def test_some_hidden_markers_do_no_harm(tmp_path: Path) -> None:
    camera = tilted_camera(25, 60, distance=30)
    sighting = find_sheet(hidden(tmp_path / "a.png", camera, (-9, 9, 5.2, 9), (5.2, 9, 2, 3)))
    assert len(sighting.markers) == 7
    assert off_by(solve_camera(sighting, 26).place_cm, camera) < 0.005


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "nothing": (
        lambda path: write_image(path, noise_image(600, 800)),
        "no marker found, expected the markers of a sheet; photog",
    ),
    "few": (
        lambda path: hidden(path, tilted_camera(20), (-9, 9, -5.2, 9)),
        "markers, on one side of the opening alone or too few, expected 4 to 12 all round",
    ),
    "bent": (
        lambda path: write_photograph(path, tilted_camera(20), bend=0.35),
        "of a flat sheet in focus; lay it flat",
    ),
    "cut off": (
        lambda path: write_photograph(path, Camera((5.0, 0, 18.0), aim=(9.5, 0.0))),
        "the opening is not wholly in the pic",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_photographs_that_cannot_be_rectified_are_refused_in_one_line(tmp_path: Path, case: str) -> None:
    make, line = REFUSED[case]
    with pytest.raises(ValueError, match=re.escape(line)) as caught:
        find_sheet(make(tmp_path / "a.png"))
    assert str(caught.value).startswith(f"{tmp_path / 'a.png'}: ")
    assert "\n" not in str(caught.value)


def test_a_cropped_photograph_or_another_lens_is_refused(photos: Path, tmp_path: Path) -> None:
    values = read_pixels(photos / "steep.jpg").values[:, 250:]
    cropped = write_image(tmp_path / "cropped.png", np.ascontiguousarray(values), Exif_FocalLengthIn35mmFilm=26)
    find_sheet(cropped)
    paths = [photos / "above.jpg", photos / "aside.jpg", cropped]
    cameras, _, (line,) = find_cameras(CameraSearch(paths))
    assert len(cameras) == 2
    assert line.startswith(f"{cropped}: points are ")
    assert "from where a lens of 26 mm sees them" in line
    with pytest.raises(ValueError, match=r"1 of 2 photos can be used \(.* mm sees them\), expected two or more"):
        find_cameras(CameraSearch([photos / "above.jpg", cropped]))
