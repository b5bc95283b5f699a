"""Made-up weights of VGG-16, and materials small enough to fit."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Generator

from data_tools.readers.svbrdf_task import make_svbrdf_task
from metapp.appearance.features import VGG_BLOCKS
from metapp.apps import app_of
from metapp.apps.svbrdf_nonstationary.coded_maps import field_of
from metapp.apps.svbrdf_nonstationary.pretrained.app import FromFeatures, MeanField
from metapp.apps.svbrdf_nonstationary.pretrained.recipe import PRETRAINED
from metapp.learning.app import stack_tasks
from metapp.learning.task import Tasks
from tests.apps.test_svbrdf_nonstationary import material

APP = "svbrdf_nonstationary"
SIDE = 32
RECIPE = replace(PRETRAINED, app=FromFeatures(MeanField(*field_of(SIDE, 8))))


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random weights of VGG-16 up to relu4_3."""
    rng, weights, inputs = Generator().manual_seed(2), {}, 3
    for i, outputs in enumerate([width for block in VGG_BLOCKS[:4] for width in block]):
        weights[f"conv{i}.weight"] = torch.randn(outputs, inputs, 3, 3, generator=rng) * (2 / (9 * inputs)) ** 0.5
        weights[f"conv{i}.bias"] = torch.zeros(outputs)
        inputs = outputs
    path = tmp_path_factory.mktemp("vgg") / "vgg16.safetensors"
    save_file(weights, path)
    return path


@pytest.fixture
def weights(made_up: Path, cache: Path) -> None:
    os.link(made_up, cache / made_up.name)


@pytest.fixture
def app() -> FromFeatures:
    found = app_of(APP, RECIPE, "photo")
    assert isinstance(found, FromFeatures)
    return found


@pytest.fixture
def tasks(app: FromFeatures) -> Tasks:
    return stack_tasks(app, [make_svbrdf_task(f"material-{seed}", material(seed, 2 * SIDE)) for seed in range(4)])
