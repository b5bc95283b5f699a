"""Focal lengths by what EXIF states: as of 35 mm film, by the sensor's size, or not at all."""

import math
import warnings
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from data_tools.readers.flash_photos import read_task
from data_tools.readers.image_files import pixels_of_pil, read_pixels
from data_tools.readers.lenses import FILM_DIAGONAL_MM, ExifLens, lens_of_exif
from data_tools.readers.square_photos import field_of_view_rad
from tests.pictures import noise_image

FILM, FOCAL, ACROSS, DOWN, UNIT, WIDTH, HEIGHT = 0xA405, 0x920A, 0xA20E, 0xA20F, 0xA210, 0xA002, 0xA003
# A camera of APS-C with a lens of 18 mm, in px an inch
CAMERA = {
    FOCAL: IFDRational(18), ACROSS: IFDRational(5184000, 905), DOWN: IFDRational(3456000, 595), UNIT: 2, WIDTH: 5184,
    HEIGHT: 3456,
}  # fmt: skip
EXPECTED_MM = 18 * FILM_DIAGONAL_MM / math.hypot(0.905 * 25.4, 0.595 * 25.4)


def photo(path: Path, tags: dict[int, Any]) -> Path:
    exif = Image.Exif()
    block = exif.get_ifd(0x8769)
    block.update(tags)
    exif[0x8769] = block
    Image.fromarray(noise_image(300, 450)).save(path, exif=exif)
    return path


def side_and_lines(path: Path, **options: float) -> tuple[int, list[str]]:
    """The px of the photo that its task shows, and what is said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        note = read_task(path, **options).note
    return int(note.partition("central ")[2].partition(" ")[0]), [str(warning.message) for warning in caught]


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_the_sensor_tells_the_field_of_view(tmp_path: Path, suffix: str) -> None:
    path = photo(tmp_path / f"a.{suffix}", CAMERA)
    assert read_pixels(path).lens.focal_mm == pytest.approx(EXPECTED_MM, rel=1e-5)
    with Image.open(path) as image:
        assert pixels_of_pil(image, "a").lens.focal_mm == pytest.approx(EXPECTED_MM, rel=1e-5)
    side, (line,) = side_and_lines(path)
    share = math.tan(math.radians(22.5)) / math.tan(field_of_view_rad(EXPECTED_MM, 300, 450) / 2)
    assert side == round(300 * share)
    sensor = "18 mm on a sensor of 23.0 x 15.1 mm: 28 mm as of 35 mm film"
    assert line == f"{path}: {sensor}; --fov sets another field of view."


def test_focal_lengths_without_sensor_size_cause_a_line(tmp_path: Path) -> None:
    path = photo(tmp_path / "a.jpg", {FOCAL: IFDRational(18)})
    line = f"{path}: 18 mm on a sensor of unknown size, taken for 45 degrees along the shorter side; "
    assert side_and_lines(path) == (300, [f"{line}--fov sets another field of view."])


@pytest.mark.parametrize("tags", [{}, {FILM: 28}, CAMERA | {FILM: 28}])
def test_photos_with_complete_or_no_lens_data_cause_no_line(tmp_path: Path, tags: dict[int, Any]) -> None:
    side, lines = side_and_lines(photo(tmp_path / "a.jpg", tags))
    assert lines == []
    assert (side < 300) == bool(tags)


def test_no_line_is_printed_where_the_user_states_the_field_of_view(tmp_path: Path) -> None:
    assert side_and_lines(photo(tmp_path / "a.jpg", CAMERA), fov_rad=math.radians(45)) == (300, [])


@pytest.mark.parametrize(
    ("resolution", "unit", "size"),
    [((450 / 3.6, 300 / 2.4), 3, (450, 300)), ((12.5, 12.5), 4, (450, 300)), ((12.5, 0.0), 4, (450, 300)),
     ((12.5 * 25.4, 12.5 * 25.4), 0, (300, 450))],
)  # fmt: skip
def test_all_units_of_the_sensor_size_are_read(
    resolution: tuple[float, float], unit: int, size: tuple[int, int]
) -> None:
    assert lens_of_exif(0, 50, resolution, unit, size).focal_mm == pytest.approx(50)


@pytest.mark.parametrize(
    ("resolution", "unit", "size"),
    [((0.0, 0.0), 2, (450, 300)), ((72.0, 72.0), 2, (450, 300)), ((1e9, 1e9), 2, (450, 300)),
     ((math.nan, math.nan), 2, (450, 300)), ((math.inf, math.inf), 2, (450, 300)), ((12.5, 12.5), 1, (450, 300)),
     ((12.5, 12.5), 4, (0, 0))],
)  # fmt: skip
def test_impossible_sensor_sizes_are_ignored(resolution: tuple[float, float], unit: int, size: tuple[int, int]) -> None:
    assert lens_of_exif(0, 50, resolution, unit, size) == ExifLens(0.0, "50 mm on a sensor of unknown size")
    assert lens_of_exif(0, math.nan, resolution, unit, size) == ExifLens()


@pytest.mark.parametrize("in_film_mm", [0, 1, 4, 65_535])
def test_impossible_focal_lengths_on_film_count_as_missing(tmp_path: Path, in_film_mm: int) -> None:
    """Of 1 mm, a fit would see one part in thirty of the photo."""
    assert side_and_lines(photo(tmp_path / "a.jpg", {FILM: in_film_mm})) == (300, [])
    assert read_pixels(photo(tmp_path / "b.jpg", CAMERA | {FILM: in_film_mm})).lens.focal_mm == pytest.approx(
        EXPECTED_MM, rel=1e-5
    )
