"""One BRDF everywhere: what the page's shader evaluates is `fit(wi, wo)`, and its reference the material."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize

from metapp.appearance.geometry import directions_to_four_angles, rusinkiewicz_to_directions
from metapp.extensions.viewer.page import Shown
from metapp.extensions.viewer.view import view_of
from tests.extensions.viewer.test_brdf_page import APPS, lobe, material, open_page, theta_of, views

COUNT = 4096
SHADER = "([column, pairs, which]) => metapp.viewer.evaluate(column, pairs)[which]"


def pairs() -> tuple[Tensor, Tensor]:
    """Lights and viewers [N, 3], float64: random, along the surface, mirrored, in one plane, at the normal."""
    rng = Generator().manual_seed(2)
    wi, wo = torch.randn(2, COUNT, 3, generator=rng, dtype=torch.float64).unbind()
    for each in (wi, wo):
        each[:, 2] = each[:, 2].abs() + 1e-3
    wi[:512, 2] *= 0.01
    wo[256:768, 2] *= 0.01
    wo[768:1280] = wi[768:1280] * torch.tensor([-1, -1, 1]) + 0.01 * torch.randn(512, 3, generator=rng)
    plane = torch.randn(512, 1, generator=rng) * wi[1280:1792, :2]  # beside phi_d = 0 and pi, on either side
    wo[1280:1792, :2] = plane + 1e-4 * torch.randn(512, 2, generator=rng)
    wo[1792:1856] = wi[1792:1856]
    wi[1856:1920] = wi.new_tensor([0, 0, 1])
    wo[1888:1952] = wo.new_tensor([0, 0, 1])
    wo[1952:2016] = wi[1952:2016] * torch.tensor([-1, -1, 1])  # the half vector is the normal
    for each in (wi, wo):
        each[:, 2] = each[:, 2].abs() + 1e-3
    return normalize(wi, dim=1), normalize(wo, dim=1)


def error(found: Tensor, wanted: Tensor) -> float:
    """The largest difference relative to the larger of 1 / sr and the value."""
    return float(((found.double() - wanted.double()).abs() / wanted.double().abs().clamp_min(1)).max())


@pytest.mark.long
def test_the_shader_evaluates_what_python_does(browser: Any, tmp_path: Path) -> None:
    """To 1e-3 of each kind of network, all round phi_d; without a reference there is none of its own."""
    page = open_page(browser, tmp_path, views(*APPS))
    wi, wo = pairs()
    directions = torch.stack([wi, wo], 1).tolist()
    azimuth = torch.linalg.vector_norm((wi + wo)[:, :2], dim=1) > 1e-4  # else numbers of 32 bits hardly tell it
    for column, (name, app) in enumerate(APPS.items()):
        wanted = app.reflectance(theta_of(name), directions_to_four_angles(wi, wo).float())
        for which in (0, 1):
            found = torch.tensor(page.page.evaluate(SHADER, [column, directions, which]))
            told = azimuth | (not app.network.anisotropic)
            assert error(found[told], wanted[told]) < 1e-3, name
            assert found.isfinite().all()
        assert float(wanted.amax()) > 0.1
    exchanged = APPS["nbrdf"].reflectance(theta_of("nbrdf"), directions_to_four_angles(wo, wi).float())
    here = APPS["nbrdf"].reflectance(theta_of("nbrdf"), directions_to_four_angles(wi, wo).float())
    assert error(here, exchanged) > 0.01  # the network tells light from viewer, so a fold would be seen
    assert not page.problems


@pytest.mark.long
def test_the_reference_is_the_material_whatever_the_fit(browser: Any, tmp_path: Path) -> None:
    """Of a fit that is not reciprocal, and of one that is, which has a smaller grid; up to interpolation."""
    black = {key: torch.zeros_like(value) for key, value in theta_of("nbrdf").items()}
    reciprocal = Shown("black", "", view_of(APPS["nbrdf"], black, material()))
    page, rng = open_page(browser, tmp_path, [*views("nbrdf", task=material()), reciprocal]), Generator().manual_seed(3)
    angles = torch.rand(COUNT, 3, generator=rng, dtype=torch.float64)
    angles = angles * torch.tensor([1.2, 1.2, math.tau], dtype=torch.float64)
    wi, wo = rusinkiewicz_to_directions(angles)
    above = (wi[:, 2] > 0.02) & (wo[:, 2] > 0.02)
    wi, wo, wanted = wi[above], wo[above], torch.log1p(lobe(angles[above]))

    def seen(column: int, which: int, *pair: Tensor) -> Tensor:
        found = page.page.evaluate(SHADER, [column, torch.stack(pair, 1).tolist(), which])
        return torch.tensor(found, dtype=torch.float64).log1p()

    for column in (0, 1):
        assert all(float((seen(column, 1, *pair) - wanted).abs().mean()) < 4e-3 for pair in ((wi, wo), (wo, wi)))
    reference, fit = (float((seen(0, which, wi, wo) - seen(0, which, wo, wi)).abs().mean()) for which in (1, 0))
    assert reference < 0.1 * fit
    assert not page.problems
