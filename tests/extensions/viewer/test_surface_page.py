"""Material maps on pages of `metapp view`: they are the fit's, and pictures agree with metapp's."""

import functools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize

from data_tools.readers.svbrdf_task import make_svbrdf_task
from metapp.appearance.assets import Photograph, Surface
from metapp.appearance.colour import DISPLAY_GAMMA, radiance_to_display
from metapp.appearance.flash import (
    camera_distance,
    evaluate_brdf,
    relighting_positions,
    render_maps,
    texel_positions,
)
from metapp.appearance.svbrdf_maps import Maps, pack_maps
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import decode_photo
from metapp.apps.svbrdf_nonstationary.multi_photo.recipe import of_several
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary, compose_svbrdf
from metapp.extensions.viewer.pages.flat import make_surface_view
from metapp.extensions.viewer.view import View, make_view
from metapp.learning.task import Params, Task
from metapp.networks.generators import UNet
from tests.browser import assert_pictures_match
from tests.recipe_apps import asset_of, fit_of
from tests.surfaces import rock_surface

SIDE = 16  # of exemplars, and of fields; the maps of the first are four times as large
STEP = 1 / 255
PHOTOS = 3


def seeded(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


@functools.cache
def stationary() -> tuple[SvbrdfStationary, Params, Task]:
    """A random generator's maps."""
    app = compose_svbrdf(UNet(4, 3, noise=4, code=4, outputs=6), Octaves(SIDE, SIDE, ("relu1_1",)))
    theta = {key: value[0] for key, value in app.init(seeded(), 1).items()}
    photo = (255 * torch.rand(3, SIDE, SIDE, generator=seeded(1))).to(torch.uint8)
    return app, theta, Task("cloth", {"image": photo})


@functools.cache
def nonstationary() -> tuple[SvbrdfNonstationary, Params, Task]:
    """Random maps of several photographs, which the fit places elsewhere than they say."""
    app = of_several(SIDE, SIDE)
    theta = {
        "maps": 0.2 * torch.randn(9, SIDE, SIDE, generator=seeded()),
        "flash": torch.randn(4, PHOTOS, generator=seeded(1)),
    }
    maps = rock_surface(64, tiles=False).maps
    assert maps is not None
    task = make_svbrdf_task("rock", pack_maps(maps))
    places = torch.tensor([[0.0, 0, 1], [0.3, 0.2, 1.1], [-0.4, 0.1, 0.9]]) * camera_distance()
    others = (255 * torch.rand(PHOTOS - 1, 3, 64, 64, generator=seeded(2))).to(torch.uint8)
    return (
        app,
        theta,
        task._replace(data=task.data | {"others": others, "places": places[:, None].repeat(1, 2, 1)}),
    )


def maps_in(view: View, whose: str = "fit") -> Maps:
    """The maps that a view's pictures hold, without rounding."""
    diffuse, specular, detail = (
        view.pictures[f"{whose}_{name}"].movedim(-1, 0) for name in ("diffuse", "specular", "detail")
    )
    x_and_y = (detail[:2] * 255 - 128) / 127
    z = (1 - x_and_y.square().sum(0, keepdim=True)).clamp_min(0).sqrt()
    return Maps(diffuse**DISPLAY_GAMMA, specular**DISPLAY_GAMMA, detail[2:], torch.cat([x_and_y, z]))


def assert_same(maps: Maps, wanted: Maps) -> None:
    for found, part in zip(maps, wanted, strict=True):
        torch.testing.assert_close(found, part, atol=2e-3, rtol=0)


def test_a_view_holds_the_maps_that_are_written() -> None:
    """Photographs are there where the task is at hand: the part of the maps that one covers, and its flash."""
    shown, theta, task = stationary()
    fit = fit_of(shown, theta, task)
    surface, view = fit.asset, make_view(fit)
    assert_same(maps_in(view), surface.maps)
    heights = torch.lerp(*torch.tensor(view.facts["heights"]), view.pictures["height"].movedim(-1, 0))
    torch.testing.assert_close(heights, surface.heights_in_widths(), atol=1e-5, rtol=0)
    assert list(view.facts["lit"]) == ["photo_1", *relighting_positions()]
    assert view.facts["lit"]["photo_1"]["part"] == 1 / 4
    assert (view.facts["tiles"], view.facts["falloff"], view.facts["size"]) == (True, 1, [4 * SIDE, 4 * SIDE])
    photo = task.data["image"].movedim(0, -1) / 255
    torch.testing.assert_close(view.pictures["photo_1"], photo, atol=STEP / 2, rtol=0)
    alone = make_view(fit_of(shown, theta, Task("cloth", {})))
    assert list(alone.facts["lit"]) == list(relighting_positions())
    assert "photo_1" not in alone.pictures


def test_a_view_holds_true_maps_and_where_fits_place_their_photographs() -> None:
    shown, theta, task = nonstationary()
    view, files = make_view(fit_of(shown, theta, task)), asset_of(shown, theta, task).pictures()
    truth = rock_surface(64, tiles=False).maps
    assert_same(maps_in(view, "reference"), truth)
    maps, lit = maps_in(view), view.facts["lit"]
    assert list(lit) == [*(f"photo_{i + 1}" for i in range(PHOTOS)), *relighting_positions()]
    for name in ("photo_1", "photo_3"):
        light, eye = (torch.tensor(lit[name][key]) for key in ("light", "eye"))
        again = render_maps(maps, texel_positions(64, 64), light, eye, intensity=lit[name]["gain"])
        torch.testing.assert_close(
            again.clamp(0, 1), decode_photo(255 * files[name].pixels.movedim(-1, 0)), atol=5e-3, rtol=0
        )
    torch.testing.assert_close(
        view.pictures["photo_2"],
        radiance_to_display(decode_photo(task.data["others"][0])).movedim(0, -1),
        atol=1e-6,
        rtol=0,
    )
    assert not view.facts["tiles"]
    with pytest.raises(KeyError):
        make_view(fit_of(shown, theta, Task("rock", {})))


def test_heights_of_normals_do_not_drift_over_a_map() -> None:
    """The wave on a dome remains and the dome does not; heights that a fit has stay as they are."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, 64), torch.linspace(-1, 1, 64), indexing="ij")
    wave = 0.004 * torch.sin(40 * x)
    slopes = torch.gradient(wave + 0.2 * (1 - x * x - 0.5 * y * y + 0.3 * x), spacing=2 / 63)
    normal = normalize(torch.stack([-slopes[1], slopes[0], torch.ones(64, 64)]), dim=0)
    ones = torch.ones(1, 64, 64)
    maps = Maps(ones.expand(3, -1, -1), ones, ones, normal)
    view = make_surface_view(Surface(maps, False), {})
    heights = torch.lerp(*torch.tensor(view.facts["heights"]), view.pictures["height"][..., 0])
    torch.testing.assert_close(heights[8:-8, 8:-8], (wave / 2)[8:-8, 8:-8], atol=1e-3, rtol=0)
    known = make_surface_view(Surface(maps, False, ones * torch.linspace(0, 6.4, 64)), {})
    assert np.ptp(known.facts["heights"]) == pytest.approx(0.1, abs=1e-6)


def test_large_maps_are_reduced() -> None:
    """Texels are averaged; heights in widths of the texture stay the same."""
    large = rock_surface(128)
    view = make_surface_view(large, {}, largest=64)
    assert (view.facts["size"], view.facts["shown"]) == ([128, 128], [64, 64])
    maps = maps_in(view)
    torch.testing.assert_close(
        maps.diffuse, large.maps.diffuse.unfold(1, 2, 2).unfold(2, 2, 2).mean((3, 4)), atol=1e-5, rtol=0
    )
    torch.testing.assert_close(maps.normal, large.maps.normal[:, ::2, ::2], atol=0.02, rtol=0)
    heights = large.heights_in_widths()
    assert view.facts["heights"] == pytest.approx([float(heights.min()), float(heights.max())], rel=2e-3)
    assert view.pictures["fit_specular"].shape[-1] == 3
    gray = replace(large, maps=large.maps._replace(specular=large.maps.specular[:1]))
    assert make_surface_view(gray, {}).pictures["fit_specular"].shape[-1] == 1


@pytest.mark.long
def test_screen_shows_fit_and_reference_of_the_rock_surface(open_page: Callable) -> None:
    """Of glossy metal and stone; the reference is the photograph under its flash, which lies aside, else true maps."""
    fit, truth = rock_surface(64), rock_surface(64, tiles=False).maps
    light, eye = torch.tensor([0.3, -0.2, 2.0]), torch.tensor([-0.1, 0.4, 2.2])
    photo = torch.rand(3, 64, 64, generator=seeded())
    truth = truth._replace(roughness=0.5 * truth.roughness)
    shown = Photograph(light, eye, 0.7, pixels=photo, shown_share=0.5)
    page = open_page(make_surface_view(replace(fit, falloff=2), {"photo_1": shown}, reference=truth))
    page.resize(64, 64)
    page.set(view="picture", pictured="photo_1", show="reference")
    page.settle()
    assert_pictures_match(page.screenshot(), radiance_to_display(photo).movedim(0, -1).numpy())
    page.set(pictured="above")
    page.settle()
    expected = radiance_to_display(
        render_maps(truth, texel_positions(64, 64), *relighting_positions()["above"], falloff=2)
    )
    assert_pictures_match(page.screenshot(), expected.movedim(0, -1).numpy())
    page.set(show="fit", map="normal")
    page.settle()
    assert_pictures_match(page.screenshot(), (fit.maps.normal / 2 + 0.5).movedim(0, -1).numpy())
    page.set(map="lit", pictured="photo_1")
    page.resize(32, 32)  # a texel a pixel
    page.settle()
    part = Maps(*(part[:, :32, :32] for part in fit.maps))
    expected = radiance_to_display(render_maps(part, texel_positions(32, 32), light, eye, intensity=0.7, falloff=2))
    assert_pictures_match(page.screenshot(), expected.movedim(0, -1).numpy())


@pytest.mark.long
@pytest.mark.parametrize("tiles", [True, False])
def test_copies_tile_or_are_mirrored(tiles: bool, open_page: Callable) -> None:
    page = open_page(make_surface_view(rock_surface(64, tiles=tiles), {}))
    page.resize(134, 134)  # where the plane is 100 px wide
    page.set(map="normal", repeats=2, relief=0)
    page.settle()
    plane = page.screenshot()[17:117, 17:117]
    copies = plane[:50, :50], plane[:50, 50:], plane[50:, :50]
    first, right, below = (picture[4:-4, 4:-4] for picture in copies)
    mirrored = (  # what leans to the right leans to the left in the mirror
        np.concatenate([1 - first[:, ::-1, :1], first[:, ::-1, 1:]], -1),
        np.concatenate([first[::-1, :, :1], 1 - first[::-1, :, 1:2], first[::-1, :, 2:]], -1),
    )
    for copy, in_mirror in zip((right, below), mirrored, strict=True):
        apart = [float(np.abs(copy - tile).mean()) for tile in (first, in_mirror)]
        assert apart[tiles] > 4 * apart[not tiles]


@pytest.mark.long
def test_a_light_map_lights_tilted_normals(open_page: Callable) -> None:
    """A uniform map makes of a material what the hemisphere above the surface sends through it."""
    ones = torch.ones(1, 8, 8)
    normal = normalize(torch.tensor([0.4, -0.2, 1.0]), dim=0)[:, None, None] * ones
    maps = Maps(0.4 * ones.expand(3, -1, -1), 0.3 * ones, 0.3 * ones, normal)
    view = make_surface_view(Surface(maps, True, ones), {})
    white = view._replace(shared={"light": torch.ones(8, 16, 3).half()})
    page = open_page(white)
    page.resize(48, 48)
    page.set(light="map", relief=0)
    page.page.evaluate("metapp.viewer.most = () => 96")
    page.settle()
    middle = float(page.screenshot()[18:30, 18:30].mean())
    assert middle == pytest.approx(float(radiance_to_display(0.5 * white_light(maps)).mean()), abs=0.012)


def white_light(maps: Maps) -> Tensor:
    """What the first texel of maps reflects of white light to a viewer above, [3]."""
    rows, columns = 256, 512
    z = (torch.arange(rows) + 0.5) / rows
    phi = (torch.arange(columns) + 0.5) * (math.tau / columns)
    radius = (1 - z * z).sqrt()[:, None]
    wi = torch.stack([radius * phi.cos(), radius * phi.sin(), z[:, None].expand(rows, columns)])
    texel = Maps(*(part[:, :1, :1] for part in maps))
    wo = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    cosine = (wi * texel.normal).sum(0).clamp_min(0)
    return (evaluate_brdf(texel, wi, wo.expand_as(wi)) * cosine).sum((1, 2)) * (math.tau / (rows * columns))


@pytest.mark.long
def test_a_fitted_light_of_the_page_lights_materials(open_page: Callable) -> None:
    """The studio is white here, the fitted map red; the later of two choices counts."""
    ones = torch.ones(1, 8, 8)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None] * ones
    maps = Maps(0.4 * ones.expand(3, -1, -1), 0.04 * ones, 0.6 * ones, up)
    material = make_surface_view(Surface(maps, True, ones), {})
    material = material._replace(shared={"light": torch.ones(8, 16, 3).half()})
    red = torch.tensor([1.0, 0.0, 0.0]).expand(8, 16, 3).half()
    light = View("light", {"map": red}, facts={"scale": 1.0, "note": ""})
    page = open_page(material, light)
    page.resize(48, 48)
    page.page.evaluate("metapp.viewer.most = () => 64")
    assert page.page.evaluate("metapp.viewer.environments()") == [["studio", "Studio"], ["1", "fit 1"]]
    colours = []
    for choices in (["1"], ["studio", "1"], ["1", "studio"]):
        page.set(light="map")
        for choice in choices:
            page.set(environment=choice)
        page.settle()
        colours.append(page.screenshot()[18:30, 18:30].mean((0, 1)))
    dusk, again, white = colours
    assert np.ptp(white) < 0.02 < 0.2 < dusk[0]
    assert dusk[1:].max() < 0.02 < 0.2 < white.min()
    np.testing.assert_allclose(again, dusk, atol=0.02)


@pytest.mark.long
def test_raised_parts_cast_shadows(open_page: Callable) -> None:
    """A ridge of height 0.1 under a lamp at 45 degrees on its left: the shadow is as long as the ridge is high."""
    ones, height = torch.ones(1, 256, 256), torch.zeros(1, 256, 256)
    height[..., 118:138] = 0.1 * 256  # texels
    flat = torch.tensor([0.0, 0.0, 1.0])[:, None, None] * ones
    maps = Maps(0.5 * ones.expand(3, -1, -1), 0.02 * ones, 0.9 * ones, flat)
    page = open_page(make_surface_view(Surface(maps, True, height), {}))
    page.resize(268, 268)  # where the plane is 200 px wide
    far = "{ light: 'lamp', lamp: new THREE.Vector3(-1e3, 0, 1e3), power: Math.PI * 2e6 }"
    page.page.evaluate(f"metapp.viewer.lighting = () => ({far})")
    rows = {}
    for relief in (0, 1):
        page.set(relief=relief, surround=False)
        page.settle()
        rows[relief] = page.screenshot()[134, 36:232].mean(-1)  # the plane, but for its rim
    share = rows[1] / rows[0]
    ridge, length = 200 * 138 / 256 - 2, 200 * 0.1
    beyond = slice(round(ridge + 0.2 * length), round(ridge + 0.8 * length))
    assert share[beyond].max() < 0.1
    assert share[round(ridge + 1.3 * length) :].min() > 0.97
    assert share[: round(200 * 100 / 256)].min() > 0.97
