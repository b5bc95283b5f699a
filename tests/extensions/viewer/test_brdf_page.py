"""BRDFs on pages of `metapp view`: the shader evaluates what `fit(wi, wo)` does, and pictures agree with metapp's."""

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize

from data_tools.readers.brdf_task import make_brdf_task
from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.geometry import directions_to_four_angles, is_above_horizon, rusinkiewicz_to_directions
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.feature_network import Featured
from metapp.apps.brdf.few.gaussian_model import Few
from metapp.extensions.viewer.pages.anisotropic_residual import RESIDUAL_GRID_CELLS as AZIMUTHAL
from metapp.extensions.viewer.pages.brdf import SAMPLE_GRID_CELLS
from metapp.extensions.viewer.view import View, make_view
from metapp.extensions.viewer.viewer_page import encode_array
from metapp.learning.task import Params, Task
from tests import anisotropic
from tests.anisotropic import (
    APP,
    HIGHLIGHT_AZIMUTH_RAD,
    brushed_reflectance_at_angles,
    interpolate_as_shader,
    solve_for_brushed,
)
from tests.browser import LEGEND_PX, assert_pictures_match, error_colours
from tests.recipe_apps import fit_of, presenter_of

APPS = {
    "nbrdf": Brdf(),
    "featured": Brdf(Featured(width=12, features=7, code=3)),
    "few": Brdf(Few()),
    "anisotropic": Brdf(Featured(width=12, features=7, code=3, anisotropic=True)),
}
COUNT = 4096
SHADER = "([column, pairs, which]) => metapp.viewer.evaluate(column, pairs)[which]"


def lobe(angles: Tensor) -> Tensor:
    """A coloured body under a highlight."""
    shine = torch.exp(-((angles[..., :1] / 0.15) ** 2))
    return angles.new_tensor([0.06, 0.1, 0.2]) + shine * angles.new_tensor([2.0, 1.8, 1.5])


@functools.cache
def material() -> Task:
    return make_brdf_task("lobe", lobe, samples=32_768)


@functools.cache
def theta_of(name: str) -> Params:
    """A material by a network with random weights, that reflects everywhere."""
    app, rng = APPS[name], Generator().manual_seed(1)
    theta = {key: value[0].clone() for key, value in app.init(rng, 1).items()}
    for key in {"last", "z", "axes_azimuth_rad"} & set(theta):
        theta[key] = 0.2 * torch.randn(theta[key].shape, generator=rng)
    if "last" in theta:
        theta["last"][:, -1] = -1.5 if name == "few" else 0.4
    else:
        theta["b3"] = torch.full_like(theta["b3"], 0.4)
    return theta


def views(*names: str, task: Task | None = None, theta: Params | None = None) -> list[View]:
    shown = []
    for name in names:
        view = make_view(fit_of(APPS[name], theta or theta_of(name), task or Task("lobe", {})))
        shown.append(view._replace(label=name))
    return shown


def even(value: float) -> Params:
    """A network that is the same everywhere, with this log of 1 + f."""
    theta = {key: torch.zeros_like(weights) for key, weights in theta_of("nbrdf").items()}
    return theta | {"b3": torch.full_like(theta["b3"], value)}


