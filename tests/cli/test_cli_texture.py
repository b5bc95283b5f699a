"""`metapp ... texture` and `metapp ... svbrdf_stationary` end to end, at random filters instead of VGG's."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import OpenImageIO as oiio
import pytest
import torch
from safetensors.torch import load_file, save_file

from data_tools.readers.material_maps import read_task
from metapp.appearance import features
from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.features import vgg_weights_path
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.svbrdf_stationary.app import compose_svbrdf
from metapp.apps.texture.app import compose_texture
from metapp.entries import load_reference
from metapp.learning.task import Task
from metapp.networks.generators import UNet
from metapp.runs.stored_fits import read_fits
from tests.appearance.test_features import random_weights
from tests.cli.messages import says
from tests.pictures import write_noise_photo
from tests.recipe_apps import app_by_recipe, asset_of

APPS = ("texture", "svbrdf_stationary")
OUTPUTS = {
    "texture": {"texture"},
    "svbrdf_stationary": {
        *("diffuse", "specular", "roughness", "normal", "height"),
        *("lit_from_left", "lit_from_above", "lit_from_aside"),
    },
}


def size_of(file: Path) -> tuple[int, int]:
    spec = oiio.ImageBuf(str(file)).spec()
    return spec.height, spec.width


@pytest.fixture
def wall() -> Path:
    return write_noise_photo(Path("wall.png"), 9, 40)


@pytest.fixture(params=APPS)
def app(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The applications, at a size that takes no time, with a search of two looks."""
    recipes = load_reference(f"metapp.apps.{request.param}.recipes:RECIPES")
    quick = recipes["quick"]
    network = UNet(4, levels=2, noise=2, code=4, outputs=quick.app.decoder.network.outputs)
    compose = compose_texture if request.param == "texture" else compose_svbrdf
    app = compose(network, Octaves(16, 16, ("relu1_1", "relu2_1")))
    shortened = {name: replace(training, steps=2, tasks=2, warmup_steps=0) for name, training in quick.meta.items()}
    general = replace(quick.general, steps=2, tasks=2)
    search = ([{"rate": 0.5}], [{"beta1": 0.3}])
    quick = replace(quick, app=app, steps=3, overfit_steps=3, general=general, meta=shortened, search=search)
    monkeypatch.setitem(recipes, "quick", quick)
    monkeypatch.setitem(recipes, "full", quick)
    return request.param


@pytest.fixture
def data(app: str, metapp: Callable) -> str:
    for i in range(6):
        write_noise_photo(Path(f"in/p{i}.png"), i, 40)
    command = "images" if app == "texture" else "flash"
    assert metapp("data", command, "in", "--out", "data", "--size", "32").code == 0
    return "data"


def test_photos_are_fitted_and_the_results_written(app: str, data: str, metapp: Callable, wall: Path) -> None:
    common = ("--data", data, "--rule", "meta-sgd", "--json")
    assert metapp("meta", app, *common, "--train").json_result
    (checkpoint,) = Path("runs", app, "checkpoints").iterdir()
    trained = ("--checkpoint", checkpoint, "--steps", "2")
    document = metapp("meta", app, wall, *common, *trained, "--export", "asset").json_result
    assert [task["name"] for task in document["tasks"]] == ["wall"]
    assert "random filters" in document["features"]
    output_folder = Path(document["out"]) / "wall"
    assert {file.stem for file in output_folder.iterdir()} == OUTPUTS[app] | {"params", "record", "asset"}
    assert {size_of(file) for file in output_folder.glob("*.png")} == {(64, 64)}  # four times the training's
    assert {str(oiio.ImageBuf(str(file)).spec().format) for file in output_folder.glob("*.png")} == {"uint8"}
    assert Path(document["out"], "pictures.png").is_file()
    description = json.loads((output_folder / "asset" / "wall" / "material.json").read_text(encoding="utf-8"))
    assert (description["tiles"], description["size"]["width"]) == (True, 64)
    assert (description["provenance"]["app"], description["provenance"]["steps"]) == (app, 2)
    assert len(description["files"]) == {"texture": 1, "svbrdf_stationary": 10}[app]


