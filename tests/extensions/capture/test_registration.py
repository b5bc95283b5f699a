"""Photographs of a material without the marker sheet: places of cameras, and what is refused."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.extensions.capture.marker_photos import FOCAL_MM, Camera, cv2, tilted_camera  # isort: skip

from data_tools.readers.placed_photos import read_task
from data_tools.readers.square_photos import field_of_view_rad
from metapp.extensions.capture.rectified.features import apply_homography
from metapp.extensions.capture.rectified.plane import cameras_on_plane, cameras_on_square
from metapp.extensions.capture.rectified.rectified_photos import CameraSearch, find_cameras, show_views
from metapp.extensions.capture.rectified.registration import IDENTITY_MATCH, register_photos, select_neighbours
from metapp.extensions.capture.rectified.sighting import Sighting, common_focal_length_mm, solve_camera
from tests.pictures import write_image

VIEW = {"focal_mm": 26, "height": 320, "width": 360}
CAMERAS = {
    "a": Camera((0.5, -0.4, 26.0), (0.4, 0.2), 3.0, **VIEW),
    "b": tilted_camera(24, 40, 24, roll=20, **VIEW),
    "c": tilted_camera(20, 160, 30, roll=-100, **VIEW),
}
REMEDY = "print a frame of markers: metapp data markers sheet.pdf"


def material(seed: int) -> np.ndarray:
    """sRGB [1200, 1200, 3] in [0, 1] of details of all sizes, 60 cm a side."""
    rng, values = np.random.default_rng(seed), np.full((1200, 1200), 0.45, np.float32)
    for count in (30, 90, 270, 540):
        part = rng.normal(0, 0.06, (count, count)).astype(np.float32)
        values += cv2.resize(part, (1200, 1200), interpolation=cv2.INTER_CUBIC)
    return np.repeat(values[..., None], 3, -1).clip(0, 1)


def take(path: Path, camera: Camera, values: np.ndarray) -> Path:
    """A photograph, brightest in its middle, with noise."""
    to_cm = np.array([[0.05, 0, -30 + 0.025], [0, -0.05, 30 - 0.025], [0, 0, 1]])
    seen = cv2.warpPerspective(
        values, camera.projection_matrix() @ to_cm, (camera.width, camera.height), flags=cv2.INTER_AREA
    )
    y, x = np.mgrid[-1 : 1 : camera.height * 1j, -1 : 1 : camera.width * 1j]
    seen = seen * (1 - 0.2 * (x**2 + y**2))[..., None] + np.random.default_rng(1).normal(0, 0.01, seen.shape)
    return write_image(
        path, (seen.clip(0, 1) * 255).round().astype(np.uint8), Exif_FocalLengthIn35mmFilm=camera.focal_mm
    )


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of CAMERAS of one material, not to write to."""
    folder = tmp_path_factory.mktemp("photos")
    for name, camera in CAMERAS.items():
        take(folder / f"{name}.png", camera, material(1))
    return folder


@pytest.fixture(scope="module")
def sightings(photos: Path) -> list[Sighting]:
    """What all of them share with the first."""
    steps: list[str] = []
    registration = register_photos([photos / f"{name}.png" for name in CAMERAS], report_stage=steps.append)
    assert registration.unmatched_lines() == []
    assert [step for step in steps if "finding features" in step] == [
        f"{name}.png: finding features" for name in CAMERAS
    ]
    assert sum("comparing with" in step for step in steps) >= len(CAMERAS) - 1
    return registration.sightings()


@pytest.mark.parametrize("focal", [True, False])
def test_places_and_the_square_are_found(sightings: list[Sighting], focal: bool) -> None:
    focal_mm = 26.0
    if not focal:
        sightings = [sighting._replace(focal_mm=0.0) for sighting in sightings]
        focal_mm = common_focal_length_mm(sightings, cameras_on_plane)
        assert focal_mm == pytest.approx(26, rel=0.02)
    cameras = cameras_on_square(cameras_on_plane(sightings, focal_mm))
    assert [camera.sighting.path.stem for camera in cameras] == list(CAMERAS)
    corners = []
    for camera in cameras:
        to_cm = np.linalg.inv(CAMERAS[camera.sighting.path.stem].projection_matrix())
        corners.append(cv2.perspectiveTransform(camera.sighting.corners_px()[None], to_cm)[0])
    side = np.linalg.norm(corners[0] - np.roll(corners[0], 1, 0), axis=1).mean()
    assert side > 7
    np.testing.assert_allclose(corners, np.broadcast_to(corners[0], np.shape(corners)), atol=side / 256)
    right = (corners[0][1] - corners[0][0] + corners[0][2] - corners[0][3]) / 2
    axes = np.array([[*right, 0], [-right[1], right[0], 0], [0, 0, side]]) / side
    for camera in cameras:
        place = np.array(CAMERAS[camera.sighting.path.stem].position) - [*corners[0].mean(0), 0]
        found = camera.place_cm * side
        assert np.linalg.norm(axes @ place - found) < (0.01 if focal else 0.03) * np.linalg.norm(place)


