"""Borders of photographs that show nothing are cut off, and nothing else is."""

import io
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from PIL import Image

from data_tools.readers import flash_photos, square_photos, svbrdf_inputs
from data_tools.readers.environment_maps import read_map
from data_tools.readers.environment_maps import read_task as read_map_task
from data_tools.readers.image_files import Pixels, pixels_of_pil
from data_tools.readers.lenses import ExifLens
from data_tools.readers.picture_borders import Part, crop_borders, find_frame, largest_rectangle

COLOURS = ("white", "black", (128, 30, 40), (240, 240, 235))
SIDES = ((20, 20, 20, 20), (0, 12, 0, 12), (30, 0, 0, 0), (0, 0, 0, 5), (8, 8, 8, 40))  # left, top, right, bottom


def photo(width: int = 240, height: int = 200) -> Image.Image:
    """A picture with structure up to its borders, of middle brightness."""
    rng = np.random.default_rng(0)
    coarse = Image.fromarray(rng.integers(60, 200, (height // 8, width // 8, 3), dtype=np.uint8))
    return coarse.resize((width, height), Image.Resampling.BICUBIC)


def with_frame(colour: Any, sides: tuple[int, int, int, int]) -> Image.Image:
    left, top, right, bottom = sides
    picture = photo()
    framed = Image.new("RGB", (picture.width + left + right, picture.height + top + bottom), colour)
    framed.paste(picture, (left, top))
    return framed


def as_jpeg(picture: Image.Image, quality: int) -> Image.Image:
    stream = io.BytesIO()
    picture.save(stream, "JPEG", quality=quality)
    return Image.open(stream)


def crop(picture: Image.Image, *, is_cut_out: bool = False) -> tuple[Pixels, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cropped = crop_borders(pixels_of_pil(picture, "p"), "p", is_cut_out=is_cut_out)
    return cropped, [str(warning.message) for warning in caught]


@pytest.mark.parametrize("colour", COLOURS)
@pytest.mark.parametrize("sides", SIDES)
def test_frame_is_cut_off_on_any_sides(colour: Any, sides: tuple[int, int, int, int]) -> None:
    cropped, (line,) = crop(with_frame(colour, sides))
    assert np.array_equal(cropped.values, np.asarray(photo()))
    assert "frame" in line
    assert "200" in line


@pytest.mark.parametrize("colour", COLOURS[:2])
@pytest.mark.parametrize("sides", SIDES)
def test_frame_is_cut_off_with_noise_of_jpeg(colour: Any, sides: tuple[int, int, int, int]) -> None:
    cropped, _ = crop(as_jpeg(with_frame(colour, sides), 70))
    lost = np.array([200, 240]) - cropped.values.shape[:2]
    assert (lost >= 0).all()
    assert lost.max() <= 6


def test_frame_inside_a_frame_and_sides_of_two_colours() -> None:
    framed = Image.new("RGB", (250, 210), "black")
    framed.paste(photo(), (5, 5))
    double = Image.new("RGB", (280, 240), "white")
    double.paste(framed, (20, 10))
    assert crop(double)[0].values.shape[:2] == (200, 240)
    two_colours = with_frame("black", (10, 0, 0, 0))
    mat = Image.new("RGB", (two_colours.width, two_colours.height + 10), "white")
    mat.paste(two_colours, (0, 10))
    assert crop(mat)[0].values.shape[:2] == (200, 240)


def wall() -> np.ndarray:
    """A wall of bricks, half a joint of one colour at its borders."""
    picture = np.asarray(photo(256, 256)).copy()
    for y in range(0, 256, 64):
        picture[max(0, y - 4) : y + 4] = 130
    picture[-4:] = 130
    picture[:, :4] = picture[:, -4:] = 130
    return picture


def ball() -> np.ndarray:
    """A ball on black, which touches no border."""
    y, x = np.mgrid[-1:1:256j, -1:1:256j]
    return np.asarray(photo(256, 256)) * (np.hypot(x, y) < 0.9)[..., None]


def slope(levels_per_row: float) -> np.ndarray:
    rows = np.clip(255 - levels_per_row * (np.arange(256) - 40).clip(0), 0, 255)
    return np.broadcast_to(rows[:, None, None], (256, 256, 3))


def stripes() -> np.ndarray:
    return np.asarray(photo(256, 256)) * (np.arange(256) // 32 % 2)[:, None, None]


def noisy_wall() -> np.ndarray:
    return (235 + 3 * np.random.default_rng(0).standard_normal((256, 256, 3))).clip(0, 255)


def night() -> np.ndarray:
    """A black sky over houses of several heights."""
    tops = np.random.default_rng(0).integers(60, 120, 8).repeat(32)
    return np.asarray(photo(256, 256)) * (np.arange(256)[:, None] > tops)[..., None]


NO_FRAMES = {
    "structure": np.asarray(photo()), "one colour": np.full((256, 256, 3), 128), "wall": wall(), "ball": ball(),
    "slow slope": slope(1), "slope": slope(3), "stripes": stripes(), "white wall": noisy_wall(), "night": night(),
    "checks": np.kron(np.indices((8, 8)).sum(0) % 2, np.ones((32, 32)))[..., None].repeat(3, -1) * 255,
}  # fmt: skip


@pytest.mark.parametrize("name", NO_FRAMES)
def test_picture_without_a_frame_stays(name: str) -> None:
    picture = Image.fromarray(NO_FRAMES[name].astype(np.uint8))
    for kind in (picture, as_jpeg(picture, 85)):
        cropped, lines = crop(kind, is_cut_out=name == "ball")
        assert cropped.values.shape[:2] == (picture.height, picture.width)
        assert lines == []


@pytest.mark.parametrize("degrees", [-20, 8, 12])
@pytest.mark.parametrize("fill", ["alpha", "black", "white"])
def test_turned_picture_is_cut_to_the_largest_full_rectangle(degrees: int, fill: str) -> None:
    bicubic = Image.Resampling.BICUBIC
    if fill == "alpha":
        turned = photo().convert("RGBA").rotate(degrees, bicubic, expand=True)
    else:
        turned = as_jpeg(photo().rotate(degrees, bicubic, expand=True, fillcolor=fill), 85)
    cropped, (line,) = crop(turned)
    height, width, channels = cropped.values.shape
    assert channels == 3
    assert 0.4 * 200 * 240 < height * width < 200 * 240
    assert cropped.values.min() > 40
    assert cropped.values.max() < 220
    assert "corners" in line or "transparent" in line


def test_holes_and_cut_out_objects_stay() -> None:
    lattice = np.dstack([np.asarray(photo(256, 256)), 255 * (np.indices((256, 256)).sum(0) // 8 % 4 > 0)])
    cropped, lines = crop(Image.fromarray(lattice.astype(np.uint8)))
    assert cropped.values.shape == (256, 256, 4)
    assert lines == []
    disc = np.dstack([np.asarray(photo(256, 256)), 255 * (ball().sum(-1) > 0)]).astype(np.uint8)
    assert crop(Image.fromarray(disc), is_cut_out=True)[0].values.shape == (256, 256, 4)
    assert min(crop(Image.fromarray(disc))[0].values.shape[:2]) > 150


def test_field_of_view_narrows_by_corners_but_not_by_frames() -> None:
    framed = pixels_of_pil(with_frame("white", SIDES[0]), "p")._replace(lens=ExifLens(28.0))
    turned = pixels_of_pil(photo().convert("RGBA").rotate(8, expand=True), "p")._replace(lens=ExifLens(28.0))
    with pytest.warns(UserWarning, match="frame"):
        assert crop_borders(framed, "p").lens.focal_mm == 28
    with pytest.warns(UserWarning, match="transparent"):
        assert 30 < crop_borders(turned, "p").lens.focal_mm < 40


def test_floating_point_values_and_nan_are_read() -> None:
    values = np.pad(np.asarray(photo()) / np.float32(255), ((20, 20), (20, 20), (0, 0)), constant_values=1)
    assert find_frame(values)[0] == Part(20, 220, 20, 260)
    values[100, 100] = np.nan
    assert find_frame(values)[0] == Part(20, 220, 20, 260)


def test_largest_rectangle_is_that_of_all_rectangles() -> None:
    inside = np.random.default_rng(0).random((9, 11)) < 0.8
    part = largest_rectangle(inside)
    areas = [
        (bottom - top) * (right - left)
        for top in range(9) for bottom in range(top + 1, 10) for left in range(11) for right in range(left + 1, 12)
        if inside[top:bottom, left:right].all()
    ]  # fmt: skip
    assert part.crop(inside).all()
    assert part.crop(inside).size == max(areas)


@pytest.mark.parametrize("reader", [square_photos, flash_photos, svbrdf_inputs])
def test_all_readers_of_photographs_cut_frames_off(reader: ModuleType, tmp_path: Path) -> None:
    photo(256, 256).save(tmp_path / "plain.png")
    framed = Image.new("RGB", (296, 296), "white")
    framed.paste(photo(256, 256), (20, 20))
    framed.save(tmp_path / "framed.png")
    expected = reader.read_task(tmp_path / "plain.png", 64).data
    with pytest.warns(UserWarning, match=r"framed\.png: 296 x 296 px with a frame"):
        read = reader.read_task(tmp_path / "framed.png", 64).data
    assert all(torch.equal(read[key], value) for key, value in expected.items())


def write_panorama(path: Path, values: np.ndarray, **stated: Any) -> Path:
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], 3, oiio.FLOAT)
    for name, value in stated.items():
        spec.attribute(f"GPano:{name}", value)
    picture = oiio.ImageBuf(spec)
    picture.set_pixels(oiio.ROI(), values.astype(np.float32))
    assert picture.write(str(path))
    return path


def stated_part(rows: slice, columns: slice, height: int = 128) -> dict[str, object]:
    return {
        "ProjectionType": "equirectangular", "FullPanoWidthPixels": 2 * height, "FullPanoHeightPixels": height,
        "CroppedAreaImageWidthPixels": columns.stop - columns.start, "CroppedAreaLeftPixels": columns.start,
        "CroppedAreaImageHeightPixels": rows.stop - rows.start, "CroppedAreaTopPixels": rows.start,
    }  # fmt: skip


@pytest.mark.parametrize(("rows", "columns"), [((16, 112), (32, 224)), ((0, 100), (0, 256)), ((0, 128), (64, 256))])
@pytest.mark.parametrize("suffix", [".exr", ".tif"])
def test_part_of_a_panorama_is_refused_in_one_line(
    rows: tuple[int, int], columns: tuple[int, int], suffix: str, tmp_path: Path
) -> None:
    sky = np.random.default_rng(0).random((128, 256, 3))
    path = write_panorama(
        tmp_path / f"p{suffix}", sky[slice(*rows), slice(*columns)], **stated_part(slice(*rows), slice(*columns))
    )
    with pytest.raises(ValueError, match="part of a panorama") as refusal:
        read_map(path)
    assert "256x128" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_panorama_that_lacks_almost_nothing_is_placed(tmp_path: Path) -> None:
    sky = 1 + np.random.default_rng(0).random((128, 256, 3))
    whole = read_map(write_panorama(tmp_path / "whole.exr", sky, **stated_part(slice(0, 128), slice(0, 256))))
    part = read_map(write_panorama(tmp_path / "part.exr", sky[:123], **stated_part(slice(0, 123), slice(0, 256))))
    assert torch.equal(part[:, :61], whole[:, :61])
    assert not part[:, 62:].any()


def test_completed_panorama_and_other_ratios_of_sides_do_not_count_as_parts(tmp_path: Path) -> None:
    sky = np.random.default_rng(0).random((128, 256, 3))
    stale = stated_part(slice(0, 100), slice(0, 256))
    assert torch.equal(
        read_map(write_panorama(tmp_path / "a.exr", sky, **stale)), read_map(write_panorama(tmp_path / "b.exr", sky))
    )


def test_panorama_in_jpeg_is_no_photograph_of_a_ball(tmp_path: Path) -> None:
    words = " ".join(f'GPano:{name}="{value}"' for name, value in stated_part(slice(16, 112), slice(32, 224)).items())
    xmp = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" {words}/></rdf:RDF></x:xmpmeta>'
    )
    photo(192, 96).resize((192, 96)).save(tmp_path / "p.jpg", xmp=xmp.encode())
    with pytest.raises(ValueError, match=r"part of a panorama|HDR map"):
        read_map_task(tmp_path / "p.jpg", observe="photo")
