"""Fits for the tests of Mitsuba's plugins."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file
from torch import Generator

from metapp.apps.brdf.few import Few

SYNTHETIC = 10  # materials, two of them to be fitted


@pytest.fixture(scope="session")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files of fits of a material that conserves energy, by network: nbrdf and featured; `few` is random."""
    import metapp
    from tests.small_spheres import run_small

    folder = tmp_path_factory.mktemp("fits")
    run_small("data", "synth", "brdf", "--count", SYNTHETIC, "--out", folder / "data")
    recipes = {"nbrdf": "quick", "featured": "full"}
    made = {name: metapp.fit_all("brdf", data=folder / "data", recipe=recipe) for name, recipe in recipes.items()}
    # the one that is bright everywhere: at the clamp at 0 there are no derivatives to compare
    bright = [max(each, key=lambda fit: float(fit.task.data["reflectance"].median())) for each in made.values()]
    files = {name: fit.save(folder / f"{name}.safetensors") for name, fit in zip(made, bright, strict=True)}
    theta = {key: value[0].clone() for key, value in Few().init(Generator().manual_seed(0), 1).items()}
    theta["last"][0] = 0.3 * torch.randn(theta["last"].shape[1], generator=Generator().manual_seed(1))
    save_file(theta, folder / "few.safetensors")
    return files | {"few": folder / "few.safetensors"}


@pytest.fixture
def neural(mi: Any, fits: dict[str, Path]) -> Callable[..., Any]:
    """Loads the plugin on the fit of a network, with further properties."""
    return lambda network, **more: mi.load_dict({"type": "neural_brdf", "filename": str(fits[network]), **more})
