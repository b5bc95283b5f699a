"""BRDFs on the page: the shader's network is the fit's, its pictures are metapp's."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize, silu

from data_tools.readers.brdf_task import brdf_task
from metapp.appearance.colour import to_srgb
from metapp.appearance.geometry import (
    above_horizon,
    directions_to_four_angles,
    rusinkiewicz_to_directions,
)
from metapp.appearance.sphere import reference_scene, shade_sphere, studio_lights
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.featured import Featured
from metapp.extensions.few.network import Few
from metapp.extensions.viewer.page import Group, Shown, array, document, html
from metapp.extensions.viewer.pages.anisotropic_residual import CELLS as AZIMUTHAL
from metapp.extensions.viewer.pages.brdf import CELLS, packed
from metapp.extensions.viewer.view import view_of
from metapp.learning.task import Params, Task
from metapp.storage.html import write_page
from tests import anisotropic
from tests.browser import LEGEND, Page, assert_alike, false_colours

APPS = {
    "nbrdf": Brdf(),
    "featured": Brdf(Featured(width=12, features=7, code=3)),
    "few": Brdf(Few()),
    "anisotropic": Brdf(Featured(width=12, features=7, code=3, anisotropic=True)),
}


def lobe(angles: Tensor) -> Tensor:
    """A coloured body under a highlight."""
    shine = torch.exp(-((angles[..., :1] / 0.15) ** 2))
    return angles.new_tensor([0.06, 0.1, 0.2]) + shine * angles.new_tensor([2.0, 1.8, 1.5])


@functools.cache
def material() -> Task:
    return brdf_task("lobe", lobe, samples=32_768)


@functools.cache
def theta_of(name: str) -> Params:
    """A material by a network with random weights, that reflects everywhere."""
    app, rng = APPS[name], Generator().manual_seed(1)
    theta = {key: value[0].clone() for key, value in app.init(rng, 1).items()}
    for key in {"last", "z", "turn"} & set(theta):
        theta[key] = 0.2 * torch.randn(theta[key].shape, generator=rng)
    if "last" in theta:
        theta["last"][:, -1] = -1.5 if name == "few" else 0.4
    else:
        theta["b3"] = torch.full_like(theta["b3"], 0.4)
    return theta


def views(*names: str, task: Task | None = None) -> list[Shown]:
    shown = []
    for name in names:
        view = view_of(APPS[name], theta_of(name), task or Task("lobe", {}))
        shown.append(Shown(name, "", view))
    return shown


def open_page(browser: Any, folder: Path, fits: list[Shown]) -> Page:
    return Page(browser, write_page(html(document("metapp", [Group("lobe", "BRDF", fits)])), folder / "view.html"))


@pytest.mark.parametrize("name", APPS)
def test_packed_weights_are_the_network(name: str) -> None:
    """Unpacked as the shader reads them, they give its outputs."""
    layers = APPS[name].network.folded(theta_of(name)).layers
    (w1, b1), (w2, b2), (w3, b3) = layers
    rng = Generator().manual_seed(0)
    x = torch.randn(w1.shape[1], generator=rng, dtype=torch.float64)
    act = torch.relu if name == "nbrdf" else silu
    wanted = w3 @ act(w2 @ act(w1 @ x + b1) + b2) + b3
    rows, inputs4, hidden4 = packed(layers).double(), -(-w1.shape[1] // 4), -(-len(w1) // 4)
    group, row = 4 * inputs4 + 1, hidden4 + 1
    first = rows[: hidden4 * group].reshape(hidden4, group, 4)
    padded = torch.nn.functional.pad(x, (0, 4 * inputs4 - len(x)))
    hidden = act(first[:, :-1].reshape(hidden4, 4, -1) @ padded + first[:, -1]).flatten()
    second = rows[hidden4 * group : hidden4 * group + 4 * hidden4 * row].reshape(4 * hidden4, row, 4)
    values = act(second[:, :-1].flatten(1) @ hidden + second[:, -1, 3])
    found = rows[-1, :3] + values @ second[:, -1, :3]
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)


def test_lights_of_the_studio_make_metapps_picture() -> None:
    """Of a white matte sphere, whose radiance is the irradiance over pi."""
    scene, (places, powers) = reference_scene(), studio_lights().double()
    wanted = shade_sphere(scene, lambda angles: torch.full((len(angles), 3), 1 / math.pi))
    row, column = 40, 50
    x, y = ((column + 0.5) / 48 - 1) / 0.96, (1 - (row + 0.5) / 48) / 0.96
    normal = torch.tensor([x, y, math.sqrt(1 - x * x - y * y)], dtype=torch.float64)
    tangent = normalize(torch.tensor([float(normal[2]), 0, -x], dtype=torch.float64), dim=0)
    frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal])
    total, viewer = torch.zeros(3, dtype=torch.float64), frame[:, 2]
    for place, power in zip(places[:, :3], powers, strict=True):
        light, irradiance = frame @ place, power[:3]
        if power[3]:
            cosine = viewer @ place
            light = 2 * cosine * place - viewer
            irradiance = irradiance * 4 * cosine.clamp_min(0) * (0.06 + 0.05 * light @ frame[:, 1])
        total += irradiance * light[2].clamp_min(0) / math.pi
    torch.testing.assert_close(total.float(), wanted[row, column, :3], atol=1e-4, rtol=1e-3)


def test_samples_beyond_the_fit_are_on_the_grid() -> None:
    """In the middle of cells, log(1 + f) of fit and grid is the material's, to a tenth of what the fit lacks."""
    grid = views("nbrdf", task=material())[0].view.arrays["residual"].float()
    assert grid.shape == (*CELLS, 4)
    phi_d, theta_d, theta_h = (torch.arange(count) + 0.5 for count in CELLS)
    middles = (math.tau / CELLS[0] * phi_d, math.pi / 2 / CELLS[1] * theta_d, math.pi / 2 * (theta_h / CELLS[2]) ** 2)
    angles = torch.stack(torch.meshgrid(*middles, indexing="ij"), -1).flip(-1)
    fit = torch.log1p(APPS["nbrdf"].reflectance(theta_of("nbrdf"), angles))
    inside = above_horizon(angles.reshape(-1, 3)).reshape(CELLS)
    lacks, left = (torch.log1p(lobe(angles)) - each for each in (fit, fit + grid[..., :3]))
    assert float(left[inside].abs().mean()) < 0.1 * float(lacks[inside].abs().mean())


