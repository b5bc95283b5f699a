"""Properties of the pictures of every application: previews, files with a kind each, measures of pictures."""

import math
from typing import Any

import pytest
import torch

from metapp.appearance.picture_measures import measure_pictures
from metapp.appearance.pictures import PICTURE_KINDS, TimedFit
from metapp.appearance.presenter import Presenter
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms.methods import fit_tasks, make_method
from metapp.storage.files import file_name
from tests.paradigms.small import seeded_generator
from tests.recipe_apps import application, asset_of, observations_of, presenter_of, recipes_of

pytestmark = pytest.mark.usefixtures("small_spheres")  # as in the tasks


@pytest.fixture
def presenter(app: App) -> Presenter[Any]:
    return presenter_of(app)


@pytest.fixture
def fitted_parameters(app: App, recipe: Recipe, tasks: Tasks) -> Params:
    """The parameters of the first task after a few steps, as a run keeps them: without a task axis."""
    method = make_method("overfit", app, recipe, MetaParameters(), steps=3)
    theta = fit_tasks(method, tasks.select([0]), seeded_generator())
    return {key: value[0] for key, value in theta.items()}


def test_an_application_has_the_protocol_that_it_is_made_for(app: App) -> None:
    for protocol in observations_of(app.name):
        for recipe in recipes_of(app.name, protocol).values():
            assert recipe.observes == protocol


def test_titles_and_measures_of_tables_are_single_lines(
    app: App, presenter: Presenter[Any], sources: list[Task]
) -> None:
    """The amount of data that a fit may see is positive."""
    for line in (presenter.title, app.error_measure.text):
        assert line
        assert line == " ".join(line.split())
    assert presenter.picture_measure == " ".join(presenter.picture_measure.split())
    visible = app.sight.describe_visible(sources[0])
    if visible:
        assert visible.sample_count >= 1
        assert visible.sample_bytes > 0
        assert visible.encoder_samples >= 0


def test_pictures_of_a_fit_and_of_its_reference(
    presenter: Presenter[Any], fitted_parameters: Params, sources: list[Task]
) -> None:
    pictures = presenter.preview(fitted_parameters, sources[0])
    assert list(pictures)[:2] == ["reference", "fit"]
    assert pictures["fit"].shape == pictures["reference"].shape
    for name, picture in pictures.items():
        assert picture.ndim == 3, name
        assert picture.shape[2] in (3, 4), name
        assert picture.dtype == torch.float32, name
        assert picture.isfinite().all(), name
        assert not picture.requires_grad, name
    again = presenter.preview(fitted_parameters, sources[0])
    assert all(torch.equal(again[name], picture) for name, picture in pictures.items())
    other = presenter.preview(fitted_parameters, sources[1])
    assert not torch.equal(other["reference"], pictures["reference"])


def test_tiles_of_a_run_are_named_linear_pictures(
    presenter: Presenter[Any], fitted_parameters: Params, sources: list[Task]
) -> None:
    tiles = presenter.tiles(fitted_parameters, sources[0])
    assert {"reference", "photo", "map"} & tiles.keys()
    for name, tile in tiles.items():
        assert name.startswith("reference") <= (name == "reference" or name.removeprefix("reference ") in tiles)
        assert (tile.ndim, tile.shape[2] in (3, 4), tile.dtype) == (3, True, torch.float32), name
        assert tile.isfinite().all(), name
    assert presenter.photo_comparison(fitted_parameters, sources[0]) is None


def test_files_are_what_their_kind_says(app: App, fitted_parameters: Params, sources: list[Task]) -> None:
    """Their names suit every file system, also those that ignore case."""
    asset = asset_of(app, fitted_parameters, sources[0])
    assert asset.kind in application(app.name).assets
    pictures = asset.pictures()
    for name, (pixels, kind) in pictures.items():
        assert kind in PICTURE_KINDS, name
        assert pixels.ndim == 3, name
        assert pixels.shape[2] in {"srgb": (1, 3), "data": (1, 3), "height": (1,), "radiance": (3,)}[kind], name
        assert pixels.isfinite().all(), name
        if kind != "height":
            assert 0 <= float(pixels.min()) <= float(pixels.max()) <= (math.inf if kind == "radiance" else 1), name
        assert not pixels.requires_grad, name
        assert name.replace("_", "").isalnum(), name
        assert name.isascii(), name
        assert name == file_name(name) == name.lower(), name
    again = asset_of(app, fitted_parameters, sources[0]).pictures()
    assert all(torch.equal(again[name].pixels, picture.pixels) for name, picture in pictures.items())


def test_picture_measures_are_described_where_there_are_any(
    presenter: Presenter[Any], fitted_parameters: Params, sources: list[Task]
) -> None:
    measured = measure_pictures(presenter, {"meta": TimedFit(fitted_parameters, 0.1)}, sources[0])
    assert presenter.picture_measure or not measured
    for name, measures in measured.items():
        assert measures, name
        assert all(math.isfinite(value) for value in measures.values()), name
        assert all(-1 <= value <= 1 for key, value in measures.items() if key.startswith("SSIM")), name