def test_a_reference_has_the_smallest_grid_and_takes_less_than_a_megabyte_of_the_page() -> None:
    """Half of it where the fit is reciprocal, with azimuths where the material has some."""
    (reciprocal,) = views("nbrdf", task=material(), theta=even(0))
    (brushed,) = views("anisotropic", task=anisotropic.brushed_task())
    shapes = (SAMPLE_GRID_CELLS[0] // 2, *SAMPLE_GRID_CELLS[1:], 4), (*AZIMUTHAL, 4)
    for shown, shape in zip((reciprocal, brushed), shapes, strict=True):
        grid = shown.arrays["residual"]
        assert grid.shape == shape
        assert len(encode_array(grid)["data"]) < 1e6


# In a browser


def pairs() -> tuple[Tensor, Tensor]:
    """Lights and viewers [N, 3], float64: random, along the surface, mirrored, in one plane, at the normal."""
    rng = Generator().manual_seed(2)
    wi, wo = torch.randn(2, COUNT, 3, generator=rng, dtype=torch.float64).unbind()
    for vectors in (wi, wo):
        vectors[:, 2] = vectors[:, 2].abs() + 1e-3
    wi[:512, 2] *= 0.01
    wo[256:768, 2] *= 0.01
    wo[768:1280] = wi[768:1280] * torch.tensor([-1, -1, 1]) + 0.01 * torch.randn(512, 3, generator=rng)
    plane = torch.randn(512, 1, generator=rng) * wi[1280:1792, :2]  # beside phi_d = 0 and pi, on either side
    wo[1280:1792, :2] = plane + 1e-4 * torch.randn(512, 2, generator=rng)
    wo[1792:1856] = wi[1792:1856]
    wi[1856:1920] = wi.new_tensor([0, 0, 1])
    wo[1888:1952] = wo.new_tensor([0, 0, 1])
    wo[1952:2016] = wi[1952:2016] * torch.tensor([-1, -1, 1])  # the half vector is the normal
    for vectors in (wi, wo):
        vectors[:, 2] = vectors[:, 2].abs() + 1e-3
    return normalize(wi, dim=1), normalize(wo, dim=1)


def error(found: Tensor, wanted: Tensor) -> float:
    """The largest difference relative to the larger of 1 / sr and the value."""
    return float(((found.double() - wanted.double()).abs() / wanted.double().abs().clamp_min(1)).max())


@pytest.mark.long
def test_shader_evaluates_as_python_does(open_page: Callable) -> None:
    """Values agree to 1e-3 for each kind of network at every phi_d; without a reference the page has none."""
    page = open_page(views(*APPS))
    wi, wo = pairs()
    directions = torch.stack([wi, wo], 1).tolist()
    azimuth = torch.linalg.vector_norm((wi + wo)[:, :2], dim=1) > 1e-4  # else numbers of 32 bits hardly tell it
    for column, (name, app) in enumerate(APPS.items()):
        expected = app.reflectance(theta_of(name), directions_to_four_angles(wi, wo).float())
        for which in (0, 1):
            found = torch.tensor(page.page.evaluate(SHADER, [column, directions, which]))
            comparable = azimuth | (not app.network.anisotropic)
            assert error(found[comparable], expected[comparable]) < 1e-3, name
            assert found.isfinite().all()
        assert float(expected.amax()) > 0.1
    exchanged = APPS["nbrdf"].reflectance(theta_of("nbrdf"), directions_to_four_angles(wo, wi).float())
    here = APPS["nbrdf"].reflectance(theta_of("nbrdf"), directions_to_four_angles(wi, wo).float())
    assert error(here, exchanged) > 0.01  # the network tells light from viewer, so a fold would be seen


@pytest.mark.long
def test_the_reference_is_the_material_whatever_the_fit(open_page: Callable) -> None:
    """Of a fit that is not reciprocal, and of one that is, which has a smaller grid; up to interpolation."""
    fits = [*views("nbrdf", task=material()), *views("nbrdf", task=material(), theta=even(0))]
    page, rng = open_page(fits), Generator().manual_seed(3)
    angles = torch.rand(COUNT, 3, generator=rng, dtype=torch.float64)
    angles = angles * torch.tensor([1.2, 1.2, math.tau], dtype=torch.float64)
    wi, wo = rusinkiewicz_to_directions(angles)
    above = (wi[:, 2] > 0.02) & (wo[:, 2] > 0.02)
    wi, wo, expected = wi[above], wo[above], torch.log1p(lobe(angles[above]))

    def seen(column: int, which: int, *pair: Tensor) -> Tensor:
        found = page.page.evaluate(SHADER, [column, torch.stack(pair, 1).tolist(), which])
        return torch.tensor(found, dtype=torch.float64).log1p()

    for column in (0, 1):
        assert all(float((seen(column, 1, *pair) - expected).abs().mean()) < 4e-3 for pair in ((wi, wo), (wo, wi)))
    reference, fit = (float((seen(0, which, wi, wo) - seen(0, which, wo, wi)).abs().mean()) for which in (1, 0))
    assert reference < 0.1 * fit


@pytest.mark.long
@pytest.mark.parametrize("name", ["anisotropic", "featured"])
def test_the_shader_evaluates_the_reference_of_an_anisotropic_material(open_page: Callable, name: str) -> None:
    """Whatever network fits it; also where slices of the grid meet, with light and viewer exchanged, at the normal."""
    shown = views(name, task=anisotropic.brushed_task())
    page, app, theta = open_page(shown), APPS[name], theta_of(name)
    angles = 0.02 + torch.rand(600, 4, generator=Generator().manual_seed(3)) * torch.tensor([1.2, 1.2, 6.2, 6.2])
    turn = float(theta["axes_azimuth_rad"]) if "axes_azimuth_rad" in theta else 0.0
    angles[:100, 2] = (turn - angles[:100, 3]) % math.pi + 1e-3 * torch.linspace(-1, 1, 100)
    angles[100:150, 0] = 1e-4
    wi, wo = rusinkiewicz_to_directions(angles[is_above_horizon(angles)].double())
    angles = directions_to_four_angles(wi, wo).float()
    # at a network without phi_h, which need not be reciprocal, the reference begins folded
    folded = torch.stack([angles[:, 0], angles[:, 1], angles[:, 2] % math.pi], 1)
    base = app.reflectance(theta, angles if app.network.anisotropic else folded)
    more = anisotropic.interpolate_as_shader(shown[0].arrays["residual"], angles, turn)
    expected = torch.expm1(torch.log1p(base) + more).clamp_min(0)
    for pair in ([wi, wo], [wo, wi]):
        found = torch.tensor(page.page.evaluate(SHADER, [0, torch.stack(pair, 1).tolist(), 1]))
        torch.testing.assert_close(found, expected, atol=2e-3, rtol=1e-2)


@pytest.mark.long
def test_the_screen_shows_metapps_picture(open_page: Callable) -> None:
    """Fit and reference, and the wipe has both; the numbers of their difference are those of metapp's pictures."""
    page = open_page(views("nbrdf", task=material()), width=960)
    still = "metapp.viewer.element.style.getPropertyValue('--still')"  # a picture meanwhile
    assert "url(" in page.page.evaluate(still)
    controls = page.page.evaluate("(({ scrollWidth, clientWidth }) => [scrollWidth, clientWidth])(page.form)")
    assert controls[0] == controls[1] > 0
    page.resize(96, 96)
    page.set(view="picture", paper="white")
    pictures = presenter_of(APPS["nbrdf"]).preview(theta_of("nbrdf"), material())
    shown = {}
    for name in ("fit", "reference"):
        page.set(show=name)
        page.settle()
        shown[name] = page.screenshot()
        assert_pictures_match(shown[name], composite_to_srgb(pictures[name]))
    assert not page.page.evaluate("metapp.viewer.element.classList.contains('waiting')")
    page.set(show="wipe", wipe=0.25)
    page.settle()
    wiped = page.screenshot()
    assert np.array_equal(wiped[:, :24], shown["reference"][:, :24])
    assert np.array_equal(wiped[:, 24:], shown["fit"][:, 24:])
    page.set(show="difference", scale=0.5)
    page.resize(96, 96 + LEGEND_PX)
    page.settle()
    apart = np.abs(composite_to_srgb(pictures["fit"]) - composite_to_srgb(pictures["reference"])).mean(-1)
    inside = disc(96)
    assert_pictures_match(page.screenshot()[:96], error_colours(apart, 0.5), torch.from_numpy(inside))
    (numbers,) = page.page.evaluate("metapp.viewer.numbers")
    assert numbers["mean"] == pytest.approx(apart[inside].mean(), rel=0.03)
    assert numbers["rms"] == pytest.approx(np.sqrt((apart[inside] ** 2).mean()), rel=0.03)
    assert numbers["high"] == pytest.approx(np.quantile(apart[inside], 0.95), rel=0.05)
    label = page.page.locator(".scale:not([hidden])").get_attribute("aria-label")
    assert label.startswith("|fit \u2212 reference|: colours from 0 to 50 %; mean ")
    assert f"mean {100 * numbers['mean']:.3g} %" in page.page.inner_text("footer")


def disc(size: int) -> np.ndarray:
    """Pixels that the sphere of metapp's pictures covers, bool [size, size]."""
    across = (np.arange(size) + 0.5) / size * 2 - 1
    return np.hypot(*np.meshgrid(across, across)) < 0.96 - 1.5 / size


@pytest.mark.long
def test_lamps_and_light_maps_light_surfaces_that_face_them(open_page: Callable) -> None:
    """A matte body of albedo a is a times as bright as a white map; the side away from a lamp is black."""
    task = make_brdf_task("matte", lambda angles: torch.full((*angles.shape[:-1], 3), 0.3 / math.pi), samples=1024)
    (matte,) = views("nbrdf", task=task, theta=even(math.log1p(0.3 / math.pi)))
    page = open_page(matte._replace(shared=dict(matte.shared) | {"light": torch.ones(8, 16, 3).half()}))
    page.resize(64, 64)
    page.set(light="map", shape="plane", show="fit")
    page.page.evaluate("metapp.viewer.most = () => 64")
    page.settle()
    middle = page.screenshot()[28:36, 28:36].mean()
    assert middle == pytest.approx(float(composite_to_srgb(np.full((1, 1, 3), 0.3 * 0.5)).mean()), abs=0.015)
    page.set(light="lamp", shape="sphere", surround=False)
    page.page.evaluate("metapp.viewer.lampAt.set(1, 0, 0); metapp.viewer.restart()")
    page.settle()
    lit = page.screenshot().mean(-1)
    assert lit[32, 14] < 0.02 < 0.2 < lit[32, 50]
    page.set(surround=True)
    page.settle()
    surrounded = page.screenshot().mean(-1)
    faint = float(composite_to_srgb(np.full((1, 1, 3), 0.15 * 0.3 * 0.5)).mean())
    assert surrounded[32, 14] == pytest.approx(faint, abs=0.015)  # 15 % of what the map makes alone


# How pictures come about: in pieces that can be stopped, under light maps from blurred maps


SLOW = """void (() => {
  const wait = DrawnViewer.prototype._wait;
  DrawnViewer.prototype._wait = function (target) {
    const end = performance.now() + 80;
    wait.call(this, target);
    while (performance.now() < end);
  };
})()"""  # as where tiles take long
MEANS = """(() => {
  const { fine, renderer } = metapp.viewer, { width, height } = fine.sum;
  return [fine.look, fine.sum].flatMap((target) => [0, 1].map((which) => {
    const half = target === fine.look, values = new (half ? Uint16Array : Float32Array)(4 * width * height);
    renderer.readRenderTargetPixels(target, 0, 0, width, height, values, undefined, which);
    const sums = [0, 0, 0, 0];
    values.forEach((value, i) => { sums[i % 4] += half ? fromHalf(value) : value; });
    return sums.slice(0, 3).map((sum) => sum / sums[3]);
  }));
})()"""  # of fit and reference at first and at last


@pytest.mark.long
def test_the_first_look_under_a_light_map_is_as_bright_as_the_last(open_page: Callable) -> None:
    """Fit and reference agree in each channel, relative to the brightest one."""
    page = open_page(views("nbrdf", task=material()))
    page.resize(96, 48)
    page.set(light="map", shape="sphere")
    page.page.evaluate("metapp.viewer.most = () => 96")
    page.settle()
    fit, reference, *last = (torch.tensor(mean) for mean in page.page.evaluate(MEANS))
    for first, final in zip((fit, reference), last, strict=True):
        assert float((first - final).abs().max() / final.max()) < 0.06


@pytest.mark.long
def test_a_long_picture_comes_in_pieces_and_can_be_stopped_and_goes_on(open_page: Callable) -> None:
    """Where a sample takes long, the page responds many times in between."""
    page = open_page(views("nbrdf"))
    page.resize(96, 48)
    page.page.evaluate(SLOW)
    page.set(light="lamp")
    before = page.page.evaluate("metapp.drawn")
    page.page.wait_for_function("metapp.viewer.count > 0", timeout=120_000)
    assert page.page.evaluate("metapp.drawn") - before > 5
    button = page.page.locator(".progress button")
    button.evaluate("button => button.click()")
    page.settle()
    count, most = page.page.evaluate("[metapp.viewer.count, metapp.viewer.most()]")
    assert count < most
    assert button.text_content() == "Go on"
    assert "stopped" in str(page.page.locator(".progress").text_content())
    page.page.evaluate(f"metapp.viewer.most = () => {count + 1}")
    button.evaluate("button => button.click()")
    page.settle()
    assert page.page.evaluate("metapp.viewer.count") == count + 1
    assert page.page.locator(".progress").is_hidden()


# The grid of residuals over four angles


def angles_above(count: int, seed: int) -> Tensor:
    """theta_h, theta_d, phi_d, phi_h [N, 4] in rad, uniform, of directions above the horizon."""
    draws = torch.rand(4 * count, 4, dtype=torch.float64, generator=Generator().manual_seed(seed))
    draws *= draws.new_tensor([math.pi / 2, math.pi / 2, math.tau, math.tau])
    return draws[is_above_horizon(draws)][:count]


def noise(seed: int = 0) -> Tensor:
    return torch.randn(*AZIMUTHAL, 4, generator=Generator().manual_seed(seed))


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
    one, other = (
        interpolate_as_shader(noise(), four_angles, HIGHLIGHT_AZIMUTH_RAD)
        for four_angles in (angles, angles + angles.new_tensor(change))
    )
    torch.testing.assert_close(one, other, atol=1e-3, rtol=0)


def test_the_grid_has_no_seam() -> None:
    """Along any path a small step changes little, also of a grid of noise; paths cross all azimuths."""
    step = 1e-3
    start = angles_above(64, 2).clamp(0.02, 1.4)
    for axis in range(4):
        path = start[:, None].repeat(1, 4000, 1)
        path[..., axis] += step * torch.arange(4000)
        path[..., :2] = path[..., :2].clamp_max(math.pi / 2)
        values = interpolate_as_shader(noise(), path.reshape(-1, 4), HIGHLIGHT_AZIMUTH_RAD).reshape(64, 4000, 3)
        steepest = 8 * max(AZIMUTHAL) * step  # cells a rad by the difference of neighbours
        assert float(values.diff(dim=1).abs().max()) < steepest


def isotropic() -> tuple[Brdf, Params]:
    app = Brdf(Featured(width=12, features=7, code=3))
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(1), 1).items()}
    return app, theta | {"last": 0.2 * torch.randn(theta["last"].shape, generator=Generator().manual_seed(2))}


