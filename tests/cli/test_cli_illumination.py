"""`metapp ... illumination` end to end, on maps and on photographs of spheres, at a size that takes no time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

from data_tools.readers.latlong import read_map
from metapp.appearance.latlong import directions, mean_luminance
from metapp.appearance.photograph import photograph
from metapp.apps.illumination import IlluminationSetup
from metapp.apps.illumination.recipes import RECIPES
from metapp.networks.field import LocalField

pytestmark = pytest.mark.usefixtures("scene")


def lamp() -> torch.Tensor:
    """A map [3, 32, 64] of mean luminance 5 with one lamp."""
    light = 0.2 + (20 * (directions(32, 64)[1] - 0.9)).exp() * torch.tensor([1.0, 0.8, 0.6])[:, None, None]
    return 5 * light / mean_luminance(light)


def write(path: Path, planes: torch.Tensor) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    oiio.ImageBuf(np.ascontiguousarray(planes.permute(1, 2, 0).numpy())).write(str(path))
    return path


@pytest.fixture
def exr(tmp_path: Path) -> Path:
    return write(tmp_path / "in" / "room.exr", lamp())


@pytest.fixture
def png(tmp_path: Path) -> Path:
    (photo,) = photograph(lamp()[None], torch.Generator().manual_seed(0))
    return write(tmp_path / "in" / "ball.png", (255 * photo).to(torch.uint8))


@pytest.fixture(autouse=True)
def small(short_by_protocol: Callable) -> None:
    """Other sizes and a few steps."""
    quick = LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2)
    short_by_protocol(RECIPES, IlluminationSetup(quick), IlluminationSetup(quick._replace(height=16, width=32)))


def test_a_map_is_fitted_and_written(metapp: Callable, exr: Path, tmp_path: Path) -> None:
    result = metapp("overfit", "illumination", exr, "--out", tmp_path / "runs", "--json")
    assert result.code == 0, result.err
    document = result.document
    assert (document["observe"], document["tasks"][0]["name"]) == ("reference", "room")
    assert "-full-" in document["out"]
    assert 0 < document["error"] < 100
    made = Path(document["out"]) / "outputs" / "room"
    assert {path.name for path in made.iterdir()} == {"map.exr", "map.png", "relit.png"}
    written = read_map(_enlarged(made / "map.exr"), 8)
    wanted = read_map(exr, 8)
    assert float(mean_luminance(written)) == pytest.approx(float(mean_luminance(wanted)), rel=0.5)


def _enlarged(path: Path) -> Path:
    """The same map with four times the rows, as readers refuse maps of so few."""
    image = oiio.ImageBuf(str(path))
    pixels = np.asarray(image.get_pixels(oiio.FLOAT)).repeat(4, 0).repeat(4, 1)
    return write(path.with_name("large.exr"), torch.from_numpy(pixels).permute(2, 0, 1))


def test_a_photo_is_fitted_without_a_reference(metapp: Callable, png: Path, tmp_path: Path) -> None:
    result = metapp("overfit", "illumination", png, "--observe", "photo", "--out", tmp_path / "runs", "--json")
    assert result.code == 0, result.err
    document = result.document
    assert document["observe"] == "photo"
    assert document["error"] is None
    assert document["tasks"][0]["error"] is None
    made = Path(document["out"]) / "outputs" / "ball"
    assert {path.name for path in made.iterdir()} == {"map.exr", "map.png", "relit.png"}
    written = read_map(_enlarged(made / "map.exr"), 8)
    assert float(mean_luminance(written)) == pytest.approx(1, rel=0.01)
    assert (Path(document["out"]) / "pictures.png").is_file()


def test_a_photo_needs_its_protocol(metapp: Callable, png: Path, tmp_path: Path) -> None:
    result = metapp("overfit", "illumination", png, "--out", tmp_path / "runs")
    assert result.code == 1
    assert "ball: a photo of a sphere, expected an HDR map where fits see the map itself; give an" in result.err
    assert len(result.err.strip().splitlines()) <= 2


def test_a_photo_among_maps_is_found_before_the_first_fit(
    metapp: Callable, exr: Path, png: Path, tmp_path: Path
) -> None:
    result = metapp("overfit", "illumination", exr, png, "--out", tmp_path / "runs")
    assert result.code == 1
    assert "ball: a photo of a sphere" in result.err
    assert not list((tmp_path / "runs").rglob("record.jsonl")) or not any(
        path.read_text().strip() for path in (tmp_path / "runs").rglob("record.jsonl")
    )


def test_a_folder_of_maps_and_photos(metapp: Callable, exr: Path, png: Path, tmp_path: Path) -> None:
    arguments = ("overfit", "illumination", exr.parent, "--observe", "photo", "--out", tmp_path / "runs", "--json")
    document = metapp(*arguments).document
    errors = {task["name"]: task["error"] for task in document["tasks"]}
    assert errors["ball"] is None
    assert document["error"] == pytest.approx(errors["room"])


@pytest.mark.parametrize("kind", ["nan", "square", "negative"])
def test_bad_maps_end_in_one_line(kind: str, metapp: Callable, tmp_path: Path) -> None:
    light = lamp()
    if kind == "nan":
        light[0, 3, 4] = np.nan
    elif kind == "negative":
        light[:, :16] *= -1
    else:
        light = light[:, :, :32]
    result = metapp("meta", "illumination", write(tmp_path / "bad.exr", light), "--out", tmp_path / "runs")
    assert result.code == 1
    assert "bad.exr" in result.err
    assert "Traceback" not in result.err


def test_starts_of_both_protocols(metapp: Callable, tmp_path: Path) -> None:
    data, runs = tmp_path / "few", tmp_path / "runs"
    assert metapp("data", "synth", "illumination", "--count", "20", "--out", data).code == 0
    common = ("illumination", "--recipe", "quick", "--data", data, "--out", runs)
    for observe in ("reference", "photo"):
        result = metapp("meta", *common, "--observe", observe, "--train", "--json")
        assert result.code == 0, result.err
        result = metapp("quickft", *common, "--observe", observe, "--train", "--train-steps", "2", "--json")
        assert result.code == 0, result.err
    (folder,) = (runs / "illumination" / "checkpoints").iterdir()
    rules = {observe: RECIPES[observe]["quick"].rule for observe in ("reference", "photo")}
    names = {path.name.removesuffix(".safetensors") for path in folder.glob("*.safetensors")}
    assert names == {"general", "quickft", "quickft-photo", rules["reference"], f"{rules['photo']}-photo"}
    result = metapp("evaluate", *common, "--format", "markdown")
    assert result.code == 0, result.err
    assert "illumination photo" in result.out
    assert "gap closed" in result.out
    assert "is no floor" in result.out


def test_the_second_scene_is_built_once(metapp: Callable, scene: Path) -> None:
    document = metapp("data", "scene", "--json").document
    assert document["there_already"]
    assert Path(document["path"]).parent == scene
    assert document["bytes"] > 4e7
