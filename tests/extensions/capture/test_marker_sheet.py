"""The marker sheet: markers that nobody mistakes for others, a page to scale, the same bytes each time."""

import itertools
import re
import zlib
from pathlib import Path

import numpy as np
import pytest

from metapp.extensions.capture.rectified.sheet import (
    OPENINGS_CM,
    marker_corners_cm,
    marker_dictionary,
    opening_of_markers,
)
from metapp.extensions.capture.rectified.sheet_page import PAGES_CM, draw_marker_sheet, write_marker_sheet
from tests.extensions.capture.marker_photos import PX_PER_CM, cv2, printed_page  # skips where there is no OpenCV

POINT = 72 / 2.54  # a centimetre in the unit of PDF


@pytest.mark.parametrize("opening", OPENINGS_CM)
def test_markers_lie_round_the_opening_apart_from_each_other(opening: int) -> None:
    markers = marker_corners_cm(opening)
    assert len(markers) == 12
    for corners in markers.values():
        assert (abs(corners).max(-1) > opening / 2 + 0.4).all()  # of white paper, more than a cell
        sides = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=-1)
        np.testing.assert_allclose(sides, sides[0])
    for first, other in itertools.combinations(markers.values(), 2):
        apart = np.maximum(first.min(0) - other.max(0), other.min(0) - first.max(0)).max()
        assert apart > 0.4


def test_a_marker_tells_its_sheet() -> None:
    numbers = [number for opening in OPENINGS_CM for number in marker_corners_cm(opening)]
    assert sorted(numbers) == list(range(len(OPENINGS_CM) * 12))
    assert len(numbers) <= len(marker_dictionary().bytesList)
    for opening in OPENINGS_CM:
        assert all(opening_of_markers([number]) == opening for number in marker_corners_cm(opening))
    assert opening_of_markers([*list(marker_corners_cm(8))[:3], 0, 249]) == 8
    assert opening_of_markers([249]) is None
    assert opening_of_markers([]) is None


@pytest.mark.parametrize(("opening", "paper"), [(4, "a4"), (10, "a4"), (13, "a4"), (13, "letter")])
def test_what_is_drawn_is_where_the_layout_says(opening: int, paper: str) -> None:
    values, centre = printed_page(opening, paper)
    gray = (values * 255).astype(np.uint8)
    found, numbers, _ = cv2.aruco.ArucoDetector(marker_dictionary()).detectMarkers(gray)
    markers = marker_corners_cm(opening)
    assert sorted(np.ravel(numbers)) == sorted(markers)
    for number, corners in zip(np.ravel(numbers), found, strict=True):
        expected = (markers[number] + centre) * PX_PER_CM
        expected[:, 1] = len(gray) - expected[:, 1]
        assert abs(corners[0] + 0.5 - expected).max() < 2  # px, of 80 a cm: what finding without refinement may be off
    assert min(corner.min() for corner in found) > 0.5 * PX_PER_CM  # what printers leave blank
    assert max(corner[..., 0].max() for corner in found) < gray.shape[1] - 0.5 * PX_PER_CM


@pytest.mark.parametrize("paper", PAGES_CM)
def test_the_pdf_is_to_scale_and_the_same_each_time(tmp_path: Path, paper: str) -> None:
    for name in "ab":
        write_marker_sheet(tmp_path / f"{name}.pdf", 7, paper)
    pdf = (tmp_path / "a.pdf").read_bytes()
    assert pdf == (tmp_path / "b.pdf").read_bytes()
    (box,) = re.findall(rb"/MediaBox \[ ([\d. ]+) \]", pdf)
    np.testing.assert_allclose(list(map(float, box.split())), [0, 0, *np.array(PAGES_CM[paper]) * POINT], atol=0.01)
    drawn = max((zlib.decompress(stream) for stream in streams(pdf)), key=len)
    lines = np.array(re.findall(rb"^([\d.]+) ([\d.]+) m\n([\d.]+) ([\d.]+) l\n+S$", drawn, re.MULTILINE), float)
    assert np.isclose(lines[:, 2] - lines[:, 0], 10 * POINT, atol=0.01).sum() == 1  # the ruler
    placed = rb"1 0 0 1 ([\d.]+) ([\d.]+) cm ([\d.]+) 0 0 -([\d.]+) 0 [\d.]+ cm /I\d+ Do"
    x, y, width, height = np.array(re.findall(placed, b" ".join(drawn.split())), float).T
    (axes,) = draw_marker_sheet(7, paper).axes
    centre = -np.array([axes.get_xlim()[0], axes.get_ylim()[0]])
    outlines = np.stack([x, y, x + width, y + height], -1)
    expected = [[*(c.min(0) + centre) * POINT, *(c.max(0) + centre) * POINT] for c in marker_corners_cm(7).values()]
    np.testing.assert_allclose(outlines, expected, atol=0.02)


def streams(pdf: bytes) -> list[bytes]:
    """The compressed pages of a PDF, not its fonts."""
    parts = re.findall(rb"<<([^>]*)>>\nstream\n(.*?)\nendstream", pdf, re.DOTALL)
    return [stream for head, stream in parts if b"FlateDecode" in head and b"Length1" not in head]