def test_a_reciprocal_fit_has_half_of_the_grid() -> None:
    theta = {key: torch.zeros_like(value) for key, value in theta_of("nbrdf").items()}
    grid = view_of(APPS["nbrdf"], theta, material()).arrays["residual"]
    assert grid.shape == (CELLS[0] // 2, *CELLS[1:], 4)


def test_a_reference_takes_less_than_a_megabyte_of_the_page() -> None:
    grid = views("anisotropic", task=anisotropic.task())[0].view.arrays["residual"]
    assert grid.shape == (*AZIMUTHAL, 4)
    assert len(array(grid)["data"]) < 1e6


@pytest.mark.long
@pytest.mark.parametrize("name", ["anisotropic", "featured"])
def test_the_shader_evaluates_the_reference_of_an_anisotropic_material(browser: Any, tmp_path: Path, name: str) -> None:
    """Whatever network fits it; also where slices of the grid meet, with light and viewer exchanged, at the normal."""
    shown = views(name, task=anisotropic.task())
    page, app, theta = open_page(browser, tmp_path, shown), APPS[name], theta_of(name)
    angles = 0.02 + torch.rand(600, 4, generator=Generator().manual_seed(3)) * torch.tensor([1.2, 1.2, 6.2, 6.2])
    turn = float(theta["turn"]) if "turn" in theta else 0.0
    angles[:100, 2] = (turn - angles[:100, 3]) % math.pi + 1e-3 * torch.linspace(-1, 1, 100)
    angles[100:150, 0] = 1e-4
    wi, wo = rusinkiewicz_to_directions(angles[above_horizon(angles)].double())
    angles = directions_to_four_angles(wi, wo).float()
    base = app.reflectance(theta, angles if app.network.anisotropic else folded(angles))
    more = anisotropic.interpolated(shown[0].view.arrays["residual"], angles, turn)
    wanted = torch.expm1(torch.log1p(base) + more).clamp_min(0)
    script = "pairs => metapp.viewer.evaluate(0, pairs)[1]"
    for pairs in ([wi, wo], [wo, wi]):
        found = torch.tensor(page.page.evaluate(script, torch.stack(pairs, 1).tolist()))
        torch.testing.assert_close(found, wanted, atol=2e-3, rtol=1e-2)
    assert not page.problems


def folded(angles: Tensor) -> Tensor:
    """As the reference begins at a network without phi_h, which need not be reciprocal."""
    return torch.stack([angles[:, 0], angles[:, 1], angles[:, 2] % math.pi], 1)


@pytest.mark.long
def test_the_screen_shows_an_anisotropic_material_beside_a_wrong_fit(browser: Any, tmp_path: Path) -> None:
    """The reference is metapp's picture of it, although the fit is of another; the pointer's plot is drawn."""
    task = brdf_task("brushed", anisotropic.brushed, azimuths=True)
    page = open_page(browser, tmp_path, views("anisotropic", task=task))
    page.sized(96, 96)
    page.set(view="picture", paper="white", show="reference")
    page.settle()
    wanted, found = to_srgb(task.data["render"]), page.screenshot()
    assert_alike(found, wanted, mean=3 / 255, least=0.95)
    page.set(show="fit")
    page.settle()
    assert np.abs(page.screenshot() - wanted).mean() >= 15 / 255
    for plot in ("lobe", "slice"):
        page.set(plot=plot)
        page.page.evaluate("metapp.viewer.pointed({ fit: 0, x: 40, y: 40, width: 96, height: 96 })")
    assert not page.problems


@pytest.mark.long
def test_the_screen_shows_metapps_picture(browser: Any, tmp_path: Path) -> None:
    """Fit and reference, and the wipe has both; the numbers of their difference are those of metapp's pictures."""
    page = open_page(browser, tmp_path, views("nbrdf", task=material()))
    page.sized(96, 96)
    page.set(view="picture", paper="white", show="fit")
    page.settle()
    pictures = APPS["nbrdf"].preview(theta_of("nbrdf"), material())
    shown = {}
    for name in ("fit", "reference"):
        page.set(show=name)
        page.settle()
        shown[name] = page.screenshot()
        wanted = to_srgb(pictures[name])
        assert_alike(shown[name], wanted)
    page.set(show="wipe", wipe=0.25)
    page.settle()
    wiped = page.screenshot()
    assert np.array_equal(wiped[:, :24], shown["reference"][:, :24])
    assert np.array_equal(wiped[:, 24:], shown["fit"][:, 24:])
    page.set(show="difference", scale=0.5)
    page.sized(96, 96 + LEGEND)
    page.settle()
    apart = np.abs(to_srgb(pictures["fit"]) - to_srgb(pictures["reference"])).mean(-1)
    inside = disc(96)
    assert_alike(page.screenshot()[:96], false_colours(apart, 0.5), torch.from_numpy(inside))
    (numbers,) = page.page.evaluate("metapp.viewer.numbers")
    assert numbers["mean"] == pytest.approx(apart[inside].mean(), rel=0.03)
    assert numbers["rms"] == pytest.approx(np.sqrt((apart[inside] ** 2).mean()), rel=0.03)
    assert numbers["high"] == pytest.approx(np.quantile(apart[inside], 0.95), rel=0.05)
    told = page.page.locator(".scale:not([hidden])").get_attribute("aria-label")
    assert told.startswith("|fit \u2212 reference|: colours from 0 to 50 %; mean ")
    assert f"mean {100 * numbers['mean']:.3g} %" in page.page.inner_text("footer")
    assert not page.problems


def disc(size: int) -> np.ndarray:
    """Pixels that the sphere of metapp's pictures covers, bool [size, size]."""
    across = (np.arange(size) + 0.5) / size * 2 - 1
    return np.hypot(*np.meshgrid(across, across)) < 0.96 - 1.5 / size


@pytest.mark.long
def test_a_lamp_and_a_light_map_light_what_faces_them(browser: Any, tmp_path: Path) -> None:
    """A matte body of albedo a is a times as bright as a white map; the side away from a lamp is black."""
    task = brdf_task("matte", lambda angles: torch.full((*angles.shape[:-1], 3), 0.3 / math.pi), samples=1024)
    theta = {key: torch.zeros_like(value) for key, value in theta_of("nbrdf").items()}
    theta["b3"] = torch.full_like(theta["b3"], math.log1p(0.3 / math.pi))
    view = view_of(APPS["nbrdf"], theta, task)
    white = view._replace(shared=dict(view.shared) | {"light": torch.ones(8, 16, 3).half()})
    page = open_page(browser, tmp_path, [Shown("meta", "", white)])
    page.sized(64, 64)
    page.set(light="map", shape="plane", show="fit")
    page.page.evaluate("metapp.viewer.most = () => 64")
    page.settle()
    middle = page.screenshot()[28:36, 28:36].mean()
    assert middle == pytest.approx(float(to_srgb(np.full((1, 1, 3), 0.3 * 0.5)).mean()), abs=0.015)
    page.set(light="lamp", shape="sphere", surround=False)
    page.page.evaluate("metapp.viewer.lampAt.set(1, 0, 0); metapp.viewer.restart()")
    page.settle()
    lit = page.screenshot().mean(-1)
    assert lit[32, 14] < 0.02 < 0.2 < lit[32, 50]
    page.set(surround=True)
    page.settle()
    surrounded = page.screenshot().mean(-1)
    faint = float(to_srgb(np.full((1, 1, 3), 0.15 * 0.3 * 0.5)).mean())
    assert surrounded[32, 14] == pytest.approx(faint, abs=0.015)  # 15 % of what the map makes alone
    assert not page.problems
