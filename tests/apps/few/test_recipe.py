"""The recipe of few samples: which inputs choose it, what it fits, and goniometer tables that choose others."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import metapp as api
from data_tools.readers import gonio
from data_tools.readers.measured_pairs import MeasuredPairs
from metapp.apps.brdf.few.gaussian_model import FEW_NETWORK
from tests.anisotropic import measure_with_noise

pytestmark = pytest.mark.usefixtures("small_spheres")


def table(file: Path, pairs: MeasuredPairs) -> Path:
    """A goniometer's table of measurements."""
    gonio.write_pairs(file, pairs.wi[:0], pairs.wo[:0], pairs)
    return file


def test_up_to_a_thousand_samples_in_memory_are_all_fitted() -> None:
    rng = np.random.default_rng(0)
    wi, wo = (
        np.abs(vectors) / np.linalg.norm(vectors, axis=1, keepdims=True) for vectors in rng.normal(size=(2, 1200, 3))
    )
    known = torch.tensor([0.2, 0.4, 0.6]) / np.pi
    values = known.expand(1200, 3).numpy()
    many, *some = (api.fit("brdf", (wi[:count], wo[:count], values[:count])) for count in (1200, 20, 4))
    assert many.app.network != FEW_NETWORK
    assert all(fit.app.network == FEW_NETWORK for fit in some)
    angles = many.task.data["angles"]
    assert float((some[0].app.reflectance(some[0].parameters, angles) - known).abs().median()) < 0.01


def test_tables_that_depend_on_phi_h_choose_the_anisotropic_recipe(metapp: Callable, tmp_path: Path) -> None:
    file, plain = (table(tmp_path / f"{name}.csv", pairs) for name, pairs in (
        ("brushed", measure_with_noise(4000)), ("plain", measure_with_noise(500, anisotropic=False))))  # fmt: skip
    facts = {source.name: source.facts for source in gonio.find(tmp_path)[0]}
    assert facts == {"brushed": {"anisotropic": True, "samples": 4000}, "plain": {"anisotropic": False, "samples": 500}}
    fitted = metapp("meta", "brdf", file, "--out", tmp_path / "runs", "--json")
    assert "recipe anisotropic, as the input has reflectance that depends on phi_h" in fitted.err
    isotropic = metapp("meta", "brdf", file, "--out", tmp_path / "runs", "--json", "--recipe", "full")
    assert fitted.json_result["error"] < 0.7 * isotropic.json_result["error"]
    assert "fitted as isotropic: phi_h is left out" in isotropic.err
    general = metapp("general", "brdf", file, "--out", tmp_path / "runs", "--json")  # has no checkpoint for it
    assert "phi_h is left out" in general.err
    assert general.json_result["error"] > fitted.json_result["error"]
    both = metapp("meta", "brdf", file, plain, "--out", tmp_path / "runs", "--json")  # each by its own recipe
    brushed, other = both.json_document["tasks"]
    assert brushed["error"] == fitted.json_result["error"]
    alone = metapp("meta", "brdf", plain, "--out", tmp_path / "runs", "--json")
    assert other["error"] == alone.json_result["error"]