def shine(angles: Tensor) -> Tensor:
    """An isotropic material."""
    return 0.1 + torch.exp(-((angles[..., :1] / 0.3) ** 2)).expand(*angles.shape[:-1], 3)


@pytest.mark.usefixtures("small_spheres")
@pytest.mark.parametrize("wrong", ["dark", "turned", "another", "isotropic", "isotropic material", ""])
def test_a_fit_and_its_residual_are_the_material(wrong: str) -> None:
    """The reference comes from the samples: at angles that are none of them it is near the truth, whatever the fit."""
    app, theta, truth = APP, dict(solve_for_brushed()), brushed_reflectance_at_angles
    task = anisotropic.brushed_task(65_536)
    if wrong == "dark":
        theta["last"] = torch.zeros_like(theta["last"])
    elif wrong == "turned":
        theta["axes_azimuth_rad"] = theta["axes_azimuth_rad"] + 1.0
    elif wrong == "another":
        theta["last"] = theta["last"][[2, 0, 1]] * 0.5 + 0.02
    elif wrong == "isotropic":
        app, theta = isotropic()
    elif wrong:
        truth, task = shine, make_brdf_task("still", shine, 65_536)
    grid = make_view(fit_of(app, theta, task)).arrays["residual"]
    angles = angles_above(20_000, 8).float()
    if not app.network.anisotropic:
        angles[:, 2] %= math.pi  # as such networks, which need not be reciprocal, are shown
    fit = torch.log1p(app.reflectance(theta, angles))
    reference = (fit + interpolate_as_shader(grid, angles, float(theta.get("axes_azimuth_rad", 0.0)))).clamp_min(0)
    lacks, left = (float((logarithms - torch.log1p(truth(angles))).abs().mean()) for logarithms in (fit, reference))
    assert left < (0.1 if wrong else 1.0) * lacks
