"""The grid of residuals over four angles: its coordinates, its solution, and how near the material it is."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.brdf_task import brdf_task
from metapp.appearance.geometry import above_horizon
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.featured import Featured
from metapp.extensions.viewer.pages.anisotropic_residual import CELLS
from metapp.extensions.viewer.view import view_of
from metapp.learning.task import Params
from tests import anisotropic
from tests.anisotropic import APP, TURN, brushed, fitted, interpolated

pytestmark = pytest.mark.usefixtures("small_spheres")


def angles_above(count: int, seed: int) -> Tensor:
    """theta_h, theta_d, phi_d, phi_h [N, 4] in rad, uniform, of directions above the horizon."""
    draws = torch.rand(4 * count, 4, dtype=torch.float64, generator=Generator().manual_seed(seed))
    draws *= draws.new_tensor([math.pi / 2, math.pi / 2, math.tau, math.tau])
    return draws[above_horizon(draws)][:count]


def noise(seed: int = 0) -> Tensor:
    return torch.randn(*CELLS, 4, generator=Generator().manual_seed(seed))


@pytest.mark.parametrize(
    ("change", "at_normal"),
    [
        ((0.0, 0.0, math.pi, 0.0), False),  # light and viewer exchanged
        ((0.0, 0.0, 0.0, math.tau), False),
        ((0.0, 0.0, -math.tau, 0.0), False),
        ((0.0, 0.0, -1.3, 1.3), True),  # where the azimuth of the half vector does not matter
    ],
)
def test_the_grid_is_the_same_where_reflection_is(change: tuple[float, ...], at_normal: bool) -> None:
    angles = angles_above(2000, 0)
    angles[:, 0] *= not at_normal
    one, other = (interpolated(noise(), each, TURN) for each in (angles, angles + angles.new_tensor(change)))
    torch.testing.assert_close(one, other, atol=1e-3, rtol=0)


def test_the_grid_has_no_seam() -> None:
    """Along any path a small step changes little, also of a grid of noise; paths cross all azimuths."""
    step = 1e-3
    start = angles_above(64, 2).clamp(0.02, 1.4)
    for axis in range(4):
        path = start[:, None].repeat(1, 4000, 1)
        path[..., axis] += step * torch.arange(4000)
        path[..., :2] = path[..., :2].clamp_max(math.pi / 2)
        values = interpolated(noise(), path.reshape(-1, 4), TURN).reshape(64, 4000, 3)
        steepest = 8 * max(CELLS) * step  # cells a rad by the difference of neighbours
        assert float(values.diff(dim=1).abs().max()) < steepest


def isotropic() -> tuple[Brdf, Params]:
    app = Brdf(Featured(width=12, features=7, code=3))
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(1), 1).items()}
    return app, theta | {"last": 0.2 * torch.randn(theta["last"].shape, generator=Generator().manual_seed(2))}


def shine(angles: Tensor) -> Tensor:
    """An isotropic material."""
    return 0.1 + torch.exp(-((angles[..., :1] / 0.3) ** 2)).expand(*angles.shape[:-1], 3)


@pytest.mark.parametrize("wrong", ["dark", "turned", "another", "isotropic", "isotropic material", ""])
def test_a_fit_and_its_residual_are_the_material(wrong: str) -> None:
    """The reference comes from the samples: at angles that are none of them it is near the truth, whatever the fit."""
    app, theta, truth = APP, dict(fitted()), brushed
    task = anisotropic.task(65_536)
    if wrong == "dark":
        theta["last"] = torch.zeros_like(theta["last"])
    elif wrong == "turned":
        theta["turn"] = theta["turn"] + 1.0
    elif wrong == "another":
        theta["last"] = theta["last"][[2, 0, 1]] * 0.5 + 0.02
    elif wrong == "isotropic":
        app, theta = isotropic()
    elif wrong:
        truth, task = shine, brdf_task("still", shine, 65_536)
    grid = view_of(app, theta, task).arrays["residual"]
    angles = angles_above(20_000, 8).float()
    if not app.network.anisotropic:
        angles[:, 2] %= math.pi  # as such networks, which need not be reciprocal, are shown
    fit = torch.log1p(app.reflectance(theta, angles))
    reference = (fit + interpolated(grid, angles, float(theta.get("turn", 0.0)))).clamp_min(0)
    lacks, left = (float((each - torch.log1p(truth(angles))).abs().mean()) for each in (fit, reference))
    assert left < (0.1 if wrong else 1.0) * lacks
