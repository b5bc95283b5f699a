"""`metapp ... svbrdf_nonstationary` end to end, on strips, maps and flash photographs, at a size that takes no time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from data_tools.formats import exports_of
from data_tools.readers.svbrdf_task import flash_photo
from metapp.appearance.flash import Maps, normal_from_height, pack, unpack
from metapp.apps.svbrdf_nonstationary import MaterialSetup, field_of
from metapp.apps.svbrdf_nonstationary.recipes import RECIPES

MADE = {f"{name}.png" for name in ("normal", "diffuse", "roughness", "specular")} | {
    f"lit_from_{side}.png" for side in ("left", "above", "aside")
}

APP = "svbrdf_nonstationary"


def material(size: int = 64) -> Tensor:
    coarse = torch.rand(1, 8, 4, 4, generator=torch.Generator().manual_seed(0))
    smooth = interpolate(coarse, (size, size), mode="bilinear")[0]
    return pack(Maps(0.7 * smooth[1:4], 0.3 * smooth[4:7], 0.3 + 0.5 * smooth[7:], normal_from_height(4 * smooth[:1])))


def write(path: Path, planes: Tensor) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = (255 * planes.clamp(0, 1)).round().to(torch.uint8) if planes.is_floating_point() else planes
    oiio.ImageBuf(np.ascontiguousarray(pixels.permute(1, 2, 0).numpy())).write(str(path))
    return path


@pytest.fixture
def strip(tmp_path: Path) -> Path:
    maps = unpack(material())
    photo = flash_photo(material()).float() / 255
    tiles = [photo, maps.normal / 2 + 0.5, maps.diffuse, maps.roughness.expand(3, -1, -1), maps.specular]
    return write(tmp_path / "in" / "tiles.png", torch.cat(tiles, 2))


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    return write(tmp_path / "in" / "wall.png", flash_photo(material(80)))


@pytest.fixture(autouse=True)
def small(short_by_protocol: Callable) -> None:
    """Other sizes and a few steps."""
    quick, full = (field_of(side, hidden=8)._replace(code=3) for side in (16, 24))
    short_by_protocol(RECIPES, MaterialSetup(quick, width=2), MaterialSetup(full, width=2))


def size_of(path: Path) -> tuple[int, int]:
    spec = oiio.ImageBuf(str(path)).spec()
    return spec.width, spec.height


def test_a_strip_is_fitted_and_its_maps_are_written(metapp: Callable, strip: Path, tmp_path: Path) -> None:
    result = metapp("overfit", "svbrdf_nonstationary", strip, "--out", tmp_path / "runs", "--json")
    assert result.code == 0, result.err
    document = result.document
    assert (document["observe"], document["tasks"][0]["name"]) == ("reference", "tiles")
    assert "-full-" in document["out"]
    assert 0 < document["error"] < 2
    made = Path(document["out"]) / "outputs" / "tiles"
    assert {path.name for path in made.iterdir()} == MADE
    assert {size_of(path) for path in made.iterdir()} == {(256, 256)}  # readers scale to it


def test_a_photo_is_fitted_without_a_reference(metapp: Callable, photo: Path, tmp_path: Path) -> None:
    arguments = ("overfit", "svbrdf_nonstationary", photo, "--observe", "photo", "--out", tmp_path / "runs", "--json")
    result = metapp(*arguments)
    assert result.code == 0, result.err
    document = result.document
    assert document["error"] is None
    assert {path.name for path in (Path(document["out"]) / "outputs" / "wall").iterdir()} == MADE
    assert (Path(document["out"]) / "pictures.png").is_file()


@pytest.mark.parametrize("kind", [each for each, form in exports_of(APP).items() if not form.missing()])
def test_a_photo_becomes_an_asset(metapp: Callable, photo: Path, tmp_path: Path, kind: str) -> None:
    common = ("--observe", "photo", "--out", tmp_path / "runs", "--json")
    result = metapp("overfit", "svbrdf_nonstationary", photo, *common, "--steps", "2", "--export", kind)
    assert result.code == 0, result.err
    written = [path for path in (Path(result.document["out"]) / kind).rglob("wall*") if path.is_file()]
    assert written
    assert all(path.stat().st_size for path in written)
    assert f"1 fits written as {kind}" in result.err


def test_a_missing_library_is_said_before_anything_is_fitted(
    metapp: Callable, photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    form = exports_of(APP)["asset"]._replace(needs=("no_such_module", "no-such-package"))
    monkeypatch.setattr("metapp.runs.checks.exports_of", lambda app: {"asset": form})
    result = metapp("overfit", "svbrdf_nonstationary", photo, "--out", tmp_path / "runs", "--export", "asset")
    assert result.code == 2
    assert '--export asset needs no-such-package: pip install "metapp[export]"' in result.err
    assert not (tmp_path / "runs").exists()


def test_the_field_of_view_that_is_said_counts(metapp: Callable, photo: Path, tmp_path: Path) -> None:
    common = ("--observe", "photo", "--steps", "1", "--out", tmp_path / "runs", "--json")
    said = {fov: metapp("overfit", APP, photo, *common, "--fov", fov).document["data"] for fov in ("0", "45", "70")}
    assert said["0"] == said["45"] != said["70"]  # names of data tell their content
    refused = metapp("overfit", "texture", photo, "--fov", "60", "--out", tmp_path / "runs")
    assert refused.code == 2
    assert "--fov: texture has no flash photos; leave it out." in refused.err


def test_a_photo_needs_its_protocol(metapp: Callable, photo: Path, tmp_path: Path) -> None:
    result = metapp("overfit", "svbrdf_nonstationary", photo, "--out", tmp_path / "runs")
    assert result.code == 1
    assert "wall: a flash photo, expected a material's maps where fits see them; give a strip or its maps" in result.err
    assert len(result.err.strip().splitlines()) <= 2


def test_a_folder_of_strips_and_photos(metapp: Callable, strip: Path, photo: Path, tmp_path: Path) -> None:
    common = ("--observe", "photo", "--out", tmp_path / "runs", "--json")
    document = metapp("overfit", "svbrdf_nonstationary", strip.parent, *common).document
    errors = {task["name"]: task["error"] for task in document["tasks"]}
    assert errors["wall"] is None
    assert document["error"] == pytest.approx(errors["tiles"])


def test_a_damaged_picture_ends_in_one_line(metapp: Callable, tmp_path: Path) -> None:
    bad = tmp_path / "bad.png"
    bad.write_bytes(b"\x89PNG\r\n\x1a\n nothing")
    result = metapp("meta", "svbrdf_nonstationary", bad, "--observe", "photo", "--out", tmp_path / "runs")
    assert result.code == 1
    assert "bad.png" in result.err
    assert "Traceback" not in result.err


def test_starts_of_both_protocols(metapp: Callable, tmp_path: Path) -> None:
    data, runs = tmp_path / "few", tmp_path / "runs"
    assert metapp("data", "synth", "svbrdf_nonstationary", "--count", "20", "--out", data).code == 0
    common = ("svbrdf_nonstationary", "--recipe", "quick", "--data", data, "--out", runs)
    for observe in ("reference", "photo"):
        for paradigm, steps in (("meta", "2"), ("quickft", "2")):
            result = metapp(paradigm, *common, "--observe", observe, "--train", "--train-steps", steps, "--json")
            assert result.code == 0, result.err
    (folder,) = (runs / "svbrdf_nonstationary" / "checkpoints").iterdir()
    names = {path.name.removesuffix(".safetensors") for path in folder.glob("*.safetensors")}
    rules = {observe: RECIPES[observe]["quick"].rule for observe in RECIPES}
    assert names == {"general", "quickft", "quickft-photo", rules["reference"], f"{rules['photo']}-photo"}
    result = metapp("evaluate", *common, "--format", "markdown")
    assert result.code == 0, result.err
    assert f"{APP} photo" in result.out
    assert "gap closed" in result.out
