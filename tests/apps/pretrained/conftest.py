"""Fixtures for the recipe of one photo: a small network, and small materials."""

from dataclasses import replace

import pytest

from data_tools.readers.svbrdf_task import make_svbrdf_task
from metapp.apps import app_of
from metapp.apps.svbrdf_nonstationary.coded_maps import field_of
from metapp.apps.svbrdf_nonstationary.pretrained.app import FromFeatures, MeanField
from metapp.apps.svbrdf_nonstationary.pretrained.recipe import PRETRAINED
from metapp.learning.app import stack_tasks
from metapp.learning.task import Tasks
from tests.apps.test_svbrdf_nonstationary import material

APP = "svbrdf_nonstationary"
SIDE = 32  # px of the maps
RECIPE = replace(PRETRAINED, app=FromFeatures(MeanField(*field_of(SIDE, 8))))


@pytest.fixture
def app() -> FromFeatures:
    small_app = app_of(APP, RECIPE, "photo")
    assert isinstance(small_app, FromFeatures)
    return small_app


@pytest.fixture
def tasks(app: FromFeatures) -> Tasks:
    return stack_tasks(app, [make_svbrdf_task(f"material-{seed}", material(seed, 2 * SIDE)) for seed in range(4)])
