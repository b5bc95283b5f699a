"""Files that viewers relight: decoded here by the viewers' formulas, they show what a fit's photographs predict."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb
from metapp.apps.svbrdf_nonstationary.recipes import PHOTO_RECIPES
from metapp.apps.svbrdf_nonstationary.rti.lit_photos import LitPhotos
from metapp.apps.svbrdf_nonstationary.rti.recipe import RTI
from metapp.extensions.rti_files.ptm_file import polynomial_terms, write_ptm
from metapp.extensions.rti_files.relight_folder import PLANE_COUNT, find_colour_planes, grid_directions, write_relight
from metapp.learning.task import Task
from metapp.storage.image_writers import write_jpeg
from tests.apps.rti.scenes import dome, lit_task
from tests.cli.messages import says
from tests.recipe_apps import fit_of

HEADER_LINES = 6
LEVEL = 1 / 255


def decode_ptm(path: Path, light: np.ndarray) -> np.ndarray:
    """Return the picture [H, W, 3] under a lamp as readers of `.ptm` files compute it, in display values of 0 to 1."""
    *lines, pixels = path.read_bytes().split(b"\n", HEADER_LINES)
    version, form, width, height, scales, biases = (line.decode() for line in lines)
    assert (version, form) == ("PTM_1.2", "PTM_FORMAT_RGB")
    assert max(map(len, lines)) < 256  # readers in C read a line into so many bytes
    levels = np.frombuffer(pixels, np.uint8).reshape(3, int(height), int(width), 6)[:, ::-1]
    scale, bias = np.array(scales.split(), float), np.array([int(number) for number in biases.split()])
    assert bias.min() >= 0
    assert bias.max() <= 255
    x, y = light[:2]
    terms = np.array([x * x, y * y, x * y, x, y, 1])
    return (((levels - bias) * scale) @ terms).transpose(1, 2, 0) / 255


def decode_relight(folder: Path, light: np.ndarray) -> np.ndarray:
    """Return the picture [H, W, 3] under a lamp as OpenLIME computes it, in display values of 0 to 1."""
    info = json.loads((folder / "info.json").read_text())
    assert (info["type"], info["colorspace"], info["format"]) == ("bilinear", "mrgb", "jpg")
    side, count, material = info["resolution"], info["nplanes"], info["materials"][0]
    numbers = np.array(info["basis"])
    assert numbers.min() >= 0
    assert numbers.max() <= 255
    basis = numbers.reshape(count + 1, side, side, 3).astype(float)
    basis[0] /= 255
    basis[1:] = (basis[1:] - 127) / np.array(material["range"])[:, None, None, None]
    total = np.abs(light).sum()
    x = ((light[0] + light[1]) / total + 1) / 2 * (side - 1)
    y = ((light[1] - light[0]) / total + 1) / 2 * (side - 1)
    column, row = (min(side - 2, max(0, int(np.floor(number)))) for number in (x, y))
    right, down = x - column, y - row
    weights = (
        (1 - right) * (1 - down) * basis[:, row, column]
        + right * (1 - down) * basis[:, row, column + 1]
        + (1 - right) * down * basis[:, row + 1, column]
        + right * down * basis[:, row + 1, column + 1]
    )
    files = [oiio.ImageBuf(str(folder / f"plane_{number}.jpg")).get_pixels(oiio.FLOAT) for number in range(count // 3)]
    planes = (np.concatenate(files, -1) - np.array(material["bias"])) * np.array(material["scale"])
    assert planes.shape == (info["height"], info["width"], count)
    return weights[0] + planes @ weights[1:]


def decibels(picture: np.ndarray, other: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(np.clip(picture, 0, 1) - other).mean()))


def photos_of(task: Task) -> LitPhotos:
    """Return the photographs of a task under their lamps."""
    return LitPhotos(task.data["lit"], task.data["lamps"].float())


def predict(task: Task, lights: Tensor) -> np.ndarray:
    """Return what `fit.relight` answers, as display values [M, H, W, 3]."""
    return linear_to_srgb(photos_of(task).relight(lights)).permute(0, 2, 3, 1).numpy()


def oblong_task(lamps: int = 40, specular: float = 0.04) -> Task:
    """Return a task whose photographs have fewer rows than columns, and look different upside down."""
    task = lit_task(40, lamps, specular)
    return Task("coin 1.5", task.data | {name: task.data[name][..., :24, :] for name in ("lit", "photo")})


@pytest.mark.parametrize(
    ("write", "decode", "least_db"),
    [
        (write_ptm, lambda path, light: decode_ptm(path.with_name("coin 1.5.ptm"), light), 25.0),
        (write_relight, decode_relight, 36.0),
    ],
    ids=["ptm", "relight"],
)
def test_viewers_show_what_the_photographs_predict(
    write: Callable[..., None], decode: Callable[[Path, np.ndarray], np.ndarray], least_db: float, tmp_path: Path
) -> None:
    task, lights, path = oblong_task(), dome(7, 30.0)[[1, 3]], tmp_path / "new" / "coin 1.5"
    write(photos_of(task), path, {})
    expected = predict(task, lights)
    for light, picture in zip(lights.numpy(), expected, strict=True):
        decoded = decode(path, light)
        assert decibels(decoded, picture) > least_db
        # upside down, mirrored or under a mirrored lamp it is another picture
        wrong = [decoded[::-1], decoded[:, ::-1], decode(path, light * [-1, 1, 1]), decode(path, light * [1, -1, 1])]
        assert all(decibels(other, picture) < least_db - 4 for other in wrong)


def test_a_ptm_of_polynomials_is_exact_to_its_bytes(tmp_path: Path) -> None:
    lamps = dome(30)
    coefficients = torch.tensor([-0.2, 0.1, 0.1, 0.2, -0.1, 0.6])[:, None] * torch.tensor([1.0, 0.7, 0.3])
    values = polynomial_terms(lamps) @ coefficients
    photos = (values * 255).round().to(torch.uint8)[:, :, None, None].expand(-1, -1, 3, 5).contiguous()
    write_ptm(LitPhotos(photos, lamps), tmp_path / "flat", {})
    for light in dome(5, 30.0):
        expected = (polynomial_terms(light[None]) @ coefficients).numpy()
        assert np.abs(decode_ptm(tmp_path / "flat.ptm", light.numpy()) - expected).max() < 4 * LEVEL


def test_more_planes_hold_more_of_the_photographs() -> None:
    photos = lit_task(24, 20, 0.04).data["lit"]
    errors = []
    for count in (3, 9, 60):
        mean, components, planes = find_colour_planes(photos, count)
        sums = mean[..., None, None] + torch.einsum("nck,khw->nchw", components, planes)
        errors.append(float((sums - photos / 255).abs().mean()))
    assert errors[0] > 2 * errors[1]
    assert errors[1] > errors[2]
    assert errors[2] < 1e-4


def test_planes_are_compressed_each_by_itself(tmp_path: Path) -> None:
    """As luminance and chrominance, a plane's noise would be found in the planes beside it."""
    pixels = torch.full((64, 64, 3), 0.5)
    pixels[..., 1] = torch.rand(64, 64, generator=torch.Generator().manual_seed(0))
    write_jpeg(pixels, tmp_path / "three.jpg", 90)
    read = oiio.ImageBuf(str(tmp_path / "three.jpg")).get_pixels(oiio.FLOAT)
    assert np.abs(read[..., [0, 2]] - 0.5).max() < LEVEL
    assert np.abs(read[..., 1] - pixels[..., 1].numpy()).mean() < 4 * LEVEL


