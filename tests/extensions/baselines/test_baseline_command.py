"""`metapp baseline`: methods of the baselines table on a user's own files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from metapp.runs.stored_fits import read_fits
from tests.pictures import write_noise_map, write_noise_photo


def test_a_method_makes_a_picture_and_a_record_of_a_file(metapp: Callable) -> None:
    write_noise_photo(Path("wall.png"), 9, 80)
    result = metapp("baseline", "texture", "wall.png", "--method", "quilting", "--recipe", "quick", "--json")
    assert result.code == 0, result.err
    out = Path(result.json_document["out"])
    (record,) = read_fits(out, by_paradigm=False)
    assert record.name == "wall"
    assert record.error == result.json_document["tasks"][0]["error"] > 0
    assert record.seconds is not None
    assert record.seconds > 0
    spec = oiio.ImageBuf(str(out / "wall" / "texture.png")).spec()
    assert (spec.width, spec.height) == (64, 64)
    assert "cannot" in result.err


def test_quilting_writes_the_maps_of_a_flash_photo(metapp: Callable) -> None:
    write_noise_photo(Path("cloth.png"), 9, 80)
    result = metapp("baseline", "svbrdf_stationary", "cloth.png", "--method", "quilting", "--recipe", "quick", "--json")
    assert result.code == 0, result.err
    output_folder = sorted(Path(result.json_document["out"], "cloth").glob("*.png"))
    maps = {"diffuse", "specular", "roughness", "normal", "height"}
    assert {file.stem for file in output_folder} == maps | {f"lit_from_{name}" for name in ("left", "above", "aside")}
    for file in output_folder:
        spec = oiio.ImageBuf(str(file)).spec()
        assert (spec.width, spec.height) == (64, 64)
        encoding = "linear" if file.stem in ("roughness", "normal", "height") else "sRGB"
        assert spec.get_string_attribute("encoding") == encoding
    assert "repeats" in result.err
    unknown = metapp("baseline", "svbrdf_stationary", "cloth.png", "--method", "gpdm")
    assert unknown.code == 2
    assert "expected nearest, quilting." in unknown.err


@pytest.mark.parametrize(
    ("app", "method", "file"),
    [
        ("texture", "quilting", "texture.png"),
        ("texture", "blending", "texture.png"),
        ("svbrdf_stationary", "quilting", "diffuse.png"),
    ],
)
def test_methods_write_files_that_tile_of_the_size_asked_for(
    app: str, method: str, file: str, metapp: Callable
) -> None:
    """The columns at the edges of the picture go on in each other, as neighbouring columns do."""
    write_noise_photo(Path("wall.png"), 9, 80)
    result = metapp("baseline", app, "wall.png", "--method", method, "--recipe", "quick", "--size", "96x128", "--json")
    assert result.code == 0, result.err
    picture = oiio.ImageBuf(str(Path(result.json_document["out"], "wall", file))).get_pixels("float")[..., :3]
    assert picture.shape[:2] == (96, 128)
    for axis in (0, 1):
        steps = np.abs(np.diff(picture, axis=axis, append=picture.take([0], axis=axis))).mean((1 - axis, 2))
        assert steps[-1] < 1.5 * steps[:-1].max()


def test_a_method_that_writes_one_size_refuses_others(metapp: Callable) -> None:
    write_noise_photo(Path("wall.png"), 9, 80)
    refused = metapp("baseline", "texture", "wall.png", "--method", "nearest", "--recipe", "quick", "--size", "128")
    assert (refused.code, "--size: nearest writes files of one size" in refused.err) == (2, True)
    assert "quilting" in refused.err
    unknown = metapp("baseline", "brdf", "wall.png", "--size", "128")
    assert unknown.code == 2


@pytest.mark.usefixtures("second_scene")
def test_harmonics_of_a_map_are_written_as_radiance(metapp: Callable) -> None:
    write_noise_map(Path("hall.exr"))
    options = ["--method", "sh", "--observe", "reference", "--recipe", "quick", "--json"]
    result = metapp("baseline", "illumination", "hall.exr", *options)
    assert result.code == 0, result.err
    output_folder = Path(result.json_document["out"], "hall")
    assert sorted(file.name for file in output_folder.iterdir()) == ["map.exr", "map.png", "record.json", "relit.png"]
    found, expected = (
        oiio.ImageBuf(str(file)).get_pixels("float") for file in (output_folder / "map.exr", Path("hall.exr"))
    )
    assert np.abs(found - expected).mean() < 0.8 * np.abs(expected - expected.mean((0, 1))).mean()  # which is noise


def test_an_application_without_methods_says_so(metapp: Callable) -> None:
    result = metapp("baseline", "transport", "--method", "nearest")
    assert "--method nearest: not one of transport, expected another application" in result.misuse


@pytest.mark.long
@pytest.mark.parametrize("method", ["quilting", "blending"])
@pytest.mark.parametrize("size", ["", "300x640"])
def test_files_have_the_scale_and_resolution_of_the_photo(method: str, size: str, metapp: Callable) -> None:
    """Without a size, files have the photograph's; the grain of its px is as strong as there."""
    write_noise_photo(Path("wall.png"), 9, 512)
    options = ["--size", size] if size else []
    result = metapp("baseline", "texture", "wall.png", "--method", method, *options, "--json").json_result
    picture, photo = (
        oiio.ImageBuf(str(path)).get_pixels("float")[..., :3]
        for path in (Path(result["out"], "wall", "texture.png"), Path("wall.png"))
    )
    assert picture.shape[:2] == ((300, 640) if size else (512, 512))
    for axis in (0, 1):
        changes = [float(np.abs(np.diff(values, axis=axis)).mean()) for values in (picture, photo)]
        assert changes[0] == pytest.approx(changes[1], rel=0.1)
    judged = metapp("baseline", "texture", "wall.png", "--method", method, "--json").json_result
    assert result["tasks"][0]["error"] == judged["tasks"][0]["error"]  # of pictures of the exemplar's size
