"""Photographs whose EXIF is of a larger photograph: parts, smaller and turned copies, digital zoom, previews."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from data_tools.readers import svbrdf_inputs
from data_tools.readers.image_files import lens_of, pixels_of_pil, read_pixels
from data_tools.readers.lenses import ExifLens
from data_tools.readers.square_photos import field_of_view_rad, flash_view, narrow_view_height
from metapp.appearance.flash import CAMERA_FOV_RAD
from tests.cli.messages import says
from tests.pictures import noise_image

WHOLE_PX, FOCAL_MM = (1600, 1200), 26.0
EXIF_BLOCK, INTEROPERABILITY_BLOCK = 0x8769, 0xA005


def exif_of(size: tuple[int, int] | None = WHOLE_PX, focal_mm: float = FOCAL_MM, zoom: float = 0.0) -> Image.Exif:
    exif = Image.Exif()
    block = exif.get_ifd(EXIF_BLOCK)
    block[0xA405] = round(focal_mm)
    if size:
        block[0xA002], block[0xA003] = size
    if zoom:
        block[0xA404] = IFDRational(zoom)
    exif[EXIF_BLOCK] = block  # Pillow finds it by its first directory
    return exif


def photo(path: Path, width: int, height: int, exif: Image.Exif) -> Path:
    Image.fromarray(noise_image(height, width)).save(path, exif=exif)
    return path


def view_and_lines(path: Path) -> tuple[float, list[str]]:
    """The part of the photo's shorter side that fits see, and what is said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        whole = read_pixels(path)
        side = len(flash_view(whole, name=str(path)).values)
    return side / min(whole.values.shape[:2]), [str(warning.message) for warning in caught]


def share(focal_mm: float, height: int = WHOLE_PX[1], width: int = WHOLE_PX[0]) -> float:
    """The part of the shorter side within the field of view of fits."""
    return min(1.0, math.tan(CAMERA_FOV_RAD / 2) / math.tan(field_of_view_rad(focal_mm, height, width) / 2))


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
def test_a_part_of_a_photo_is_told_by_its_shape(tmp_path: Path, suffix: str) -> None:
    part, (line,) = view_and_lines(photo(tmp_path / f"a.{suffix}", 600, 600, exif_of()))
    assert part == 1  # 28 to 53 degrees, 45 among them
    assert says(
        line, f"a.{suffix}", "EXIF", "1,600 x 1,200", "600 x 600 px are a part", "28 to 53", "taken for 45", "--fov"
    )


@pytest.mark.parametrize("size", [WHOLE_PX, (800, 600), (533, 400), (1201, 901)])
@pytest.mark.parametrize("is_turned", [False, True])
def test_whole_and_smaller_copies_have_the_whole_field_without_a_line(
    tmp_path: Path, size: tuple[int, int], is_turned: bool
) -> None:
    path = photo(tmp_path / "a.jpg", *(size[::-1] if is_turned else size), exif_of())
    part, lines = view_and_lines(path)
    assert lines == []
    assert part == pytest.approx(share(FOCAL_MM), abs=0.01)


def test_a_turned_photo_by_its_orientation_is_whole(tmp_path: Path) -> None:
    exif = exif_of()
    exif[0x112] = 6
    part, lines = view_and_lines(photo(tmp_path / "a.jpg", *WHOLE_PX, exif))
    assert (lines, part) == ([], pytest.approx(share(FOCAL_MM), abs=0.01))


def test_parts_whose_field_is_sure_take_it(tmp_path: Path) -> None:
    """A part as wide or as high as the photo was not scaled, and a part of a narrow field is narrow in any case."""
    path = photo(tmp_path / "strip.jpg", WHOLE_PX[0], 600, exif_of())
    expected_rad = 2 * math.atan(math.tan(field_of_view_rad(FOCAL_MM, 1200, 1600) / 2) / 2)
    (line,) = view_and_lines(path)[1]
    assert says(line, "1,600 x 600 px are a part", f"taken for {math.degrees(expected_rad):.0f} degrees")
    assert narrow_view_height(read_pixels(path)) == pytest.approx(1 / math.tan(expected_rad / 2), rel=1e-4)
    wide, (line,) = view_and_lines(photo(tmp_path / "wide.jpg", 1200, 1200, exif_of(focal_mm=14)))
    assert says(line, "are a part", "taken for")
    assert wide == pytest.approx(share(14), abs=0.01)
    path = photo(tmp_path / "tele.jpg", 600, 600, exif_of(focal_mm=100))
    with pytest.warns(UserWarning, match="are a part"):
        height = svbrdf_inputs.read_task(path).data["places"][0, 0, 2]
    assert float(height) == pytest.approx(1 / math.tan(field_of_view_rad(100, 1200, 1600) / 2), rel=1e-4)


