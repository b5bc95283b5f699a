"""Photographs of a sample on a table: the square that is kept lies on the sample, and all of it where it fills them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from metapp.extensions.capture.rectified import rectification, sample
from metapp.extensions.capture.rectified.rectified_photos import CameraSearch, find_cameras
from metapp.extensions.capture.rectified.registration import MIDDLE_CORNERS
from metapp.extensions.capture.rectified.sample import find_largest_square, find_sample, select_middle_region
from tests.extensions.capture.marker_photos import cv2
from tests.extensions.capture.test_registration import CAMERAS, material
from tests.pictures import write_image

# In cm, of the sample: its table lies so low that it agrees on a plane of its own; or it is told by its matches alone.
HALF_SIDE, THICKNESS, LOW_THICKNESSES = 9.0, 4.0, (1.1, 0.8)
CENTRE = np.array([0.5, -0.4])  # cm, of the sample
TO_CM = np.array([[0.05, 0, -30 + 0.025], [0, -0.05, 30 - 0.025], [0, 0, 1]])


def photograph(folder: Path, thickness: float, half_side: float = HALF_SIDE, finger: bool = False) -> list[Path]:
    """Photographs of CAMERAS of a sample on a table, which lies lower by its thickness in cm."""
    paths, corners = [], CENTRE + half_side * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for seed, (name, camera) in enumerate(CAMERAS.items()):
        size = camera.width, camera.height
        seen, table = (
            cv2.warpPerspective(material(number), camera.projection_matrix(height) @ TO_CM, size, flags=cv2.INTER_AREA)
            for number, height in ((1, 0.0), (2, -thickness))
        )
        on_sample = np.zeros(seen.shape[:2], np.uint8)
        outline = cv2.perspectiveTransform(corners[None], camera.projection_matrix())[0]
        cv2.fillConvexPoly(on_sample, np.round(outline).astype(np.int32), 1)
        seen = np.where(on_sample[..., None] > 0, seen, 0.7 * table)
        if finger and name == "b":
            cv2.ellipse(seen, (camera.width // 2, camera.height), (30, 90), 0, 0, 360, (0.7, 0.5, 0.4), -1)
        seen = seen + np.random.default_rng(seed).normal(0, 0.01, seen.shape)
        path = folder / f"{name}.png"
        paths.append(
            write_image(
                path, (seen.clip(0, 1) * 255).round().astype(np.uint8), Exif_FocalLengthIn35mmFilm=camera.focal_mm
            )
        )
    return paths


@pytest.fixture(scope="module", params=[THICKNESS, *LOW_THICKNESSES])
def found(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> tuple:
    """What is found in photographs of a sample above a table."""
    return find_sample(CameraSearch(photograph(tmp_path_factory.mktemp("photos"), request.param)))


def test_the_square_lies_on_a_sample_above_a_table(found: tuple) -> None:
    cameras, _, skipped, kept = found
    assert (len(cameras), skipped) == (len(CAMERAS), [])
    assert 0.1 < kept < 0.9
    corners = []
    for camera in cameras:
        to_cm = np.linalg.inv(CAMERAS[camera.sighting.path.stem].projection_matrix())
        corners.append(cv2.perspectiveTransform(camera.sighting.corners_px()[None], to_cm)[0])
    assert np.abs(corners - CENTRE).max() < HALF_SIDE
    side = np.linalg.norm(corners[0][1] - corners[0][0])
    assert side > HALF_SIDE
    np.testing.assert_allclose(corners, np.broadcast_to(corners[0], np.shape(corners)), atol=side / 128)


def test_a_line_says_how_much_is_kept(metapp: Callable, monkeypatch: pytest.MonkeyPatch, found: tuple) -> None:
    paths = [camera.sighting.path for camera in found[0]]
    for name, kept, line in (
        (
            "leaf0",
            0.614,
            "\nleaf0: cut to 61 % of the photographs' common square, the part in which they agree with one plane\n",
        ),
        ("leaf1", 1.0, ""),
        (
            "leaf2",
            0.0,
            "\nwarning: leaf2: the square shows surfaces at several heights, and no plane in the middle, expected",
        ),
    ):
        monkeypatch.setattr(rectification, "find_sample", lambda *_, share=kept: (*found[:3], share))
        result = metapp("data", "rectify", *paths, "--out", name, "--json")
        assert result.json_result["kept"] == kept
        assert line in result.err
        assert ("cut to" in result.err) == (0 < kept < 1)
        assert ("warning" in result.err) == (kept == 0)


@pytest.mark.parametrize("look", [{"half_side": 40.0}, {"half_side": 40.0, "finger": True}, {"thickness": 0.0}])
def test_photographs_that_show_one_plane_are_registered_once(tmp_path: Path, look: dict) -> None:
    registered: list[tuple] = []

    def once(search: CameraSearch) -> tuple:
        registered.append(find_cameras(search))
        return registered[-1]

    paths = photograph(tmp_path, **{"thickness": THICKNESS} | look)
    result = find_sample(CameraSearch(paths), register=once)
    assert result == (*registered[0], 1.0)
    assert len(result[0]) == len(CAMERAS)


def test_photographs_stay_as_they_are_where_no_sample_is_found(monkeypatch: pytest.MonkeyPatch, found: tuple) -> None:
    def register(search: CameraSearch, parts: dict | None = None) -> tuple:
        if parts:
            raise ValueError("too few features")
        return found[:3]

    monkeypatch.setattr(sample, "cut_lower_matches", lambda *_: None)
    everywhere = np.ones((192, 192), bool)
    monkeypatch.setattr(sample, "compare_on_planes", lambda _: sample.Agreement(~everywhere, everywhere, 3))
    search = CameraSearch([camera.sighting.path for camera in found[0]])
    assert find_sample(search, register=register) == (*found[:3], 0.0)
    assert find_sample(search, register=lambda *_, **__: found[:3]) == (*found[:3], 0.0)  # registered, but of no plane


def test_the_largest_square_is_turned_as_the_part_is() -> None:
    part = np.zeros((200, 200), np.uint8)
    corners = cv2.boxPoints(((110, 80), (100, 120), -20.0))
    cv2.fillConvexPoly(part, corners.round().astype(np.int32), 1)
    x, y, side, turn_rad = find_largest_square(part > 0)
    assert side == pytest.approx(0.5, abs=0.03)
    assert np.degrees(turn_rad) == pytest.approx(20)
    assert np.hypot(x - 0.05, y - 0.1) < 0.1
    assert find_largest_square(np.zeros((9, 9), bool))[2] == 0


def test_the_region_around_the_middle_has_no_holes() -> None:
    part = np.zeros((100, 100), bool)
    part[20:80, 20:80] = True
    part[45:55, 45:55] = False  # a coin on the sample
    part[90:] = True
    region = select_middle_region(part)
    assert region[50, 50]
    assert not region[90:].any()
    assert region.sum() == (60 - 2 * 9) ** 2
    assert not select_middle_region(np.zeros((100, 100), bool)).any()


@pytest.mark.parametrize(("half_side", "shows_table"), [(HALF_SIDE, True), (30.0, False)])
def test_a_table_little_lower_is_seen_on_its_plane(tmp_path: Path, half_side: float, shows_table: bool) -> None:
    cameras, *_ = find_cameras(CameraSearch(photograph(tmp_path, 1.5, half_side)))
    assert sample.compare_on_planes(cameras).shows_table == shows_table


def test_a_line_says_in_how_much_of_the_square_photographs_agree(
    metapp: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Where the cameras of a table and a sample on it are one plane's, photographs do not agree on the table."""
    for name, half_side in (("both", 6.0), ("one", 40.0)):
        (tmp_path / name).mkdir()
        paths = photograph(tmp_path / name, 2.0, half_side)
        found = find_cameras(CameraSearch(paths), dict.fromkeys(paths, MIDDLE_CORNERS))
        monkeypatch.setattr(rectification, "find_sample", lambda *_, found=found: (*found, 1.0))
        result = metapp("data", "rectify", *paths, "--out", tmp_path / f"{name}-out", "--json")
        agreement = result.json_result["agreement"]
        assert (agreement < 0.8) == (name == "both"), agreement
        assert (f"photos agree in {100 * agreement:.0f} % of the square" in result.err) == (name == "both")
