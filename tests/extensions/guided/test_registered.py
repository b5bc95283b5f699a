"""Registry entries of path guiding: the integrator, its row in tables of pictures, and `--render`."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

from data_tools.synthetic.cornell import random_scene
from data_tools.synthetic.examples import write_example
from metapp.apps.transport.app import Transport
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.path_fits import FlowDensity
from metapp.apps.transport.recipes import RECIPES
from metapp.apps.transport.scene_renderer import REGULAR, REGULAR_NEE
from metapp.learning.task import Task
from metapp.rendering.scenes.stored_text import encode_scene
from tests.needs_mitsuba import needs_mitsuba
from tests.recipe_apps import presenter_of

FLOW = Flow(rows=4, columns=4, code=3, hidden=8, bins=5, film_bins=8, blobs=6)


def task_of(seed: int) -> Task:
    return Task("room", {"samples": torch.rand(500, 4), "scene": encode_scene(random_scene(seed))})


@pytest.mark.long
@needs_mitsuba
def test_integrator_has_a_row_in_the_table_of_pictures() -> None:
    presenter, task = presenter_of(Transport(FlowDensity(FLOW), picture=16, spp=64, reference_spp=64)), task_of(0)
    assert list(presenter.picture_errors({}, task)) == ["reference", REGULAR, REGULAR_NEE, "guided_path + NEE"]


@pytest.mark.usefixtures("few_paths")
@needs_mitsuba
def test_a_scene_is_rendered_with_and_without_a_guide_in_the_same_time(
    metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    full = RECIPES["full"]
    monkeypatch.setitem(RECIPES, "full", replace(full, app=replace(full.app, shown_spp=4, overview_spp=1)))
    (box,) = write_example("transport", Path())
    result = metapp("overfit", "transport", box, "--steps", "2", "--render", "24")
    assert result.code == 0, result.err
    (folder,) = Path("runs").rglob("overfit*/box")
    results = [oiio.ImageBuf(str(folder / f"{name}.exr")).get_pixels() for name in ("guided_path", "regular_nee")]
    assert {picture.shape for picture in results} == {(24, 24, 3)}
    assert np.mean(results[0]) == pytest.approx(np.mean(results[1]), rel=0.2)
    assert (folder / "guided_path.png").is_file()
    assert "guided_path: 64 samples a pixel in" in result.err
    assert "regular_nee: " in result.err
