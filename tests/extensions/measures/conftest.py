"""Small versions of each application, and random weights of VGG-16."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from metapp.extensions.vgg.weights import weight_shapes
from tests.paradigms.conftest import _second_scene_where_needed, app, sources, tasks

__all__ = ["_second_scene_where_needed", "app", "sources", "tasks"]


@pytest.fixture(scope="session")
def random_vgg_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of random weights of VGG-16, drawn by numpy's legacy generator, whose values never change."""
    rng, weights = np.random.RandomState(0), {}
    for key, shape in weight_shapes().items():
        values = rng.standard_normal(shape) * (2 / (shape[1] * 9)) ** 0.5 if key.endswith("weight") else None
        weights[key] = torch.full(shape, 0.05) if values is None else torch.from_numpy(values.astype("f"))
    path = tmp_path_factory.mktemp("drawn") / "vgg16.safetensors"
    save_file(weights, path)
    return path


@pytest.fixture
def random_vgg_in_cache(random_vgg_file: Path, cache: Path) -> None:
    """Link the random weights of VGG-16 into the test's cache."""
    (cache / "vgg16.safetensors").symlink_to(random_vgg_file)