def test_three_photographs_make_as_many_planes_as_they_have_channels(tmp_path: Path) -> None:
    task = lit_task(16, 3)
    write_relight(photos_of(task), tmp_path / "three", {})
    info = json.loads((tmp_path / "three" / "info.json").read_text())
    assert info["nplanes"] == 9 < PLANE_COUNT
    assert sorted(path.name for path in (tmp_path / "three").iterdir()) == [
        "info.json",
        "plane_0.jpg",
        "plane_1.jpg",
        "plane_2.jpg",
    ]
    light = task.data["lamps"][1]
    assert decibels(decode_relight(tmp_path / "three", light.numpy()), predict(task, light[None])[0]) > 30


def test_directions_of_the_grid_come_back_at_its_points() -> None:
    x, y, z = grid_directions(5).T
    total = x.abs() + y.abs() + z.abs()
    column, row = torch.meshgrid(torch.arange(5.0), torch.arange(5.0), indexing="xy")
    torch.testing.assert_close(((x + y) / total + 1) * 2, column.flatten())
    torch.testing.assert_close(((y - x) / total + 1) * 2, row.flatten())
    assert float(z.min()) >= 0


@pytest.mark.parametrize("form", ["ptm", "relight"])
def test_what_has_no_photographs_under_lamps_is_refused(form: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^leaf: ") as refused:
        fit_of(PHOTO_RECIPES["full"].app, {}, Task("leaf", {})).write_export(form, tmp_path / "leaf")
    assert says(str(refused.value), "leaf", "photos under many lamps", "rti", ".lp")
    with pytest.raises(KeyError):  # `metapp export` then looks for the input
        fit_of(RTI.app, {}, Task("coin", {})).write_export(form, tmp_path / "coin")
    assert not list(tmp_path.iterdir())