def tilt_of(camera: Camera) -> float:
    """The angle in degrees between a camera's axis and the material's normal."""
    forward = np.array([*camera.aim, 0.0]) - camera.position
    return float(np.degrees(np.arccos(-forward[2] / np.linalg.norm(forward))))


@pytest.mark.parametrize("order", ["abc", "bca"])
@pytest.mark.parametrize("source", ["exif", "fov", "matches"])
def test_the_straightest_photograph_is_the_reference(photos: Path, tmp_path: Path, order: str, source: str) -> None:
    paths = [photos / f"{name}.png" for name in order]
    if source != "exif":  # without a focal length
        paths = [write_image(tmp_path / path.name, cv2.imread(str(path))[..., ::-1]) for path in paths]
    fov_rad = field_of_view_rad(26, VIEW["height"], VIEW["width"]) if source == "fov" else 0.0
    cameras, focal_mm, skipped = find_cameras(CameraSearch(paths, fov_rad))
    assert skipped == []
    assert focal_mm == (pytest.approx(26, rel=0.02) if source == "matches" else 0.0)
    assert [camera.sighting.path.stem for camera in cameras if camera.sighting.is_reference] == ["a"]
    assert cameras[0].sighting.is_reference
    for camera in cameras:
        assert camera.tilt_degrees == pytest.approx(tilt_of(CAMERAS[camera.sighting.path.stem]), abs=0.5)


def test_of_squares_as_large_the_one_below_the_camera_is_taken() -> None:
    for across in (-4.0, 0.0, 4.0):  # cm, of the first camera
        # the photograph from straight above is the nearer one, which alone limits the square's height
        places = (across + 6.0, 0.0, 40.0), (across, 0.0, 20.0)
        views = [Camera(place, (across, 0.0), height=240, width=600) for place in places]
        points = np.stack(np.meshgrid(np.arange(-8.0, 8.1), np.arange(-4.0, 4.1)), -1).reshape(-1, 2)
        sightings = [
            Sighting(
                Path(),
                240,
                600,
                26.0,
                1.0,
                points,
                points,
                apply_homography(view.projection_matrix(), points),
                view.projection_matrix(),
                False,
            )
            for view in views
        ]
        oblique, straight = cameras_on_square([solve_camera(sighting, 26.0) for sighting in sightings])
        assert straight.view_angle_degrees < 0.1
        np.testing.assert_allclose(oblique.place_cm * 20 / straight.place_cm[2], [6, 0, 40], atol=0.01)


def test_a_photograph_that_fits_no_plane_with_the_others_leaves_these_as_they_are(photos: Path) -> None:
    whole = cv2.imread(str(take(Path("whole.png"), CAMERAS["b"], material(1))))
    odd = write_image(
        Path("odd.png"), cv2.resize(whole, None, fx=1.4, fy=1.0)[..., ::-1], Exif_FocalLengthIn35mmFilm=26
    )
    paths = [photos / f"{name}.png" for name in CAMERAS]
    (expected, *_), (cameras, _, skipped) = find_cameras(CameraSearch(paths)), find_cameras(CameraSearch([*paths, odd]))
    assert [line.partition(":")[0] for line in skipped] == ["odd.png"]
    assert "px from where a lens of" in skipped[0]
    np.testing.assert_allclose([camera.place_cm for camera in cameras], [camera.place_cm for camera in expected])


def test_photographs_without_markers_become_a_folder_that_a_fit_reads(metapp: Callable, photos: Path) -> None:
    other = take(Path("other.png"), CAMERAS["b"], material(2))
    paths = [photos / "b.png", other, photos / "a.png"]  # the straightest last
    result = metapp("data", "rectify", *paths, "--out", "leaf", "--json")
    assert "no markers: 2 photos registered by their own features" in result.err
    assert re.search(
        rf"warning: skipped: {other}: at most \d+ % of another photo found in it, expected 25 % or more; {REMEDY}.",
        result.err,
    )
    assert result.json_result["unit"] == "sides"
    reference = r"00.png: a.png, \d+ points, the reference, .* tilted by 1"
    assert re.search(rf"{reference}\n01.png: b.png, \d+ points, error 0.* tilted by 24\n", result.err)
    assert [found["reference"] for found in result.json_document["photos"]] == [True, False]
    assert Path("leaf/found/01.png").exists()
    places = read_task(Path("leaf")).data["places"]
    assert places.shape == (2, 2, 3)
    assert (places[:, 0] == places[:, 1]).all()


