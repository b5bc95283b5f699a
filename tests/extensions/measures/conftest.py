"""Each application, small, and weights of VGG-16 that are drawn."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from metapp.extensions.vgg.weights import weight_shapes
from tests.paradigms.conftest import app, judged, sources, tasks

__all__ = ["app", "judged", "sources", "tasks"]


@pytest.fixture(scope="session")
def drawn_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of VGG-16 by numpy's frozen generator."""
    rng, weights = np.random.RandomState(0), {}
    for key, shape in weight_shapes().items():
        drawn = rng.standard_normal(shape) * (2 / (shape[1] * 9)) ** 0.5 if key.endswith("weight") else None
        weights[key] = torch.full(shape, 0.05) if drawn is None else torch.from_numpy(drawn.astype("f"))
    path = tmp_path_factory.mktemp("drawn") / "vgg16.safetensors"
    save_file(weights, path)
    return path


@pytest.fixture
def drawn(drawn_weights: Path, cache: Path) -> None:
    (cache / "vgg16.safetensors").symlink_to(drawn_weights)
