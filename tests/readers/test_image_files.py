"""Windows, layers and parts of image files: what a picture shows, whatever else its file holds."""

import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers import environment_maps, flash_photos, material_maps, square_photos, svbrdf_inputs
from data_tools.readers.environment_maps import read_map
from data_tools.readers.image_files import read_pixels, shape_of
from tests.pictures import add_png_chunks, assert_refused_in_one_line, write_exr, write_image

RGB, GRAY = 3, 1


def light(seed: int, channels: int = RGB) -> np.ndarray:
    """A lat-long map of noise, [64, 128, channels]."""
    return np.random.default_rng(seed).uniform(0.1, 0.9, (64, 128, channels)).astype(np.float32)


def layered_picture(**layers: int) -> tuple[np.ndarray, str]:
    """Layers of numbers of channels as one picture, and the names of its channels."""
    layers_with_values = [(name, light(seed, count)) for seed, (name, count) in enumerate(layers.items())]
    names = [
        f"{name}.{channel}".removeprefix("_.").replace("__", ".")
        for name, values in layers_with_values
        for channel in ("RGB" if values.shape[2] == RGB else "Z" if name.endswith("Depth") else "Y")
    ]
    return np.concatenate([values for _, values in layers_with_values], -1), " ".join(names)


# layers by name and number of channels (__ is a dot, _ none); the number of the one that counts, or what is said
LAYERS: dict[str, tuple[dict[str, int], int | str]] = {
    "plain first": ({"a": RGB, "_": RGB, "Combined": RGB}, 1),
    "combined": ({"View__AO": RGB, "View__Combined": RGB, "View__Depth": GRAY}, 1),
    "beauty": ({"z": GRAY, "diffuse": RGB, "BEAUTY": RGB}, 2),
    "rgba": ({"rgba": RGB, "zzz": RGB}, 0),
    "the only one": ({"View__Depth": GRAY, "View__AO": RGB}, 1),
    "the only gray one": ({"Depth": GRAY, "rough": GRAY}, 1),
    "several": ({"diffuse": RGB, "glossy": RGB}, "layers diffuse, glossy, expected one of them; choose it by --layer"),
    "two views": ({"A__Combined": RGB, "B__Combined": RGB}, "layers A.Combined, B.Combined, expected one of them"),
    "depth": ({"View__Depth": GRAY}, "channels View.Depth.Z, expected R, G, B or a gray one; export it as RGB."),
}


@pytest.mark.parametrize("in_parts", [False, True])
@pytest.mark.parametrize("kind", LAYERS)
def test_the_layer_of_the_picture_counts(tmp_path: Path, kind: str, in_parts: bool) -> None:
    layers, found = LAYERS[kind]
    path = tmp_path / "a.exr"
    values, names = layered_picture(**layers)
    if in_parts:
        starts = np.cumsum([0, *layers.values()])
        parts = [
            (f"{name.replace('__', '.')}:{' '.join(path.rpartition('.')[2] for path in names.split()[start:end])}",
             values[..., start:end])
            for name, start, end in zip(layers, starts, starts[1:], strict=False)
        ]  # fmt: skip
        write_exr(path, *parts)
    else:
        write_exr(path, (f":{names}", values))
    if isinstance(found, str):
        assert_refused_in_one_line(read_map, path, "channels Z, expected" if in_parts and kind == "depth" else found)
    elif not (in_parts and kind == "plain first"):
        expected = light(found, list(layers.values())[found])
        assert np.array_equal(read_pixels(path).values, np.broadcast_to(expected, (64, 128, RGB)))