def test_a_flash_beside_the_lens_needs_the_sheet(metapp: Callable, photos: Path) -> None:
    paths = [photos / "a.png", photos / "b.png"]
    refusal = metapp("data", "rectify", *paths, "--out", "leaf", "--flash", "1,0").refusal
    assert "--flash: cm, but no photo shows the marker sheet" in refusal
    assert not Path("leaf").exists()


def blank(path: Path, seed: int) -> Path:
    values = 128 + np.random.default_rng(seed).normal(0, 3, (300, 400, 3))
    return write_image(path, values.round().astype(np.uint8), Exif_FocalLengthIn35mmFilm=26)


def test_photographs_without_common_parts_are_refused_in_one_line(tmp_path: Path) -> None:
    for name, make in (
        ("wall", lambda path, seed: blank(path, seed)),
        ("unrelated", lambda path, seed: take(path, CAMERAS["a"], material(seed))),
    ):
        paths = [make(tmp_path / f"{name}{seed}.png", seed) for seed in (3, 4)]
        found = r"at most \d+ % of another photo found in it, expected 25 % or more"
        with pytest.raises(ValueError, match=rf"^{paths[0]}: none of 2 photos fits another one: {found}; {REMEDY}\.$"):
            find_cameras(CameraSearch(paths))


def test_matches_in_vain_are_drawn(metapp: Callable) -> None:
    photos = [take(Path(f"{seed}.png"), CAMERAS["a"], material(seed)) for seed in (3, 4)]
    refusal = metapp("data", "rectify", *photos, "--out", "leaf").refusal
    assert "none of 2 photos fits another one" in refusal
    assert refusal.endswith("; see leaf.failed.png.")
    picture = cv2.imread("leaf.failed.png")[..., ::-1].astype(int)
    for colour in ([255, 165, 0], [255, 0, 0]):  # features, those alike
        assert (abs(picture - colour).max(-1) < 9).sum() > 100


def test_photographs_that_share_no_part_are_drawn_with_their_views() -> None:
    """The reference shows where the others look: to its left and to its right."""
    shown: dict[str, np.ndarray] = {}
    views = [Camera((x, 0.0, 20.0), (x, 0.0), height=240, width=320) for x in (0.0, -14.0, 14.0)]
    cameras = []
    for view in views:
        points = np.stack(np.meshgrid(np.arange(-8.0, 8.1), np.arange(-4.0, 4.1)), -1).reshape(-1, 2)
        px = apply_homography(view.projection_matrix(), points)
        cameras.append(
            solve_camera(
                Sighting(Path(), 240, 320, 26.0, 1.0, px, points, px, view.projection_matrix(), False), FOCAL_MM
            )
        )
    with pytest.raises(ValueError, match="no part is in all 3 photos"):
        cameras_on_square(cameras)
    show_views(cameras, lambda _path, _words, outlines, colour: shown.update({colour: outlines}))
    left, right = shown["cyan"]
    assert left[:, 0].max() < right[:, 0].min()
    np.testing.assert_allclose(left[:, 0].mean() - 159.5, 159.5 - right[:, 0].mean(), atol=0.1)


def test_a_photograph_is_compared_with_the_reference_and_its_neighbours_alone() -> None:
    """Else time would grow with the square of the number of photographs."""
    matches = dict.fromkeys((2, 9, 3, 30, 8, 11, 4), IDENTITY_MATCH)
    assert select_neighbours(matches, 10) == [2, 9, 11, 8]
    assert select_neighbours({2: IDENTITY_MATCH}, 0) == [2]


def test_a_first_photo_that_fits_none_is_said(tmp_path: Path, photos: Path) -> None:
    odd = take(tmp_path / "odd.png", CAMERAS["b"], material(2))
    registration = register_photos([odd, photos / "a.png", photos / "b.png"])
    assert registration.reference == 1
    (line,) = registration.unmatched_lines()
    assert re.match(rf"{odd}: at most \d+ % of another photo found in it, expected 25 % or more; ", line)
