"""Fixtures for the recipe of one photo: random weights of VGG-16, a small network, and small materials."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Generator

from data_tools.readers.svbrdf_task import make_svbrdf_task
from metapp.appearance.features import VGG_BLOCKS
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.field_maps import field_of
from metapp.apps.svbrdf_nonstationary.pretrained.recipe import PRETRAINED, of_features
from metapp.learning.app import stack_tasks
from metapp.learning.task import Tasks
from tests.apps.test_svbrdf_nonstationary import material

APP = "svbrdf_nonstationary"
SIDE = 32  # px of the maps
RECIPE = replace(PRETRAINED, app=of_features(field_of(SIDE, 8)))


@pytest.fixture(scope="module")
def random_vgg_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of random weights of VGG-16 up to relu4_3."""
    rng, weights, inputs = Generator().manual_seed(2), {}, 3
    for i, outputs in enumerate([width for block in VGG_BLOCKS[:4] for width in block]):
        weights[f"conv{i}.weight"] = torch.randn(outputs, inputs, 3, 3, generator=rng) * (2 / (9 * inputs)) ** 0.5
        weights[f"conv{i}.bias"] = torch.zeros(outputs)
        inputs = outputs
    path = tmp_path_factory.mktemp("vgg") / "vgg16.safetensors"
    save_file(weights, path)
    return path


@pytest.fixture
def random_vgg_in_cache(random_vgg_file: Path, cache: Path) -> None:
    """Link the random weights of VGG-16 into the test's cache."""
    os.link(random_vgg_file, cache / random_vgg_file.name)


@pytest.fixture
def app() -> SvbrdfNonstationary:
    small_app = RECIPE.app
    assert isinstance(small_app, SvbrdfNonstationary)
    return small_app


@pytest.fixture
def tasks(app: SvbrdfNonstationary) -> Tasks:
    return stack_tasks(app, [make_svbrdf_task(f"material-{seed}", material(seed, 2 * SIDE)) for seed in range(4)])