def test_a_layer_can_be_named(tmp_path: Path) -> None:
    values, names = layered_picture(View__Combined=RGB, View__Diffuse=RGB, View__rough=GRAY)
    path = write_exr(tmp_path / "a.exr", (f":{names}", values))
    assert torch.equal(read_map(path, layer="View.Diffuse"), read_map(path, layer="diffuse"))
    assert np.array_equal(read_pixels(path, "Diffuse").values, light(1))
    assert np.array_equal(read_pixels(path, "ROUGH").values[..., 1:2], light(2, GRAY))
    assert_refused_in_one_line(
        lambda path: read_pixels(path, "glow"),
        path,
        "no single layer 'glow' among View.Combined, View.Diffuse, View.rough, expected one of them; choose it by "
        "--layer NAME, or export it alone.",
    )
    plain = write_image(tmp_path / "b.png", (light(0) * 255).astype(np.uint8))
    assert np.array_equal(read_pixels(plain, "glow").values, read_pixels(plain).values)  # without layers


def test_every_reader_of_pictures_takes_a_layer(tmp_path: Path) -> None:
    values, names = layered_picture(Combined=RGB, albedo=RGB)
    path = write_exr(tmp_path / "a.exr", (f":{names}", values))
    alone = write_image(tmp_path / "b.exr", values[..., RGB:])
    for reader, key in (
        (square_photos, "image"),
        (flash_photos, "image"),
        (svbrdf_inputs, "photo"),
        (environment_maps, "map"),
    ):
        read, other = reader.read_task(path, layer="albedo"), reader.read_task(alone)
        assert torch.equal(read.data[key], other.data[key]), reader
        assert not torch.equal(read.data[key], reader.read_task(path).data[key]), reader
    for name in ("rock_normal.exr", "rock_rough.exr"):
        write_image(tmp_path / name, np.full((64, 128, 3), (0.5, 0.5, 1), np.float32))
    path.rename(tmp_path / "rock_albedo.exr")
    task = material_maps.read_task(tmp_path / "rock_albedo.exr", 64, layer="albedo")
    assert not torch.equal(task.data["maps"], material_maps.read_task(tmp_path / "rock_albedo.exr", 64).data["maps"])


# Windows


def test_overscan_is_cut_off(tmp_path: Path) -> None:
    whole = light(0)
    wide = np.pad(whole, ((7, 9), (5, 11), (0, 0)), constant_values=1000)
    for path in (
        write_exr(tmp_path / "a.exr", (":R G B", wide), window=(64, 128, -7, -5)),
        write_exr(tmp_path / "b.exr", ("z:Z", wide[..., :1]), ("rgba:R G B", wide), window=(64, 128, -7, -5)),
    ):
        assert np.array_equal(read_pixels(path).values, whole)
        assert shape_of(path) == (64, 128)
        assert torch.equal(read_map(path), torch.from_numpy(whole).permute(2, 0, 1))


def test_few_pixels_missing_from_a_map_are_black(tmp_path: Path) -> None:
    whole = light(0)
    whole[:3] = whole[62:] = 0  # 0.8 % of the sphere
    path = write_exr(tmp_path / "a.exr", (":R G B", whole[3:62]), window=(64, 128, 3, 0))
    assert torch.equal(read_map(path), torch.from_numpy(whole).permute(2, 0, 1))
    output = (
        "a data window of 128x59 px at 0,3, expected all of the display window, 128x64 px at 0,0; export it uncropped"
    )
    assert_refused_in_one_line(read_pixels, path, output)  # of a photograph
    path = write_exr(tmp_path / "b.exr", (":R G B", whole[:, :-2]), window=(64, 128, 0, 2))
    assert_refused_in_one_line(
        read_map, path, "a data window of 126x64 px at 2,0, expected all of the display window, 128x64"
    )
    path = write_exr(tmp_path / "c.exr", (":R G B", whole), window=(64, 128, 900, 900))  # none of it
    assert_refused_in_one_line(
        read_map, path, "a data window of 128x64 px at 900,900, expected all of the display window"
    )


def test_offsets_of_png_are_no_windows(tmp_path: Path) -> None:
    path = write_image(tmp_path / "a.png", (light(0) * 255).astype(np.uint8))
    before = read_pixels(path).values
    path.write_bytes(add_png_chunks(path.read_bytes(), {b"oFFs": struct.pack(">iiB", 9, 7, 0)}))
    assert np.array_equal(read_pixels(path).values, before)
