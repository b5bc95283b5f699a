"""Normal maps whose z is left out, or whose x lies in alpha, are those of all channels; what is none is refused."""

import warnings
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch.nn import functional

from data_tools.readers.material_maps import find, read_task
from data_tools.readers.normal_maps import complete_normals
from data_tools.readers.square_photos import read_photo
from tests.found_paths import find_paths
from tests.pictures import noise_image, write_image

SIDE = 64


@pytest.fixture
def stored_normals() -> np.ndarray:
    """Normals of waves, 8 bits [64, 64, 3], slopes to 0.9."""
    x = torch.arange(SIDE).float() * 2 * torch.pi / SIDE
    slopes = 0.9 * torch.stack([torch.sin(3 * x)[None, :] * torch.cos(x)[:, None], torch.cos(2 * (x[:, None] + x))])
    planes = functional.normalize(torch.cat([slopes, torch.ones(1, SIDE, SIDE)]), dim=0)
    return ((planes / 2 + 0.5) * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()


def said(values: np.ndarray) -> tuple[np.ndarray, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = complete_normals(values, Path("n.png"))
    return result, [str(warning.message) for warning in caught]


def with_blue(stored: np.ndarray, blue: int | np.ndarray) -> np.ndarray:
    changed = stored.copy()
    changed[..., 2] = blue
    return changed


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("blue", [0, 128, 255])
def test_blue_of_one_value_is_z_of_unit_normals(stored_normals: np.ndarray, blue: int, kind: type) -> None:
    factor = {np.uint8: 1, np.uint16: 257, np.float32: 1 / 255}[kind]
    values = (with_blue(stored_normals, blue).astype(np.float64) * factor).astype(kind)
    result, (line,) = said(values)
    assert result.dtype == values.dtype
    np.testing.assert_allclose(result / factor, stored_normals, atol=2.5)  # levels; x and y have been rounded
    assert line == f"n.png: blue of the normals is {blue} of 255 all over, taken instead: sqrt(1 - x^2 - y^2)."


@pytest.mark.parametrize("what", ["z in 0..1", "another map", "JPEG"])
def test_blue_that_is_no_z_is_rebuilt(stored_normals: np.ndarray, what: str, tmp_path: Path) -> None:
    if what == "JPEG":
        path = write_image(tmp_path / "n.jpg", with_blue(stored_normals, 255))
        values, slack = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8), 60.0  # x and y suffer as well
    else:
        blue = 2.0 * stored_normals[..., 2] - 255 if what == "z in 0..1" else noise_image(SIDE, SIDE)[..., 0]
        values, slack = with_blue(stored_normals, np.asarray(blue).clip(0, 255).astype(np.uint8)), 2.5
    result, (line,) = said(values)
    assert np.abs(result.astype(float) - stored_normals).mean() < slack / 10
    assert "blue of the normals is " in line


@pytest.mark.parametrize("mark", [0, 255])
@pytest.mark.parametrize("blue", [0, 255, "y"])
def test_x_in_alpha_is_found(stored_normals: np.ndarray, mark: int, blue: int | str) -> None:
    red = np.full_like(stored_normals[..., 0], mark)
    third = stored_normals[..., 1] if blue == "y" else np.full_like(red, blue)
    result, (line,) = said(np.stack([red, stored_normals[..., 1], third, stored_normals[..., 0]], -1))
    np.testing.assert_allclose(result.astype(float), stored_normals, atol=2.5)
    assert line == "n.png: red is constant, x is taken from alpha, z = sqrt(1 - x^2 - y^2)."


def test_whole_normals_stay_as_they_are(stored_normals: np.ndarray) -> None:
    plane = np.full_like(stored_normals, 128)
    plane[..., 2] = 255
    grazing = stored_normals.astype(float) * 0.97 + 0.03 * 127.5  # as averages are, of length 0.97
    ridges = stored_normals.copy()
    ridges[..., 0] = 128
    ridges[..., 2] = (np.sqrt(1 - (ridges[..., 1] / 127.5 - 1.0) ** 2).clip(0) * 127.5 + 127.5).round()
    alpha = np.concatenate([stored_normals, noise_image(SIDE, SIDE)[..., :1]], -1)  # heights, of no use here
    for values in (
        stored_normals,
        plane,
        grazing.round().astype(np.uint8),
        ridges,
        alpha,
        np.full_like(stored_normals, 200),
    ):
        result, lines = said(values)
        assert not lines
        np.testing.assert_array_equal(result, values[..., :3])


def test_maps_without_x_and_y_are_refused(stored_normals: np.ndarray) -> None:
    opaque = np.concatenate([with_blue(stored_normals, 255), np.full_like(stored_normals[..., :1], 255)], -1)
    opaque[..., 0] = 255
    for values, message in (
        (np.repeat(stored_normals[..., :1], 3, -1), "red and green are equal"),
        (
            np.concatenate([np.repeat(stored_normals[..., 1:2], 3, -1), stored_normals[..., :1]], -1),
            "red and green are equal",
        ),
        (opaque, "red is 255 of 255 all over"),
        (noise_image(SIDE, SIDE), r"x\^2 \+ y\^2 of red and green is above 1 in \d\d% of the px"),
    ):
        with pytest.raises(ValueError, match=f"^n.png: {message}.*expected"):
            complete_normals(values, Path("n.png"))


@pytest.mark.filterwarnings("ignore:.*blue of the normals")
@pytest.mark.parametrize("suffix", ["tif", "exr"])
def test_files_of_red_and_green_are_normals_but_no_photos(
    stored_normals: np.ndarray, tmp_path: Path, suffix: str
) -> None:
    def material(folder: Path, values: np.ndarray, end: str) -> torch.Tensor:
        write_image(folder / "rock_diffuse.png", noise_image(SIDE, SIDE))
        write_image(folder / "rock_roughness.png", noise_image(SIDE, SIDE))
        write_image(folder / f"rock_normal.{end}", values)
        (source,), _ = find_paths(find, folder)
        return read_task(source, SIDE).data["maps"][:3].float()

    two = (
        stored_normals[..., :2]
        if suffix == "tif"
        else (stored_normals[..., :2] / np.float32(127.5) - 1).astype(np.float32)
    )
    whole = material(tmp_path / "whole", stored_normals, "png")
    torch.testing.assert_close(material(tmp_path / "two", two, suffix), whole, atol=0.03, rtol=0)
    with pytest.raises(ValueError, match="channels R, G, expected R, G, B or a gray one"):
        read_photo(tmp_path / "two" / f"rock_normal.{suffix}")
