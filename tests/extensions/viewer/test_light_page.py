"""Environment maps on pages of `metapp view`: what is stored of them, and pictures, which agree with metapp's."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb, tone_map
from metapp.appearance.latlong import mean_luminance, resample_maps, sphere_normals, texel_directions
from metapp.appearance.photograph import render_mirror_spheres
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.ball_sight import LOSS_PHOTO_PX, BallSight
from metapp.apps.illumination.lighting import LightField, Lighting
from metapp.apps.illumination.map_sight import MapSight
from metapp.apps.illumination.radiance import Radiance
from metapp.apps.illumination.spheres import SPHERE_NAMES, render_spheres
from metapp.extensions.viewer.pages import illumination as pages
from metapp.extensions.viewer.view import make_view
from metapp.learning.task import Params, Task
from metapp.networks.field import LocalField
from tests.browser import LEGEND_PX, Page, assert_pictures_match, error_colours
from tests.recipe_apps import asset_of, fit_of

ROWS = 64
GAP = 6  # px between panes
FIELD = LocalField(ROWS, 2 * ROWS, rows=4, columns=8, code=3, hidden=8, layers=2)


def lamps(seed: int, sun: float = 0.0) -> Tensor:
    """A smooth map [3, ROWS, 2 ROWS] of mean luminance 1, with some detail and perhaps a sun of one texel."""
    generator, towards = Generator().manual_seed(seed), texel_directions(ROWS, 2 * ROWS)
    lights = torch.nn.functional.normalize(torch.randn(3, 3, generator=generator), dim=1)
    near = torch.einsum("lc,chw->lhw", lights, towards)
    light = 0.2 + torch.einsum("lhw,lc->chw", (4 * (near - 0.5)).exp(), torch.rand(3, 3, generator=generator))
    light *= 1 + 0.5 * torch.sin(9 * towards[0]) * torch.sin(7 * towards[1])
    light[:, 20, 90] += sun
    return light / mean_luminance(light)


def task_of(light: Tensor) -> Task:
    """A map, and its mirror ball, seen but for what lies behind it."""
    ball = linear_to_srgb((0.4 * render_mirror_spheres(light[None], 64)).clamp(0, 1))
    shares = torch.stack([(texel_directions(ROWS, 2 * ROWS)[2] > -0.8).float(), torch.zeros(ROWS, 2 * ROWS)])
    photos = (ball * 255).round().to(torch.uint8)
    return Task("lamps", {"map": light, "scale": torch.tensor(3.0), "photos": photos, "seen": light, "certain": shares})


LIGHT = lamps(1, sun=30.0)


class KnownLight(LightField):
    """The decoder of a known map, whatever the parameters of the network."""

    @override
    def __call__(self, theta: Params, seen: object = None) -> Lighting:
        return super().__call__(theta)._replace(maps=LIGHT[None])


@pytest.fixture
def fitted_map() -> Tensor:
    """The map that the fits have."""
    return LIGHT.clone()


def shown(protocol: str) -> tuple[Illumination, Params]:
    app = Illumination(KnownLight(FIELD), {"reference": MapSight, "photo": BallSight}[protocol]())
    return app, {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}


def test_a_page_holds_the_map_of_the_files_and_the_reference(fitted_map: Tensor) -> None:
    app, theta = shown("reference")
    view = make_view(fit_of(app, theta, task_of(lamps(2))))
    scale, light = view.facts["scale"], fitted_map.permute(1, 2, 0)
    kept = view.arrays["map"].float() * scale
    torch.testing.assert_close(kept, light / light.mean(), rtol=1e-3, atol=1e-6)  # as tone-mapped PNGs
    reference = view.arrays["reference"].float() * scale
    torch.testing.assert_close(reference, lamps(2).permute(1, 2, 0) / light.mean(), rtol=1e-3, atol=1e-6)
    assert (view.kind, dict(view.pictures)) == ("light", {})
    assert set(make_view(fit_of(app, theta, Task("lamps", {}))).arrays) == {"map"}  # what was fitted is not at hand


def test_suns_beyond_half_floats_are_kept() -> None:
    app, theta = shown("reference")
    pixels = torch.full((256, 512, 3), 0.01)
    pixels[100, 200, 0] = 1e5

    fit = fit_of(app, theta, Task("sun", {}))
    fit.asset = Radiance(pixels.permute(2, 0, 1))
    view = make_view(fit)
    kept = view.arrays["map"].float() * view.facts["scale"]
    assert torch.isfinite(kept).all()
    torch.testing.assert_close(kept, pixels / pixels.mean(), rtol=1e-3, atol=1e-6)


def test_large_maps_are_averaged_and_the_page_says_so(fitted_map: Tensor) -> None:
    app, theta = shown("reference")
    view = pages.make_radiance_page(fit_of(app, theta, task_of(lamps(2))), largest=(16, 32))
    small = view.arrays["map"].float().permute(2, 0, 1) * view.facts["scale"]
    torch.testing.assert_close(small, resample_maps(fitted_map / fitted_map.mean(), 16, 32), rtol=1e-3, atol=1e-6)
    assert view.facts["note"] == (
        "The map has 64 x 128 texels; this page shows 16 x 32 texels. The reference is averaged to the 16 x 32 texels "
        "of the fit."
    )


def test_a_mirror_is_shown_as_its_photo_was_exposed(fitted_map: Tensor) -> None:
    app, theta = shown("photo")
    view = make_view(fit_of(app, theta, task_of(fitted_map)))
    inside = sphere_normals(64)[0][2] > 0.5
    assert (view.pictures["photo"] - view.pictures["ball"])[inside].abs().mean() < 0.005
    with pytest.raises(KeyError, match="photos"):
        make_view(fit_of(app, theta, Task("lamps", {})))


def test_other_balls_are_those_that_fits_compare_with_their_photo(fitted_map: Tensor) -> None:
    app, theta = shown("photo")
    task = task_of(fitted_map)
    task = task._replace(data={"photos": task.data["photos"]})
    theta["body"] = torch.linspace(-1, 1, len(theta["body"])) / 100
    ball = make_view(fit_of(app, theta, task)).pictures["ball"].permute(2, 0, 1)
    target = app.decoder({key: value[None] for key, value in theta.items()}).photograph(LOSS_PHOTO_PX)[0]
    inside = avg_pool2d(sphere_normals(64)[1].float()[None], 64 // LOSS_PHOTO_PX)[0] > 0.999
    assert (avg_pool2d(ball, 64 // LOSS_PHOTO_PX) - target.clamp_max(1))[:, inside].abs().mean() < 0.004


def test_albedo_of_the_roughest_lobe_at_normal_incidence_is_1_minus_ln_2() -> None:
    """1 - ln 2 where alpha is 1, the integral of Smith's masking."""
    assert float(pages.lobe_albedos(1.0, 64)[-1]) == pytest.approx(1 - math.log(2), abs=0.005)