@pytest.mark.parametrize("is_turned", [False, True])
def test_an_upright_part_of_a_lying_photo_may_be_a_turned_copy(tmp_path: Path, is_turned: bool) -> None:
    """It has the photo's ratio of sides, and is as high as the photo."""
    size, stated = ((900, 1200), WHOLE_PX) if not is_turned else ((1200, 900), WHOLE_PX[::-1])
    part, (line,) = view_and_lines(photo(tmp_path / "a.jpg", *size, exif_of(stated)))
    assert part == 1
    assert says(line, f"{size[0]:,} x {size[1]:,} px are a part", "perhaps scaled", "41 to 53", "taken for 45", "--fov")
    assert view_and_lines(photo(tmp_path / "square.jpg", 600, 600, exif_of((600, 600))))[1] == []


def test_any_size_that_exif_states_tells_a_part(tmp_path: Path) -> None:
    """Programs that cut pictures update PixelXDimension, but not the related size; some cameras state only others."""
    updated = exif_of((600, 600))
    updated[EXIF_BLOCK][INTEROPERABILITY_BLOCK] = {1: "R98", 0x1001: WHOLE_PX[0], 0x1002: WHOLE_PX[1]}
    first = exif_of(None)
    first[0x100], first[0x101] = WHOLE_PX
    for number, exif in enumerate((updated, first)):
        path = photo(tmp_path / f"{number}.jpg", 600, 600, exif)
        assert says(view_and_lines(path)[1][0], "1,600 x 1,200", "a part")
        assert lens_of(path).is_part
        with Image.open(path) as image:
            assert pixels_of_pil(image, "a").picture_lens() == read_pixels(path).picture_lens()


def test_a_small_trim_and_a_frame_are_no_parts(tmp_path: Path) -> None:
    part, lines = view_and_lines(photo(tmp_path / "a.jpg", 1560, 1200, exif_of()))
    assert (lines, part) == ([], pytest.approx(share(FOCAL_MM), abs=0.02))
    assert ExifLens(FOCAL_MM, whole_px=(1590, 1195)).of_picture(1200, 1600).focal_mm == FOCAL_MM  # of a raw converter


def test_exif_of_another_picture_is_not_believed(tmp_path: Path) -> None:
    part, (line,) = view_and_lines(photo(tmp_path / "panorama.jpg", 1600, 400, exif_of((800, 600))))
    assert part == 1
    assert says(line, "800 x 600", "no part of", "taken for 45 degrees")
    for size in ((0, 0), (-5, 7), (1600, 0)):
        assert ExifLens(FOCAL_MM, whole_px=size).of_picture(1200, 1200).focal_mm == FOCAL_MM


def test_a_digital_zoom_may_count_or_not(tmp_path: Path) -> None:
    part, (line,) = view_and_lines(photo(tmp_path / "a.jpg", *WHOLE_PX, exif_of(zoom=2.0)))
    assert part == 1
    assert says(line, "digital zoom of 2", "26 mm", "28 to 53", "taken for 45", "--fov")
    for zoom in (1.0, 1.05):
        assert view_and_lines(photo(tmp_path / "a.jpg", *WHOLE_PX, exif_of(zoom=zoom)))[1] == []


def test_previews_and_small_parts_are_said(tmp_path: Path) -> None:
    for suffix in ("jpg", "png", "tif"):
        _, lines = view_and_lines(photo(tmp_path / f"a.{suffix}", 160, 120, exif_of()))
        assert says("\n".join(lines), "160 x 120", "1,600 x 1,200", "EXIF", "preview", "take the photo itself")
    for size, stated in (((400, 300), WHOLE_PX), ((160, 120), (200, 150))):
        assert view_and_lines(photo(tmp_path / "a.jpg", *size, exif_of(stated)))[1] == []


def test_damaged_sizes_are_ignored(tmp_path: Path) -> None:
    exif = exif_of()
    exif[EXIF_BLOCK][0xA002] = "many"
    path = photo(tmp_path / "a.jpg", *WHOLE_PX, exif)
    assert np.isclose(view_and_lines(path)[0], share(FOCAL_MM), atol=0.01)
