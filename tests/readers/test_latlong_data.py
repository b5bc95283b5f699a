"""Reading HDR maps and photographs of spheres: every layout a user may have, and one line for each that is no use."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch import Tensor

from data_tools.readers import environment_maps
from data_tools.readers.environment_maps import find, read_map, read_task
from metapp.appearance.latlong import mean_luminance, resample_maps, solid_angles
from metapp.storage.image_writers import write_exr
from tests.found_paths import find_paths
from tests.pictures import assert_refused_in_one_line, channels_first, truncate_file, write_image

ACESCG = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
REC709_D65 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
REC709_D50 = (0.64845, 0.33088, 0.32119, 0.59789, 0.1559, 0.06606, 0.34571, 0.35854)  # adapted


def radiance(height: int = 64, width: int = 128, channels: int = 3, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 4, (height, width, channels)).astype(np.float32)


def ball(size: int = 64, seed: int = 0) -> np.ndarray:
    """A picture that is bright all over, uint8 [size, size, 3]."""
    return np.random.default_rng(seed).integers(60, 256, (size, size, 3), dtype=np.uint8)


# Maps


def test_a_map_of_the_right_size_is_read_as_it_is(tmp_path: Path) -> None:
    values = radiance()
    for name in ("a.exr", "a.tif", "A.EXR", "a.pfm"):
        assert torch.equal(read_map(write_image(tmp_path / name, values)), channels_first(values)), name
    upside_down = read_map(write_image(tmp_path / "turned.exr", values, Orientation=3))
    assert torch.equal(upside_down, channels_first(values[::-1, ::-1]))
    read = read_map(write_image(tmp_path / "a.hdr", values))
    torch.testing.assert_close(read, channels_first(values), atol=4 / 128, rtol=0)  # 8 bits and a shared exponent
    half = read_map(write_image(tmp_path / "half.exr", values, "half"))
    torch.testing.assert_close(half, channels_first(values), rtol=1e-3, atol=0)
    assert read_map(write_image(tmp_path / "b.tif", values, "double")).dtype == torch.float32


@pytest.mark.parametrize("size", [(256, 512), (129, 257), (32, 64), (96, 191)])
def test_other_sizes_keep_their_light(tmp_path: Path, size: tuple[int, int]) -> None:
    values = radiance(*size)
    values[size[0] // 3, 5] = 1e5
    read = read_map(write_image(tmp_path / "a.exr", values))
    assert read.shape == (3, 64, 128)

    def energy(maps: Tensor) -> Tensor:
        return (maps.double() * solid_angles(*maps.shape[-2:], dtype=torch.float64)).sum((-2, -1))

    torch.testing.assert_close(energy(read), energy(channels_first(values)), rtol=1e-5, atol=0)
    torch.testing.assert_close(read, resample_maps(channels_first(values), 64, 128))


LAYOUTS: dict[str, tuple[tuple[str, ...], list[int]]] = {
    "alpha": (("R", "G", "B", "A"), [0, 1, 2]),
    "any order": (("B", "G", "R"), [2, 1, 0]),
    "layers": (("V.Combined.R", "V.Combined.G", "V.Combined.B", "V.Depth.Z"), [0, 1, 2]),
    "a layer before the picture's": (
        ("V.AO.R", "V.AO.G", "V.AO.B", "V.Combined.R", "V.Combined.G", "V.Combined.B"),
        [3, 4, 5],
    ),
    "a layer besides": (("R", "G", "B", "glow.R", "glow.G", "glow.B"), [0, 1, 2]),
    "others besides": (("Z", "R", "id", "G", "B"), [1, 3, 4]),
    "gray": (("Y",), [0, 0, 0]),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_channels_go_by_their_names(tmp_path: Path, layout: str) -> None:
    names, order = LAYOUTS[layout]
    values = radiance(channels=len(names))
    for index, name in enumerate(names):
        values[..., index] *= 0.01 if name == "A" else 1 + index
    read = read_map(write_image(tmp_path / "a.exr", values, names=names))
    assert torch.equal(read, channels_first(values[..., order]))


@pytest.mark.parametrize(("brightest", "form"), [(1e-7, "float"), (3.0, "half"), (65504.0, "half"), (1e6, "float")])
def test_radiance_is_written_in_the_smallest_form_that_holds_it(tmp_path: Path, brightest: float, form: str) -> None:
    light = torch.linspace(0.1, brightest, 64 * 128 * 3).reshape(64, 128, 3)
    write_exr(light, tmp_path / "a.exr")
    assert str(oiio.ImageBuf(str(tmp_path / "a.exr")).spec().format) == form
    stored = light.half().float() if form == "half" else light
    torch.testing.assert_close(read_map(tmp_path / "a.exr"), stored.permute(2, 0, 1), rtol=1e-5, atol=1e-6 * brightest)


# Colours


@pytest.mark.parametrize("attributes", [{"chromaticities": ACESCG}, {"oiio_ColorSpace": "ACEScg"}])
def test_colours_of_another_space_are_converted(tmp_path: Path, attributes: dict[str, Any]) -> None:
    # Rec.709's red in ACEScg (AP1), from the published matrices of AP1 and Rec.709 with Bradford's adaptation.
    red_green = np.array([[0.61309732, 0.07019422, 0.02061560], [0.33952285, 0.91635557, 0.10956983]])
    values = np.tile(red_green[None].repeat(32, 1), (64, 2, 1)).astype(np.float32)
    read = read_map(write_image(tmp_path / "a.exr", values, **attributes))
    expected = torch.eye(3)[:2].repeat_interleave(32, 0).repeat(2, 1).T[:, None].expand(3, 64, 128)
    torch.testing.assert_close(read, expected, atol=2e-3, rtol=0)


@pytest.mark.parametrize("space", ["ACES2065-1", "lin_rec2020_scene", "lin_p3d65_scene", "Linear AdobeRGB"])
def test_white_stays_white_and_colours_change(tmp_path: Path, space: str) -> None:
    white = np.ones((64, 128, 3), np.float32)
    read = read_map(write_image(tmp_path / "white.exr", white, oiio_ColorSpace=space))
    torch.testing.assert_close(read, torch.ones(3, 64, 128), atol=2e-3, rtol=0)
    values = radiance()
    assert (
        read_map(write_image(tmp_path / "a.exr", values, oiio_ColorSpace=space)) - channels_first(values)
    ).abs().max() > 0.3


@pytest.mark.parametrize("stated", ["lin_rec709_scene", "linear", REC709_D65, REC709_D50])
def test_colours_of_rec709_stay(tmp_path: Path, stated: str | tuple[float, ...]) -> None:
    values, key = radiance(), "oiio_ColorSpace" if isinstance(stated, str) else "chromaticities"
    read = read_map(write_image(tmp_path / "a.exr", values, **{key: stated}))
    torch.testing.assert_close(read, channels_first(values), rtol=1e-3, atol=1e-3)


def test_values_below_zero_become_zero(tmp_path: Path) -> None:
    green = np.tile(np.float32([0, 1, 0]), (64, 128, 1))
    read = read_map(write_image(tmp_path / "a.exr", green, chromaticities=ACESCG))
    assert read.min() == 0
    assert read[1].min() > 1
    read = read_map(with_values(-1, 20)(tmp_path))  # a trace
    assert read.min() == 0
    assert (read == 0).sum() == 20


# Tasks


def test_a_map_becomes_a_task(tmp_path: Path) -> None:
    values = radiance(128, 256) * np.float32(37)
    task = read_task(write_image(tmp_path / "my room.v2.exr", values))
    assert task.name == "my room.v2"
    assert list(task.data) == list(environment_maps.UNITS) == ["map", "scale", "photos"]
    assert [(tensor.dtype, tensor.shape) for tensor in task.data.values()] == [
        (torch.float32, (3, 64, 128)),
        (torch.float32, ()),
        (torch.uint8, (4, 3, 64, 64)),
    ]
    assert mean_luminance(task.data["map"]).item() == pytest.approx(1, abs=1e-5)
    before = read_map(tmp_path / "my room.v2.exr")
    torch.testing.assert_close(task.data["map"] * task.data["scale"], before)
    assert task.data["scale"].item() == pytest.approx(mean_luminance(channels_first(values)).item(), rel=1e-5)
    values = radiance()
    first, again, other = (
        read_task(write_image(tmp_path / name, values)).data["photos"] for name in ("a.exr", "sub/a.tif", "b.exr")
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


# Files


def test_environment_maps_are_recognised_and_found(tmp_path: Path) -> None:
    for name in ("b.exr", "sub/a.HDR"):
        write_image(tmp_path / name, radiance(32, 64))
    write_image(tmp_path / "b.png", ball(), "uint8")
    (tmp_path / "notes.txt").write_text("about")
    for name in ("", "sub", "b.exr"):
        assert environment_maps.recognises(tmp_path / name)
    for name in ("notes.txt", "b.png"):
        assert not environment_maps.recognises(tmp_path / name)
    found, skipped = find_paths(find, tmp_path)
    assert [file.name for file in found] == ["b.exr", "a.HDR"]
    assert [line.partition(": ")[0] for line in skipped] == [str(tmp_path / name) for name in ("b.png", "notes.txt")]
    assert find_paths(find, tmp_path / "b.png") == ([tmp_path / "b.png"], [])  # reading it says what is wrong
    (tmp_path / "b.exr").unlink()
    (tmp_path / "sub" / "a.HDR").unlink()
    with pytest.raises(ValueError, match="no map in this folder, expected an HDR map"):
        find(tmp_path)


# What is refused


def with_values(value: float, count: int = 1, kind: str = "float") -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        values = radiance()
        values.reshape(-1)[:count] = value
        return write_image(folder / "a.exr", values, kind)

    return make


def picture(name: str, height: int, width: int) -> Callable[[Path], Path]:
    return lambda folder: write_image(folder / name, ball(width)[:height], "uint8")


def layout(*names: str) -> Callable[[Path], Path]:
    return lambda folder: write_image(folder / "a.exr", radiance(channels=len(names)), names=names)


def stated(**attributes: Any) -> Callable[[Path], Path]:
    return lambda folder: write_image(folder / "a.exr", radiance(), **attributes)


BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "square": (
        lambda folder: write_image(folder / "a.exr", radiance(64, 64)),
        "64x64 px, the shape of an angular map or a",
    ),
    "cross": (
        lambda folder: write_image(folder / "a.exr", radiance(96, 128)),
        "128x96 px, the shape of a cross of a cube m",
    ),
    "strip": (
        lambda folder: write_image(folder / "a.exr", radiance(64, 384)),
        "384x64 px, the shape of a strip of a cube ",
    ),
    "no shape": (lambda folder: write_image(folder / "a.exr", radiance(64, 99)), "99x64 px, expected a lat-long map"),
    "tiny": (
        lambda folder: write_image(folder / "a.exr", radiance(4, 8)),
        "8x4 px, expected 32 px or more on the short side",
    ),
    "nan": (with_values(float("nan"), 3), "a.exr: 3 values are NaN or infinite"),
    "negative": (with_values(-1, 200), "radiance down to -1 at a mean of 2"),
    "black": (lambda folder: write_image(folder / "a.exr", 0 * radiance()), "a.exr: black all over"),
    "ldr": (picture("a.jpg", 64, 64), "is an input of fits"),
    "no blue": (layout("R", "G"), "channels R, G, expected R, G, B or a gray one"),
    "encoded": (stated(oiio_ColorSpace="sRGB"), "colours in 'srgb_rec709_scene', expected a linear space"),
    "truncated exr": (
        lambda folder: truncate_file(write_image(folder / "a.exr", radiance())),
        "a.exr: damaged or incomplete (",
    ),
}


@pytest.mark.parametrize("kind", BAD)
def test_files_that_are_no_map_are_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    make, message = BAD[kind]
    assert_refused_in_one_line(read_task, make(tmp_path), message)