# In a browser


@pytest.fixture
def opened_on(open_page: Callable) -> Callable[[str, Tensor], Page]:
    """Opens the page of a fit by a protocol, and a reference."""

    def call(protocol: str, reference: Tensor) -> Page:
        app, theta = shown(protocol)
        page: Page = open_page(make_view(fit_of(app, theta, task_of(reference))))
        page.set(paper="white")
        return page

    return call


def coarse(picture: np.ndarray | Tensor) -> Tensor:
    """Means of 4 x 4 px, of [H, W, C]."""
    pixels = torch.as_tensor(np.ascontiguousarray(picture)).float().permute(2, 0, 1)
    return avg_pool2d(pixels, 4).permute(1, 2, 0)


@pytest.mark.long
def test_flat_view_shows_the_map_as_the_png_does(opened_on: Callable, fitted_map: Tensor, second_scene: Path) -> None:
    page, (app, theta) = opened_on("reference", lamps(2)), shown("reference")
    page.resize(2 * ROWS, ROWS)
    page.set(view="flat", show="fit")
    page.settle()
    pixels = asset_of(app, theta, task_of(lamps(2))).pictures()["map"].pixels
    toned = tone_map(pixels / pixels.mean())
    assert_pictures_match(page.screenshot(), toned)
    page.set(exposure=2.0)
    page.settle()
    assert_pictures_match(page.screenshot(), tone_map(4 * pixels / pixels.mean()))
    page.set(exposure=0.0, show="wipe", wipe=0.25)
    page.settle()
    seen, reference = page.screenshot(), tone_map(lamps(2).permute(1, 2, 0) * 3 / pixels.mean())
    assert_pictures_match(seen[:, :32], reference[:, :32])
    assert_pictures_match(seen[:, 32:], toned[:, 32:])
    page.resize(2 * ROWS, ROWS + LEGEND_PX)
    page.set(show="difference", scale=0.3)
    page.settle()
    apart = (toned - reference).abs().mean(-1)
    assert_pictures_match(page.screenshot()[:ROWS], error_colours(apart.numpy(), 0.3))
    (numbers,) = page.page.evaluate("metapp.viewer.numbers")
    assert numbers["mean"] == pytest.approx(float(apart.mean()), rel=0.02)


