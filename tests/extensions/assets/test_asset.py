"""Asset folders, PNG of 16 bits and EXR: what is written is what was fitted, and can be read again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import OpenImageIO as oiio
import pytest
import torch

from data_tools.readers import svbrdf_inputs
from data_tools.readers.material_maps import find, read_task
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import Maps, unpack
from metapp.appearance.surface import from_metallic
from metapp.extensions.assets import pictures
from metapp.extensions.assets.occlusion import occlusion_from_height
from metapp.registry import WITHOUT
from tests.surfaces import PROVENANCE, linear, rock, stored, texture

STEP = 1 / 65535
MAPS = ("basecolor", "diffuse", "specular", "metallic", "roughness", "normal_gl", "normal_dx", "height", "ao", "orm")


@pytest.fixture
def asset(tmp_path: Path) -> Path:
    pictures.write_asset(rock(), tmp_path / "rock", PROVENANCE)
    return tmp_path / "rock"


def file(asset: Path, name: str) -> Path:
    return asset / f"rock_{name}.png"


def test_all_files_are_there_in_16_bits_and_described(asset: Path) -> None:
    names = {f"rock_{name}.png" for name in MAPS}
    assert {each.name for each in asset.iterdir()} == names | {"preview.png", "material.json"}
    assert str(oiio.ImageBuf(str(asset / "preview.png")).spec().format) == "uint8"
    told = json.loads((asset / "material.json").read_text(encoding="utf-8"))
    assert set(told["files"]) == names
    colours = {"rock_basecolor.png", "rock_diffuse.png", "rock_specular.png"}
    assert {name for name, each in told["files"].items() if each["colour_space"] == "sRGB"} == colours
    for name, each in told["files"].items():
        spec = oiio.ImageBuf(str(asset / name)).spec()
        assert (spec.width, spec.height, str(spec.format)) == (32, 32, "uint16")
        assert spec.get_string_attribute("encoding") == each["colour_space"]
        assert spec.nchannels == each["channels"]
    assert told["tiles"] is True
    assert told["provenance"] == PROVENANCE | {"rise": None}


def test_what_was_fitted_comes_back_to_a_step_and_the_height_in_texture_widths(asset: Path) -> None:
    maps = rock().maps
    for name in ("specular", "diffuse"):
        assert (stored(file(asset, name)) - linear_to_srgb(getattr(maps, name))).abs().max() < STEP, name
    assert (stored(file(asset, "roughness")) - maps.roughness).abs().max() < STEP
    assert (stored(file(asset, "normal_gl")) * 2 - 1 - maps.normal).abs().max() < 2 * STEP
    told = json.loads((asset / "material.json").read_text(encoding="utf-8"))["files"]["rock_height.png"]
    height = told["offset"] + told["scale"] * stored(file(asset, "height"))
    expected = rock().height - rock().height.mean()
    assert told["unit"] == "texture widths"
    assert (height * 32 - expected).abs().max() < 5 * 32 * STEP
    assert stored(file(asset, "height")).max() == 1


def test_maps_that_are_made_of_others_are_the_same_material(asset: Path) -> None:
    gl, dx = stored(file(asset, "normal_gl")), stored(file(asset, "normal_dx"))
    assert torch.equal(gl[[0, 2]], dx[[0, 2]])
    assert (gl[1] + dx[1] - 1).abs().max() <= STEP
    single = torch.cat([stored(file(asset, name)) for name in ("ao", "roughness", "metallic")])
    assert torch.equal(stored(file(asset, "orm")), single)
    occlusion = occlusion_from_height(rock().height, periodic=True)
    assert (stored(file(asset, "ao")) - occlusion).abs().max() < 2 * STEP
    base, metallic = linear(file(asset, "basecolor")), stored(file(asset, "metallic"))
    diffuse, specular = from_metallic(base, metallic)
    total = rock().maps.diffuse + rock().maps.specular
    inside = (base < 0.999).all(0)  # where the base colour is not clamped
    assert (diffuse + specular - total).abs()[:, inside].max() < 1e-4
    assert inside.float().mean() > 0.5


def test_our_reader_takes_asset_folders(tmp_path: Path) -> None:
    """The maps that were fitted are read, not those that were made of them, unless there are no others."""
    pictures.write_asset(rock(64), tmp_path / "rock", PROVENANCE)
    (source,) = find([tmp_path / "rock"])[0]
    assert svbrdf_inputs.find([tmp_path / "rock"]) == ([source], [])  # no preview or height for a photograph
    found, maps = unpack(read_task(source, 64).data["maps"].float()), rock(64).maps
    for name in Maps._fields:
        assert (getattr(found, name) - getattr(maps, name)).abs().max() < 1e-3, name  # kept as halves
    for name in ("diffuse", "specular", "normal_dx"):
        file(tmp_path / "rock", name).unlink()
    found = unpack(read_task(file(tmp_path / "rock", "basecolor"), 64).data["maps"].float())
    assert (found.normal - maps.normal).abs().max() < 2e-3
    assert (found.roughness - maps.roughness).abs().max() < 2e-3


def test_a_texture_has_a_base_colour_alone(tmp_path: Path) -> None:
    pictures.write_asset(texture(), tmp_path / "rock", PROVENANCE)
    found = {each.name for each in (tmp_path / "rock").iterdir()}
    assert found == {"rock_basecolor.png", "preview.png", "material.json"}
    assert json.loads((tmp_path / "rock" / "material.json").read_text())["kind"] == "texture"
    assert (linear(file(tmp_path / "rock", "basecolor")) - texture().base).abs().max() < 1e-4


def test_png16_holds_the_fitted_maps_alone(tmp_path: Path) -> None:
    pictures.write_png16(rock(), tmp_path / "rock", PROVENANCE)
    found = {each.stem.removeprefix("rock_") for each in (tmp_path / "rock").iterdir()}
    assert found == {"diffuse", "specular", "roughness", "normal_gl", "height"}
    height = file(tmp_path / "rock", "height")
    spec = oiio.ImageBuf(str(height)).spec()
    low, scale = (float(spec.get_string_attribute(key)) for key in ("offset", "scale"))
    again = (low + scale * stored(height)) * 32
    assert (again - (rock().height - rock().height.mean())).abs().max() < 5 * 32 * STEP


def test_exr_is_linear(tmp_path: Path) -> None:
    pictures.write_exr(rock(), tmp_path / "rock", PROVENANCE)
    maps = rock().maps
    where = tmp_path / "rock"
    assert (stored(where / "rock_specular.exr") - maps.specular).abs().max() < 5e-4  # a half's step below 1
    assert (stored(where / "rock_normal_gl.exr") * 2 - 1 - maps.normal).abs().max() < 1e-6
    expected = (rock().height - rock().height.mean()) / 32
    assert (stored(where / "rock_height.exr") - expected).abs().max() < 1e-6


def test_without_the_extension_surfaces_have_no_exports_and_brdfs_keep_theirs(
    metapp: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(WITHOUT, "assets")
    assert "texture has none; leave it out" in metapp("meta", "texture", "--export", "png16").misuse
    forms = "bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba, nbrdf, onnx, osl, slang, wgsl"
    assert f"brdf expects one of {forms}" in metapp("meta", "brdf", "--export", "png16").misuse
