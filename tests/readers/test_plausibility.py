"""Reflectance that no material has is said, in whatever form it comes; that of real ones is not."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers.brdf_task import normal_albedo
from data_tools.readers.merl import read_task, write_merl
from data_tools.readers.merl_table import SCALE, SHAPE
from data_tools.readers.nbrdf import SHAPES, write_nbrdf
from data_tools.readers.nbrdf import read_task as read_network


def constant_network(folder: Path, reflectance: float) -> Path:
    weights = {part: np.zeros(shape, dtype=np.float32) for part, shape in SHAPES.items()}
    write_nbrdf(folder, weights | {"b3": np.full(3, math.log1p(reflectance), dtype=np.float32)})
    return folder


@pytest.mark.parametrize(
    ("reflectance", "said"),
    [(0.0, "reflectance 0 everywhere"), (1.0, "3.14 times the light"), (1e30, "up to 1e+30 /sr")],
)
def test_conversions_and_fits_warn_once(metapp: Callable, tmp_path: Path, reflectance: float, said: str) -> None:
    folder = constant_network(tmp_path / "gold", reflectance)
    converted = metapp("data", "nbrdf", folder, "--out", tmp_path / "set", "--samples", "64", "--quiet")
    fitted = metapp("overfit", "brdf", folder, "--steps", "1", "--out", tmp_path / "runs", "--quiet")
    for result in (converted, fitted):
        assert result.code == 0
        (line,) = [line for line in result.err.splitlines() if "is it damaged" in line]
        assert line.startswith("warning: ")
        assert said in line
        assert "gold" in line


def test_a_diffuse_surface_is_not_warned_of(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_network(constant_network(tmp_path / "plaster", 0.25), samples=64)


def test_a_merl_file_of_absurd_values_is_warned_of(tmp_path: Path) -> None:
    write_merl(tmp_path / "gold.binary", 1e30 * np.broadcast_to(SCALE, (*SHAPE, 3)))
    with pytest.warns(UserWarning, match=r"gold.binary: reflectance of up to 1.11e\+27 /sr, expected at most 1e\+06"):
        read_task(tmp_path / "gold.binary", samples=64)


def test_the_albedo_of_a_diffuse_surface_is_that_of_its_colour() -> None:
    colour = torch.tensor([0.2, 0.5, 0.8])
    found = normal_albedo(lambda angles: (colour / math.pi).expand(*angles.shape[:-1], 3))
    assert found.tolist() == pytest.approx(colour.tolist(), rel=1e-4)


def test_a_network_that_varies_is_not_warned_of(neural_fits: Callable[[int], Path]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_network(neural_fits(1) / "m0", samples=64)