@pytest.mark.long
def test_a_panorama_looks_where_it_is_turned(opened_on: Callable, fitted_map: Tensor) -> None:
    """The middle of the view is the map's texel there, and the turn to the right goes right in the map."""
    page = opened_on("reference", lamps(2))
    page.resize(64, 64)
    toned = tone_map(fitted_map / fitted_map.mean())
    page.set(view="around", show="fit")
    for heading, pitch in ((0, 0), (70, 40), (-150, -60)):
        page.set(heading=heading, pitch=pitch, field=30)
        page.settle()
        across, down = (0.5 + heading / 360) * 2 * ROWS, (0.5 - pitch / 180) * ROWS
        around = toned[:, round(down) - 1 : round(down) + 1, round(across) - 1 : round(across) + 1].mean((1, 2))
        np.testing.assert_allclose(page.screenshot()[31:33, 31:33].mean((0, 1)), around.numpy(), atol=0.02)
    page.set(heading=0, pitch=0, field=60)
    page.settle()
    # 64 px show tan(30 degrees) either way
    row = page.screenshot()[31:33].mean(0)
    x = (torch.arange(64) + 0.5) / 32 - 1
    across = (0.5 + torch.atan(x * np.tan(np.pi / 6)) / (2 * np.pi)) * 2 * ROWS - 0.5
    low, share = across.floor().long(), across - across.floor()
    middle = (fitted_map / fitted_map.mean())[:, 31:33].mean(1)
    expected = tone_map(torch.lerp(middle[:, low], middle[:, low + 1], share))
    np.testing.assert_allclose(row, expected.T.numpy(), atol=0.02)
    page.page.locator("#stage canvas").first.dispatch_event("wheel", {"deltaY": -300})
    assert page.page.evaluate("metapp.settings.field") < 60
    mouse = page.page.mouse
    mouse.move(40, 20)
    mouse.down()
    mouse.move(20, 40)
    mouse.up()
    assert page.page.evaluate("metapp.settings.heading") > 0  # what is seen goes with the pointer
    assert page.page.evaluate("metapp.settings.pitch") > 0


@pytest.mark.long
def test_spheres_are_lit_as_in_metapps_pictures(opened_on: Callable, fitted_map: Tensor) -> None:
    page = opened_on("reference", lamps(2))
    page.resize(64, 64)
    page.page.evaluate("metapp.viewer.most = () => metapp.settings.shape === 'mirror' ? 16 : 64")
    inside = sphere_normals(64)[0][2] > 0.25
    pictures = {
        "fit": render_spheres(fitted_map[None] / fitted_map.mean()),
        "reference": render_spheres(lamps(2)[None] / fitted_map.mean()),
    }
    for name in SPHERE_NAMES:
        page.set(view="picture", shape=name)
        for which, lit in pictures.items():
            page.set(show=which)
            page.settle()
            seen, expected = page.screenshot(), tone_map(lit[name][0].permute(1, 2, 0))
            if name == "mirror":
                assert_pictures_match(seen, expected, inside)
            else:  # noise, of which more frames would leave less, averages out
                assert_pictures_match(
                    coarse(seen).numpy(), coarse(expected), coarse(inside[..., None].float())[..., 0] > 0.999
                )


@pytest.mark.long
def test_a_photo_stands_beside_the_fits_ball(opened_on: Callable, fitted_map: Tensor) -> None:
    page = opened_on("photo", fitted_map)
    page.resize(2 * 64 + GAP, 64)
    page.set(view="ball")
    page.settle()
    seen, photo = page.screenshot(), task_of(fitted_map).data["photos"][0].permute(1, 2, 0) / 255
    inside = sphere_normals(64)[0][2] > 0.5
    # it fills 0.96 of its pane
    place = ((torch.arange(64) + 0.5 - 32) / 0.96 + 32).long().clamp(0, 63)
    for half in (seen[:, :64], seen[:, 64 + GAP :]):
        assert float((torch.from_numpy(half.copy()) - photo[place][:, place])[inside].abs().mean()) < 0.03
