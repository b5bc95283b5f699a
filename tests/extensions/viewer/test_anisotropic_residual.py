"""The grid of residuals over four angles: its coordinates, its solution, and how near the material it is."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.brdf_task import brdf_task
from metapp.appearance.geometry import above_horizon
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.featured import Featured
from metapp.extensions.viewer.pages.anisotropic_residual import CELLS, gridded
from metapp.extensions.viewer.view import view_of
from metapp.learning.task import Params, Task
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
    "change",
    [
        (0.0, 0.0, math.pi, 0.0),  # light and viewer exchanged
        (0.0, 0.0, 0.0, math.tau),
        (0.0, 0.0, -math.tau, 0.0),
    ],
)
def test_the_grid_is_the_same_where_reflection_is(change: tuple[float, ...]) -> None:
    angles = angles_above(2000, 0)
    one, other = (interpolated(noise(), each, TURN) for each in (angles, angles + angles.new_tensor(change)))
    torch.testing.assert_close(one, other, atol=1e-3, rtol=0)


def test_at_the_normal_the_azimuth_of_the_half_vector_does_not_matter() -> None:
    angles = angles_above(2000, 1)
    angles[:, 0] = 0
    turned = angles.clone()
    turned[:, 3] += 1.3
    turned[:, 2] -= 1.3
    torch.testing.assert_close(
        interpolated(noise(), angles, TURN), interpolated(noise(), turned, TURN), atol=1e-3, rtol=0
    )


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


def test_no_residual_is_none() -> None:
    angles = angles_above(100, 5)
    assert not gridded(angles, torch.zeros(100, 3), 0.0).any()


def test_a_smooth_residual_is_found_between_its_samples() -> None:
    def smooth(angles: Tensor) -> Tensor:
        theta_h, theta_d, phi_d, phi_h = angles.unbind(1)
        wave = theta_h.square() * (2 * phi_h).cos() + theta_d.square() * (2 * (phi_d + phi_h)).sin()
        return wave[:, None] * wave.new_tensor([0.5, 1.0, -0.5])

    seen, unseen = angles_above(20_000, 6), angles_above(5000, 7)
    found = interpolated(gridded(seen, smooth(seen), TURN), unseen, TURN)
    assert float((found - smooth(unseen)).abs().mean()) < 0.06 * float(smooth(unseen).abs().mean())


def errors_of(app: Brdf, theta: Params, task: Task, truth: Callable[[Tensor], Tensor], seed: int) -> list[float]:
    """Mean differences from the log of a material: of a fit, and of its reference by the page's grid."""
    grid = view_of(app, theta, task).arrays["residual"]
    angles = angles_above(20_000, seed).float()
    if not app.network.anisotropic:
        angles[:, 2] %= math.pi  # as such networks, which need not be reciprocal, are shown
    fit = torch.log1p(app.reflectance(theta, angles))
    reference = (fit + interpolated(grid, angles, float(theta.get("turn", 0.0)))).clamp_min(0)
    return [float((each - torch.log1p(truth(angles))).abs().mean()) for each in (fit, reference)]


@pytest.mark.parametrize(("wrong", "share"), [("dark", 0.1), ("turned", 0.1), ("another", 0.1), ("", 1.0)])
def test_a_fit_and_its_residual_are_the_material(wrong: str, share: float) -> None:
    """The reference comes from the samples: at angles that are none of them it is near the truth, whatever the fit."""
    theta = dict(fitted())
    if wrong == "dark":
        theta["last"] = torch.zeros_like(theta["last"])
    elif wrong == "turned":
        theta["turn"] = theta["turn"] + 1.0
    elif wrong:
        theta["last"] = theta["last"][[2, 0, 1]] * 0.5 + 0.02
    lacks, left = errors_of(APP, theta, anisotropic.task(65_536), brushed, 8 if wrong else 9)
    assert left < share * lacks


def test_a_fit_without_azimuths_and_its_residual_are_the_material() -> None:
    app = Brdf(Featured(width=12, features=7, code=3))
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(1), 1).items()}
    theta["last"] = 0.2 * torch.randn(theta["last"].shape, generator=Generator().manual_seed(2))
    lacks, left = errors_of(app, theta, anisotropic.task(65_536), brushed, 10)
    assert left < 0.1 * lacks


def test_an_isotropic_material_has_a_reference_by_any_fit() -> None:
    """By a fit that reads phi_h too, whatever phi_h is."""

    def shine(angles: Tensor) -> Tensor:
        return 0.1 + torch.exp(-((angles[..., :1] / 0.3) ** 2)).expand(*angles.shape[:-1], 3)

    lacks, left = errors_of(APP, fitted(), brdf_task("still", shine, 65_536), shine, 11)
    assert left < 0.1 * lacks
