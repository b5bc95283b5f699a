"""`metapp ... transport` end to end, on scenes whose samples take no time."""

import functools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

from data_tools.synthetic.cornell import random_scene
from data_tools.synthetic.transport_task import make_transport_task
from metapp.appearance.pictures import TimedFit
from metapp.apps.transport import scene_renderer
from metapp.apps.transport.app import Transport
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.guide import make_guide_table
from metapp.apps.transport.path_fits import FlowDensity
from metapp.apps.transport.recipes import RECIPES
from metapp.extensions.scene_files import scene_reader
from metapp.learning.task import Params, Task
from metapp.rendering.paths import path_space
from tests.recipe_apps import app_by_recipe, presenter_of


@pytest.fixture(scope="module")
def box() -> Task:
    """A Cornell box of few samples."""
    return make_transport_task("box", random_scene(0), 0, samples=2048, held_out=512, batch_paths=2**16)


def uniform(app: Transport) -> Params:
    """The parameters that fits of it begin with: a uniform density."""
    return {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small network, a few steps, few paths."""
    app = Transport(FlowDensity(Flow(code=3, hidden=8, bins=4)), spp=64, reference_spp=16, shown_spp=4, overview_spp=1)
    monkeypatch.setitem(RECIPES, "quick", replace(RECIPES["quick"], samples=256, overfit_steps=30, app=app))
    monkeypatch.setattr(scene_renderer, "make_guide_table", functools.partial(make_guide_table, places=8, cells=8))


@pytest.mark.long
def test_pictures_are_judged_at_equal_paths_and_in_equal_time(box: Task) -> None:
    task, app = box, app_by_recipe("transport")
    presenter, theta = presenter_of(app), uniform(app)
    found = presenter.picture_errors({"instant": TimedFit(theta, 0.0), "endless": TimedFit(theta, 1e9)}, task)
    with_nee = [scene_renderer.REGULAR_NEE, *map(scene_renderer.row_title, scene_renderer.extension_integrators())]
    assert list(found) == ["reference", "regular", *with_nee, "instant", "endless"]
    assert set(found["reference"]) == {"MAPE"}
    measures = {"MAPE", "SMAPE", "DSSIM"}
    for name, picture in list(found.items())[1:]:
        assert set(picture) - {scene_renderer.EQUAL_TIME} == measures | {"PSNR", "time", scene_renderer.FIXED_TIME}
        assert all(0 < value < 2 for key, value in picture.items() if key in measures)
        # the start's density is uniform, as Regular's is: the same picture but for noise
        same = all(picture[key] == pytest.approx(found["regular"][key], rel=0.2) for key in measures)
        assert same != (name in with_nee), name
        assert picture["MAPE"] <= 1.2 * found["regular"]["MAPE"]
        assert picture["time"] > 0
    assert found["regular"][scene_renderer.EQUAL_TIME] == found["regular"]["MAPE"]
    assert scene_renderer.EQUAL_TIME not in found["endless"]
    assert found["endless"][scene_renderer.FIXED_TIME] > 1e6 * found["instant"][scene_renderer.FIXED_TIME] > 0
    assert presenter.picture_errors({"instant": TimedFit(theta, 0.0)}, task._replace(data={})) == {}


@pytest.mark.long
def test_pictures_with_nee_come_in_waves(box: Task) -> None:
    asked: list[tuple[int, int]] = []

    class Noted(scene_renderer.SceneRenderer):
        def _render(self, integrator: str, spp: int, seed: int) -> scene_renderer.TimedPicture:
            asked.append((spp, seed))
            return super()._render(integrator, spp, seed)

    scene = box.data["scene"].numpy().tobytes()
    studio = scene_renderer.SceneRenderer(scene, size=8)
    whole = studio.render_path(4096).picture
    assert torch.equal(whole, studio.render_path(4096).picture)
    waves = Noted(scene, size=8, wave_paths=1500 * 8 * 8).render_path(4096, seed=1).picture
    assert asked == [(1500, 65536), (1500, 65537), (1096, 65538)]
    parts = sum(spp / 4096 * studio._render("path", spp, seed).picture for spp, seed in asked)
    torch.testing.assert_close(waves, parts)
    assert float(waves.mean()) == pytest.approx(float(whole.mean()), rel=0.01)
    assert not torch.equal(waves, whole)


@pytest.mark.long
def test_equal_time_counts_the_samples_that_a_fit_sees(box: Task) -> None:
    app, sampled = app_by_recipe("transport"), []

    class Slow(scene_renderer.SceneRenderer):
        def time_sampling(self, samples: torch.Tensor) -> float:
            sampled.append(tuple(samples.shape))
            return 1e9

    studio = Slow(box.data["scene"].numpy().tobytes(), size=64, spp=64, reference_spp=16)
    found = scene_renderer.picture_errors(studio, app.decoder.network, {"instant": TimedFit(uniform(app), 0.0)}, box)
    assert sampled == [(2048, 4)]  # what fits may see, without what is held out
    assert scene_renderer.EQUAL_TIME not in found["instant"]
    assert found["instant"][scene_renderer.FIXED_TIME] > 1e6
    assert found["regular"][scene_renderer.FIXED_TIME] == 0


@pytest.mark.long
def test_a_reference_knows_its_own_error(box: Task) -> None:
    studio = scene_renderer.SceneRenderer(
        box.data["scene"].numpy().tobytes(), size=8, reference_spp=scene_renderer.REFERENCE_SPP // 4
    )
    stated_error, expected = (
        studio.reference_error,
        path_space.render_reference(studio.tracer, 8, 4 * scene_renderer.REFERENCE_SPP, seed=9),
    )
    found = float(scene_renderer.mape(studio.reference[None], expected[None]))
    assert found == pytest.approx(stated_error, rel=0.3)  # as far from the truth as its halves say
    assert studio.time_sampling(box.data["samples"]) > 0


@pytest.mark.long
@pytest.mark.usefixtures("few_paths")
def test_a_scene_with_a_point_light_alone_is_fitted(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_reader.read_task, "__defaults__", (512, 128, ()))  # samples, held_out, roots
    box = {key: value for key, value in random_scene(0).items() if key != "light"}
    box["bulb"] = {"type": "point", "position": [0.0, 0.7, 0.0]}
    box["fog"] = {"type": "homogeneous"}  # which nothing refers to
    Path("bulb.json").write_text(json.dumps(box))
    result = metapp("overfit", "transport", "bulb.json", "--json")
    note = result.json_result["tasks"][0]["note"]
    assert "next-event estimation" in note
    assert result.err.count(f"bulb: {note}") == 1
    assert np.isfinite(result.json_result["error"])
    output_folder = Path(result.json_result["out"])
    assert json.loads((output_folder / "bulb" / "record.json").read_text())["note"] == note
    guided, regular = (
        oiio.ImageBuf(str(output_folder / "bulb" / f"{name}.exr")).get_pixels() for name in ("guided", "regular")
    )
    assert float(np.mean(guided)) == pytest.approx(float(np.mean(regular)), rel=0.2)