@pytest.mark.usefixtures("with_bfloat16")
def test_fits_in_bfloat16_are_runs_of_their_own(
    app: str, metapp: Callable, wall: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fit(out: str) -> Path:
        return Path(metapp("overfit", app, wall, "--out", out, "--json", "--quiet").json_document["out"])

    short_app = fit("short")
    with monkeypatch.context() as patch:
        patch.setenv(features.FLOAT32_VARIABLE, "1")
        long = fit("long")
    (one,), (other,) = (read_fits(run) for run in (short_app, long))
    if app == "svbrdf_stationary":  # whose fits gain less by it
        assert (one.settings, one.error) == (other.settings, other.error)
        return
    assert one.spec.conditions == other.spec.conditions | {"precision": "VGG in bfloat16"}
    assert one.error is not None
    assert other.error is not None
    assert 0 < abs(one.error - other.error) < 0.01 * other.error


def test_files_are_written_in_the_size_asked_for(app: str, data: str, metapp: Callable, wall: Path) -> None:
    common = ("overfit", app, wall, "--data", data, "--json")
    run = Path(metapp(*common, "--size", "32x48", "--export", "png16").json_result["out"])
    files = [*(run / "wall").glob("*.png"), *(run / "wall" / "png16").rglob("*.png")]
    assert {"wall", "wall/png16/wall"} == {str(file.relative_to(run).parent) for file in files}
    assert {size_of(file) for file in files} == {(32, 48)}
    assert says(metapp(*common, "--size", "33x48").misuse, "--size 33x48", app, "multiples")


@pytest.mark.parametrize("app", ["svbrdf_stationary"], indirect=True)
def test_maps_come_back_from_their_files(app: str, data: str, metapp: Callable, wall: Path) -> None:
    run = Path(metapp("overfit", app, wall, "--data", data, "--json").json_result["out"])
    result, theta = run / "wall", load_file(run / "wall" / "params.safetensors")
    files = asset_of(app_by_recipe(app), theta, Task("wall", {})).pictures()
    expected = {name: torch.movedim(buffer.pixels, -1, 0) for name, buffer in files.items()}
    found = unpack_maps(read_task(result / "diffuse.png", 64).data["maps"].float()[None])
    for name, space in (("diffuse", srgb_to_linear), ("specular", srgb_to_linear), ("roughness", torch.clone)):
        side_by_side = getattr(found, name)[0], space(expected[name]).expand_as(getattr(found, name)[0])
        torch.testing.assert_close(*side_by_side, rtol=0, atol=0.006)  # 8 bits
    texts = {file.stem: oiio.ImageBuf(str(file)).spec() for file in result.glob("*.png")}
    linear = {name for name, spec in texts.items() if spec["encoding"] == "linear"}
    assert linear == {"roughness", "normal", "height"}
    assert all(spec["encoding"] == "sRGB" for name, spec in texts.items() if name not in linear)
    # the height in texels, and the normals that follow from it
    low, high = (float(texts["height"][f"height_{end}"]) for end in ("minimum", "maximum"))
    assert texts["height"]["height_unit"] == "texels"
    height = torch.from_numpy(oiio.ImageBuf(str(result / "height.png")).get_pixels(oiio.FLOAT)).movedim(-1, 0)
    height = low + height * (high - low)
    torch.testing.assert_close(height, expected["height"], rtol=0, atol=(high - low) / 509)
    torch.testing.assert_close(normal_from_height(height[None])[0], expected["normal"] * 2 - 1, rtol=0, atol=0.05)


def test_other_features_than_the_encoder_reads_are_refused(app: str, data: str, metapp: Callable) -> None:
    common = (app, "--data", data)
    assert metapp("meta", *common, "--rule", "meta-sgd", "--train", "--quiet").code == 0
    save_file(random_weights(), vgg_weights_path())
    (checkpoint,) = Path("runs", app, "checkpoints").iterdir()
    assert "random filters" in metapp("general", *common, "--checkpoint", checkpoint).refusal
    meta = metapp("meta", *common, "--rule", "meta-sgd", "--quiet", "--checkpoint", checkpoint)
    assert meta.code == 0
    assert says(meta.err, "warning: meta-sgd of", "random filters")


@pytest.mark.parametrize("app", APPS)
def test_missing_weights_are_said_before_the_features_that_checkpoints_need(app: str, metapp: Callable) -> None:
    refusal = metapp("general", app, write_noise_photo(Path("wall.png"), 9, 40)).refusal
    assert says(
        refusal, "weights of VGG-16 are missing", "metapp data vgg", "expected VGG-16 features", "full.safetensors"
    )
    assert refusal.index("metapp data vgg") < refusal.index("expected")
