"""Fits of BRDFs that tests of metapp's Mitsuba plugins load."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

MATERIAL_COUNT = 10  # synthetic materials, of which two are test tasks and are fitted


@pytest.fixture(scope="session")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files of fits of a bright synthetic material, by network: nbrdf and featured."""
    import metapp
    from tests.small_spheres import run_with_small_spheres

    folder = tmp_path_factory.mktemp("fits")
    run_with_small_spheres("data", "synth", "brdf", "--count", MATERIAL_COUNT, "--out", folder / "data")
    recipes = {"nbrdf": "quick", "featured": "full"}
    fits_by_network = {
        name: metapp.fit_all("brdf", data=folder / "data", recipe=recipe) for name, recipe in recipes.items()
    }
    # the material that is brightest in the median: where values are clamped at 0 there are no derivatives to compare
    brightest = [
        max(fits, key=lambda fit: float(fit.task.data["reflectance"].median())) for fits in fits_by_network.values()
    ]
    return {
        name: fit.save(folder / f"{name}.safetensors") for name, fit in zip(fits_by_network, brightest, strict=True)
    }


@pytest.fixture
def load_neural_bsdf(mi: Any, fits: dict[str, Path]) -> Callable[..., Any]:
    """Return a function that loads the plugin neural_brdf on the fit of a network, with further properties."""
    return lambda network, **more: mi.load_dict({"type": "neural_brdf", "filename": str(fits[network]), **more})
