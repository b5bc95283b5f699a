"""Fits for the tests of Mitsuba's plugins."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SYNTHETIC = 10  # materials, two of them to be fitted


@pytest.fixture(scope="session")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files of fits of a material that conserves energy, by network: nbrdf and featured."""
    import metapp
    from tests.small_spheres import run_small

    folder = tmp_path_factory.mktemp("fits")
    run_small("data", "synth", "brdf", "--count", SYNTHETIC, "--out", folder / "data")
    recipes = {"nbrdf": "quick", "featured": "full"}
    made = {name: metapp.fit_all("brdf", data=folder / "data", recipe=recipe) for name, recipe in recipes.items()}
    # the one that is bright everywhere: at the clamp at 0 there are no derivatives to compare
    bright = [max(each, key=lambda fit: float(fit.task.data["reflectance"].median())) for each in made.values()]
    return {name: fit.save(folder / f"{name}.safetensors") for name, fit in zip(made, bright, strict=True)}


@pytest.fixture
def neural(mi: Any, fits: dict[str, Path]) -> Callable[..., Any]:
    """Loads the plugin on the fit of a network, with further properties."""
    return lambda network, **more: mi.load_dict({"type": "neural_brdf", "filename": str(fits[network]), **more})
