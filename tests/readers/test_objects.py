"""Objects in memory become the tasks of files that hold the same, or are refused in a line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from data_tools.readers import brdf_objects, environment_maps, flash_photos, square_photos, svbrdf_inputs
from data_tools.readers.numbers import MAX_ARRAY_VALUES, array_of
from metapp.extensions.capture.ball import ball_reader
from metapp.learning.task import Task
from tests.pictures import noise_image, write_image

texture, flash_photo, material, light = (
    form.task_of_object for form in (square_photos, flash_photos, svbrdf_inputs, environment_maps)
)
SIDE = 48
RGB = noise_image(SIDE, SIDE)


def same(task: Task, other: Task) -> bool:
    """Whether two tasks hold the same, bit by bit."""
    keys = task.data.keys()
    return keys == other.data.keys() and all(torch.equal(task.data[key], other.data[key]) for key in keys)


def read(from_object: Callable, source: object, observe: str = "", **how: object) -> Any:
    return from_object(source, "object", observe=observe, **how)


PICTURES: dict[str, object] = {
    "uint8": RGB,
    "tensor": torch.from_numpy(RGB),
    "PIL": Image.fromarray(RGB),
    "uint16": RGB.astype(np.uint16) * 257,
    "big-endian": (RGB.astype(np.uint16) * 257).astype(">u2"),
    "float64": RGB / 255,
    "long double": RGB / np.longdouble(255),
    "conjugate": torch.complex(torch.from_numpy(RGB / -255), torch.from_numpy(RGB / -255)).conj().imag,
    "float32 tensor": torch.from_numpy(RGB / 255).float().requires_grad_(),
    "strided": np.ascontiguousarray(RGB[::-1])[::-1],
}


def test_a_picture_is_read_as_its_file_is(tmp_path: Path) -> None:
    task = square_photos.read_task(write_image(tmp_path / "file.png", RGB))
    for kind, source in PICTURES.items():
        assert same(read(texture, source), task), kind


def test_a_picture_of_halves_is_the_picture() -> None:
    half = torch.from_numpy(RGB / 255).half()
    tasks = [read(texture, source).data["image"] for source in (half, half.numpy(), half.float())]
    assert torch.equal(tasks[0], tasks[1])
    assert torch.equal(tasks[0], tasks[2])


@pytest.mark.parametrize("mode", ["1", "P", "LA", "RGBA", "CMYK", "YCbCr"])
def test_pictures_of_all_modes_are_read(mode: str, tmp_path: Path) -> None:
    image = Image.fromarray(RGB).convert(mode)
    (image.convert("RGB") if mode in ("CMYK", "YCbCr") else image).save(tmp_path / "file.png")
    assert same(read(texture, image), square_photos.read_task(tmp_path / "file.png"))


def test_exif_of_a_picture_counts_as_that_of_its_file(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x112] = 6  # orientation
    exif.get_ifd(0x8769)[0xA405] = 20  # mm: wider than fits are
    Image.fromarray(noise_image(60, 80)).save(tmp_path / "file.png", exif=exif)
    task = flash_photos.read_task(tmp_path / "file.png")
    assert same(read(flash_photo, Image.open(tmp_path / "file.png")), task)
    assert not same(read(flash_photo, noise_image(60, 80)), task)


def waves(side: int = SIDE, dtype: str = "float32") -> dict[str, np.ndarray]:
    """Linear maps, the normals of waves that run up and to the right."""
    rng = np.random.default_rng(0)
    rise = 0.4 * np.sin(np.linspace(0, 20, side))
    normal = np.stack(np.broadcast_arrays(-rise[None], -0.5 * rise[:, None], 1.0), -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    maps = {
        "diffuse": rng.uniform(0.1, 0.9, (side, side, 3)),
        "normal": normal,
        "roughness": rng.uniform(0.3, 0.8, (side, side)),
        "specular": rng.uniform(0.03, 0.06, (side, side, 3)),
    }
    return {name: values.astype(dtype) for name, values in maps.items()}


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_linear_maps_stay_what_they_are(turn: float) -> None:
    """y of their normals points up by definition and is not guessed from their values."""
    given = waves()
    given["normal"][..., 1] *= turn
    maps = read(material, given, size=SIDE).data["maps"].float()
    expected = torch.from_numpy(np.dstack([given["normal"], given["diffuse"], given["roughness"], given["specular"]]))
    torch.testing.assert_close(maps, expected.permute(2, 0, 1), rtol=1e-3, atol=1e-3)


def test_maps_of_integers_are_read_as_their_files_are(tmp_path: Path) -> None:
    maps = waves()
    maps["normal"] = maps["normal"] * 0.5 + 0.5
    stored = {name: (values * 255 + 0.5).astype(np.uint8) for name, values in maps.items()}
    for name, values in stored.items():
        write_image(tmp_path / "files" / f"object_{name}.png", np.atleast_3d(values))
    task = svbrdf_inputs.read_task(tmp_path / "files" / "object_diffuse.png")
    assert same(read(material, stored), task)
    pictures = {name: Image.fromarray(values) for name, values in stored.items()}
    assert same(read(material, pictures), task)


def test_the_photo_of_a_material_is_that_of_its_maps(tmp_path: Path) -> None:
    maps = read(material, waves(), size=SIDE).data
    photo = read(flash_photo, waves()).data["image"]
    expected = flash_photos.read_task(write_image(tmp_path / "photo.png", maps["photo"].permute(1, 2, 0).numpy())).data[
        "image"
    ]
    assert torch.equal(photo, expected)


LIGHT = np.random.default_rng(0).uniform(0.1, 20, (32, 64, 3)).astype(np.float32)


@pytest.mark.parametrize("source", [LIGHT, torch.from_numpy(LIGHT), LIGHT.astype(np.float64)])
@pytest.mark.parametrize("observe", ["reference", "photo"])
def test_a_map_of_light_is_read_as_its_file_is(source: object, observe: str, tmp_path: Path) -> None:
    task = environment_maps.read_task(write_image(tmp_path / "object.exr", LIGHT))
    assert same(read(light, source, observe), task)


def test_a_ball_in_memory_is_a_photo(tmp_path: Path) -> None:
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    ball = (np.clip(1 - x * x - y * y, 0, None) ** 0.5)[..., None] * np.array([1, 0.8, 0.6])
    eight = (ball * 255 + 0.5).astype(np.uint8)
    task = ball_reader.read_task(write_image(tmp_path / "object.png", eight))
    assert task.data.keys() == {"photos"}
    assert same(read(light, eight, "reference"), task)
    assert same(read(light, eight / 255, "photo"), task)


def holed(values: np.ndarray, value: float = np.nan) -> np.ndarray:
    values = values.astype(np.float64)
    values[0, 0] = value
    return values


def array(source: object, name: str, **_: object) -> object:
    return array_of(name, source)


def function(source: object, name: str, **_: object) -> object:
    return brdf_objects.task_of_object(source, name)


DENSE = torch.rand(4, 3)
FLAT = np.tile(np.float32([0, 0, 1]), (SIDE, SIDE, 1))
UNIT = RGB / 255


@pytest.mark.parametrize(
    ("from_object", "source", "line"),
    [
        (texture, 3, r"object: int, expected a path, a picture"),
        (texture, RGB / 1.0, "display values from 0 to 255, expected 0 to 1; clip them, divide by 255"),
        (texture, holed(UNIT), "3 values are NaN or infinite, expected finite display values"),
        (texture, RGB.transpose(2, 0, 1), r"an array \[3, 48, 48\], expected .*; put the channels last"),
        (texture, RGB.astype(int), "values of type int64, expected uint8, uint16 or floating point"),
        (material, {}, "object: maps none, expected diffuse, normal, roughness"),
        (material, {"diffuse": UNIT, "nrmal": FLAT}, "object: a map 'nrmal', expected diffuse, normal"),
        (material, {"diffuse": 2 * UNIT, "normal": FLAT}, "object: diffuse: linear values from 0 to 2, expected 0"),
        (material, {"diffuse": UNIT, "normal": FLAT / 2 + 0.5}, r"vectors of length 1.22 .*; of values in \[0"),
        (array, DENSE.to_sparse(), r"object: a tensor \(float32, sparse_coo, on cpu\), expected"),
        (array, np.ma.masked_less(np.ones((4, 3)) * [1, 0.1, 1], 0.5), "object: 4 values are masked, expected"),
        (array, np.broadcast_to(np.float32(0.5), (60000, 60000, 3)), "object: 10,800,000,000 values, expected"),
        (array, np.array([["a"]]), "object: an array of <U1, expected"),
        # more rows than the function was asked for: nothing of 3e9 values is copied
        (function, lambda wi, wo: np.broadcast_to(0.5, (10**9, 3)), rf"values, expected {MAX_ARRAY_VALUES:,} or fewer"),
        (light, UNIT, r"an array \[48, 48, 3\], expected linear radiance \[H, 2 H, 3\]"),
    ],
)
def test_objects_that_are_no_input_are_refused_in_one_line(from_object: Callable, source: object, line: str) -> None:
    with pytest.raises(ValueError, match=line) as caught:
        read(from_object, source, "reference")
    assert "\n" not in str(caught.value)
