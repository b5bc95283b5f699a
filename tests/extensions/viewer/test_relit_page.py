"""Photographs under many lamps on pages of `metapp view`: relit as metapp relights them, by a lamp that is dragged."""

import base64
import functools
import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, grid_sample, normalize

from metapp.appearance.colour import linear_to_srgb, radiance_to_display
from metapp.appearance.distant_lamps import render_lit
from metapp.appearance.flash import relighting_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.rti.lit_photos import LitPhotos
from metapp.apps.svbrdf_nonstationary.rti.recipe import RTI
from metapp.apps.svbrdf_nonstationary.rti.relit_planes import make_relit_planes
from metapp.extensions.viewer.pages.relit import PLANE_COUNT, TABLE_SIDE, add_relit_photos, table_directions
from metapp.extensions.viewer.view import View, make_view
from metapp.extensions.viewer.viewer_page import FitGroup, page_document
from metapp.learning.task import Params, Task
from tests.apps.rti.scenes import dome, lit_task, photograph, wavy_maps
from tests.browser import Page, assert_pictures_match
from tests.recipe_apps import asset_of, fit_of

SIDE = 64
STEP = 1 / 255
LAMPS = normalize(torch.tensor([[0.0, 0, 1], [0.5, 0.7, 0.5], [-0.8, 0.1, 0.3], [0.1, -0.9, 0.1]]), dim=1)
EMPTY = View("surface")


def random_theta() -> Params:
    return {name: value[0] for name, value in RTI.app.init(torch.Generator().manual_seed(0), 1).items()}


@functools.cache
def shown(lamps: int = PLANE_COUNT, height: int = SIDE) -> tuple[View, Task]:
    """A fit of glossy waves by photographs under lamps."""
    task = lit_task(SIDE, lamps, specular=0.04)
    cut = {name: task.data[name][..., :height, :] for name in ("photo", "lit", "maps")}
    task = task._replace(data=task.data | cut)
    return make_view(fit_of(RTI.app, random_theta(), task)), task


def relit_by_metapp(task: Task, lamps: Tensor) -> Tensor:
    """Display values [K, H, W, 3]."""
    return linear_to_srgb(RTI.app.sight.lit_photos(task).relight(lamps)).permute(0, 2, 3, 1)


def relit_by_page(view: View, lamps: Tensor) -> Tensor:
    """Mix the planes that a page's text holds, display values [K, H, W, 3], as its scripts do."""
    pictures = page_document("", [FitGroup("", "", [view])])["groups"][0]["fits"][0]["pictures"]
    ranges = view.facts["relit"]["ranges"]
    planes = [
        low + (high - low) * decode_picture(pictures[f"plane_{number}"]) for number, (low, high) in enumerate(ranges)
    ]
    table = view.arrays["weights"].float().unflatten(0, (-1, TABLE_SIDE)).movedim(-1, 1).flatten(0, 1)[None]
    places = lamps[:, :2] / (1 + lamps[:, 2:]).sqrt()
    weights = grid_sample(table, places[None, None], align_corners=True)[0, : len(planes), 0]
    return torch.einsum("km,khwc->mhwc", weights, torch.stack(planes)).clamp(0, 1)


def decode_picture(address: str) -> Tensor:
    image = Image.open(io.BytesIO(base64.b64decode(address.partition("base64,")[2])))
    return torch.from_numpy(np.asarray(image, dtype=np.float32) / 255)


# What a view holds


@pytest.mark.parametrize(("lamps", "height"), [(3, SIDE), (7, SIDE // 2), (PLANE_COUNT, SIDE)])
def test_a_page_relights_as_metapp_does(lamps: int, height: int) -> None:
    """Nothing is lost beside 8 bits where there are as many planes as photographs."""
    view, task = shown(lamps, height)
    assert len(view.facts["relit"]["ranges"]) == lamps
    torch.testing.assert_close(relit_by_page(view, LAMPS), relit_by_metapp(task, LAMPS), atol=STEP, rtol=0)


def test_a_page_relights_by_few_planes_of_many_photos() -> None:
    """What is lost is what the planes leave out."""
    view, task = shown(40)
    relit = make_relit_planes(RTI.app.sight.lit_photos(task), PLANE_COUNT)
    expected = torch.einsum("mk,kchw->mhwc", relit.weights(LAMPS), relit.planes).clamp(0, 1)
    torch.testing.assert_close(relit_by_page(view, LAMPS), expected, atol=STEP, rtol=0)
    assert float((expected - relit_by_metapp(task, LAMPS)).square().mean().sqrt()) < 2 * STEP


def test_the_lamp_of_a_view_comes_first_and_is_distant() -> None:
    view, _ = shown()
    name, *others = view.facts["lit"]
    assert name == "relit"
    assert others == list(relighting_positions())
    assert view.facts["lit"]["relit"]["light"][2] > 100


def test_directions_lie_where_the_handle_of_the_lamp_does() -> None:
    """At sqrt(1 - z) from the middle, rows from below upwards."""
    directions, across = table_directions(), torch.linspace(-1, 1, TABLE_SIDE)
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(TABLE_SIDE, TABLE_SIDE))
    torch.testing.assert_close(1 - directions[..., 2], across[:, None].square() + across.square(), atol=1e-6, rtol=0)
    assert bool((directions[-1, 1:-1, 1] > 0).all())
    assert bool((directions[1:-1, -1, 0] > 0).all())


def test_large_photos_are_reduced_and_kept_with_small_loss() -> None:
    lamps = dome(3)
    photos = photograph(wavy_maps(1100), lamps)
    view = add_relit_photos(EMPTY, LitPhotos(photos, lamps))
    assert {tuple(picture.shape) for picture in view.pictures.values()} == {(1024, 1024, 3)}
    assert set(view.lossy) == set(view.pictures)
    relit = make_relit_planes(LitPhotos(photos, lamps), 3)
    expected = adaptive_avg_pool2d(torch.einsum("mk,kchw->mchw", relit.weights(LAMPS), relit.planes), 1024)
    errors = relit_by_page(view, LAMPS) - expected.clamp(0, 1).permute(0, 2, 3, 1)
    assert float(errors.square().mean().sqrt()) < STEP


def test_small_photos_are_kept_without_loss() -> None:
    view, _ = shown()
    assert view.lossy == ()


def test_a_view_needs_the_photos() -> None:
    with pytest.raises(KeyError):
        make_view(fit_of(RTI.app, {}, Task("waves", {})))


# What the page shows

LAMP = "metapp.viewer.lampAt.toArray()"
FROM, TO = (30, 34), (12, 44)  # px of the page, beside the lamp's handle


def put_lamp(page: Page, lamp: Tensor) -> None:
    page.page.evaluate(f"metapp.viewer.putLamp(new THREE.Vector3(...{lamp.tolist()}))")
    page.settle()


def open_at_full_size(open_page: Callable, **settings: Any) -> Page:
    page: Page = open_page(shown()[0])
    page.resize(SIDE, SIDE)
    page.set(**settings)
    page.settle()
    return page


@pytest.mark.long
def test_the_screen_shows_photos_and_maps_under_one_lamp(open_page: Callable) -> None:
    page, (_, task) = open_at_full_size(open_page, show="reference"), shown()
    assert page.page.evaluate("[metapp.settings.view, metapp.settings.pictured]") == ["picture", "relit"]
    for lamp, expected in zip(LAMPS, relit_by_metapp(task, LAMPS), strict=True):
        put_lamp(page, lamp)
        assert_pictures_match(page.screenshot(), expected.numpy())
    page.set(show="fit")
    put_lamp(page, LAMPS[1])
    surface = asset_of(RTI.app, random_theta(), task)
    texels = Maps(*(part[None].flatten(2)[..., None] for part in surface.maps))
    radiance = render_lit(texels, LAMPS[1][None, None])[0, 0].unflatten(-1, (SIDE, SIDE))
    assert_pictures_match(page.screenshot(), radiance_to_display(radiance).permute(1, 2, 0).numpy())


@pytest.mark.long
def test_wide_photos_are_shown_whole(open_page: Callable) -> None:
    """Twice as wide as high, a texel a px in a square pane, and then enlarged."""
    view, task = shown(height=SIDE // 2)
    page = open_page(view)
    page.resize(SIDE, SIDE)
    page.set(show="reference")
    put_lamp(page, LAMPS[1])
    expected = relit_by_metapp(task, LAMPS[1:2])[0].numpy()
    above = SIDE // 4
    assert_pictures_match(page.screenshot()[above:-above], expected)
    page.page.evaluate("metapp.viewer.framing.zoomBy(2, { clientX: 32, clientY: 32 })")
    page.settle()
    middle = expected[SIDE // 8 : -SIDE // 8, SIDE // 4 : -SIDE // 4].repeat(2, 0).repeat(2, 1)
    assert np.abs(page.screenshot()[above:-above] - middle).mean() < 4 * STEP


@pytest.mark.long
@pytest.mark.parametrize("way", ["over the picture", "by its handle", "by keys", "by a finger"])
def test_a_lamp_that_moves_relights_the_photos(way: str, open_page: Callable) -> None:
    """The picture is metapp's under the lamp where it was moved, and no longer the one before."""
    page, (_, task) = open_at_full_size(open_page, show="reference"), shown()
    (before,) = relit_by_metapp(task, torch.tensor([page.page.evaluate(LAMP)]))
    if way == "by keys":
        page.page.locator("canvas").first.focus()
        for _ in range(16):
            page.page.keyboard.press("ArrowLeft")
        page.page.evaluate("document.activeElement.blur()")  # whose frame lies over the picture
    elif way == "by a finger":
        session = page.page.context.new_cdp_session(page.page)
        for kind, *points in [("touchStart", FROM), ("touchMove", (20, 40)), ("touchMove", TO), ("touchEnd",)]:
            touches = [{"x": x, "y": y} for x, y in points]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})
    else:
        box = page.page.locator(".lamp").bounding_box()
        start = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2) if way == "by its handle" else FROM
        page.page.mouse.move(*start)
        page.page.mouse.down()
        page.page.mouse.move(*TO, steps=3)
        page.page.mouse.up()
    page.settle()
    end, after = torch.tensor(page.page.evaluate(LAMP)), page.screenshot()
    assert float(end[0]) < -0.3
    (expected,) = relit_by_metapp(task, end[None])
    assert_pictures_match(after, expected)
    assert float((before - expected).abs().mean()) > 5 * np.abs(after - expected.numpy()).mean()


@pytest.mark.long
def test_the_lamp_stays_above_the_horizon(open_page: Callable) -> None:
    page = open_at_full_size(open_page)
    put_lamp(page, normalize(torch.tensor([0.6, 0.0, -0.8]), dim=0))
    assert page.page.evaluate(LAMP) == pytest.approx([1, 0, 0], abs=1e-6)


@pytest.mark.long
def test_diffuse_gain_and_highlights_follow_the_normals(open_page: Callable) -> None:
    """Malzbender et al. 2001: the value under a lamp along the normal stays; (n . h)^exponent is added."""
    page, (view, task) = open_at_full_size(open_page, show="reference"), shown()
    x_and_y = (view.pictures["fit_detail"][..., :2] * 255 - 128) / 127
    normals = torch.cat([x_and_y, (1 - x_and_y.square().sum(-1, keepdim=True)).sqrt()], -1).reshape(-1, 3)
    relit = make_relit_planes(RTI.app.sight.lit_photos(task), PLANE_COUNT)
    planes = relit.planes.flatten(2)
    lamp = normalize(torch.tensor([0.3, 0.4, 0.9]), dim=0)
    plain = torch.einsum("k,kcp->cp", relit.weights(lamp[None])[0], planes)
    brightest = torch.einsum("pk,kcp->cp", relit.weights(normals), planes)
    put_lamp(page, lamp)
    page.set(gain=3.0)
    page.settle()
    expected = (brightest + 3 * (plain - brightest)).clamp(0, 1)
    assert_pictures_match(page.screenshot(), expected.reshape(3, SIDE, SIDE).permute(1, 2, 0).numpy())
    page.set(gain=1.0, highlight=0.5, body=0.4, power=20)
    page.settle()
    half = normalize(lamp + torch.tensor([0.0, 0, 1]), dim=0)
    expected = (0.4 * plain + 0.5 * (normals @ half).clamp_min(0) ** 20).clamp(0, 1)
    assert_pictures_match(page.screenshot(), expected.reshape(3, SIDE, SIDE).permute(1, 2, 0).numpy())


@pytest.mark.long
def test_pictures_are_enlarged_and_moved(open_page: Callable) -> None:
    """The wheel enlarges what lies at the pointer, another button moves it, and the lamp stays."""
    page, (_, task) = open_at_full_size(open_page, show="reference"), shown()
    put_lamp(page, LAMPS[1])
    expected = relit_by_metapp(task, LAMPS[1:2])[0].numpy()
    page.page.evaluate("metapp.viewer.framing.zoomBy(2, { clientX: 0, clientY: 0 })")
    page.settle()
    quarter = expected[: SIDE // 2, : SIDE // 2].repeat(2, 0).repeat(2, 1)
    assert np.abs(page.screenshot() - quarter).mean() < 4 * STEP
    page.page.mouse.move(40, 40)
    page.page.mouse.down(button="right")
    page.page.mouse.move(8, 8, steps=2)
    page.page.mouse.up(button="right")
    page.settle()
    middle = expected[SIDE // 4 : -SIDE // 4, SIDE // 4 : -SIDE // 4].repeat(2, 0).repeat(2, 1)
    assert np.abs(page.screenshot() - middle).mean() < 4 * STEP
    assert page.page.evaluate(LAMP) == pytest.approx(LAMPS[1].tolist(), abs=1e-6)
