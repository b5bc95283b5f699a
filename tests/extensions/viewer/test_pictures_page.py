"""Pictures on pages of `metapp view`: they agree with metapp's to the texel, and so do the comparisons."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from data_tools.synthetic.cornell import random_scene
from metapp.appearance.colour import tone_map
from metapp.appearance.metrics import mape
from metapp.appearance.pictures import Picture
from metapp.apps.exemplar.exemplar_codec import FILE_SIDE_TIMES
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.texture.app import compose_texture
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.scene_renderer import REGULAR
from metapp.extensions.viewer.pages import transport as pages
from metapp.extensions.viewer.pages.flat import QUILTED_SIDE_RATIO
from metapp.extensions.viewer.view import View, make_view
from metapp.learning.task import Params, Task
from metapp.networks.generators import UNet
from metapp.rendering.scenes.stored_text import encode_scene
from metapp.runs.outputs.fit_files import write_pictures
from tests.browser import LEGEND_PX, Page, assert_pictures_match, error_colours, open_browser
from tests.extensions.viewer.conftest import write_view_page
from tests.needs_mitsuba import needs_mitsuba
from tests.recipe_apps import asset_of, fit_of

SIZE = 32
WHOLE = FILE_SIDE_TIMES * SIZE
SHOWN = compose_texture(UNet(8, 3, noise=4, code=8), Octaves(SIZE, SIZE, ("relu1_1",)))


def theta_of(seed: int = 0) -> Params:
    return {key: value[0] for key, value in SHOWN.init(Generator().manual_seed(seed), 1).items()}


def coloured(height: int, width: int, seed: int = 0) -> Tensor:
    """Smooth colours [height, width, 3] in [0, 1]."""
    coarse = torch.rand(1, 3, 6, 6, generator=Generator().manual_seed(seed))
    return interpolate(coarse, size=(height, width), mode="bicubic")[0].permute(1, 2, 0).clamp(0, 1)


def exemplar_of(side: int = SIZE) -> Task:
    return Task("bark", {"image": (255 * coloured(side, side)).round().to(torch.uint8).permute(2, 0, 1)})


def light_of(seed: int, noise: float) -> Tensor:
    """Radiance [48, 64, 3] of a tiny unit, with bright spots, as half floats hold it."""
    rng = Generator().manual_seed(seed)
    spots = coloured(48, 64) ** 6 * 40 + 0.1
    return (1e-3 * spots * torch.exp(noise * torch.randn(48, 64, 3, generator=rng))).half().float()


LIGHT = {"reference": light_of(0, 0.0), "noisy": light_of(1, 0.3), "noisier": light_of(2, 0.6)}


def lit() -> View:
    """Return a view as scenes have it: a reference and two pictures."""
    pictures = [{"title": name, "name": name} for name in LIGHT]
    facts = {"pictures": pictures, "reference": "reference", "notes": ["Rendered here."]}
    return View("pictures", {name: light.half() for name, light in LIGHT.items()}, {}, facts)


def in_rows() -> View:
    """Return views as scenes have them, with a part, a curve and an error map."""
    region, chart = (
        [8, 12, 16, 12],
        {"x": "s", "y": "MAPE", "lines": [{"label": "noisy", "points": [[1, 1], [4, 0.5]]}]},
    )
    shown = [{"title": name, "name": name, "row": 0} for name in ("reference", "noisy")]
    shown += [
        {"title": "part", "name": "noisy", "part": region, "row": 1},
        {"title": "curve", "chart": chart, "row": 1},
    ]
    shown.append({"title": "error", "name": "noisy", "error": True, "row": 2})
    return lit()._replace(facts={"pictures": shown, "reference": "reference", "region": region})


# What views hold


def test_a_texture_is_shown_as_its_file_beside_the_exemplar() -> None:
    theta, task = theta_of(), exemplar_of()
    view = make_view(fit_of(SHOWN, theta, task))
    assert [(picture["title"], picture["tiles"]) for picture in view.facts["pictures"]] == [
        ("exemplar", "seams"),
        ("fit", "whole"),
        ("image quilting", "seams"),
    ]
    assert torch.equal(view.pictures["fit"], asset_of(SHOWN, theta, task).pictures()["texture"].pixels)
    exemplar, quilted = view.pictures["exemplar"], view.pictures["image quilting"]
    assert torch.equal((255 * exemplar).round().to(torch.uint8), task.data["image"].permute(1, 2, 0))
    assert quilted.shape == (QUILTED_SIDE_RATIO * SIZE, QUILTED_SIDE_RATIO * SIZE, 3)
    assert {tuple(texel) for texel in quilted.reshape(-1, 3).tolist()} <= {
        tuple(texel) for texel in exemplar.reshape(-1, 3).tolist()
    }
    alone = make_view(fit_of(SHOWN, theta, Task("bark", {})))
    assert [picture["title"] for picture in alone.facts["pictures"]] == ["fit"]


@pytest.mark.long
@needs_mitsuba
def test_a_scene_is_shown_in_equal_time_and_traced_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    effort = pages.Effort(side_px=16, seconds=0.5, reference_seconds=0.2)
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path))
    flow = Flow(rows=4, columns=4, code=3, hidden=8, bins=5, film_bins=8, blobs=6)
    task = Task("room", {"scene": encode_scene(random_scene(0))})
    theta = {key: value[0] for key, value in flow.init(Generator().manual_seed(0), 1).items()}
    view = pages.make_scene_view(flow, theta, task, effort)
    shown = {picture["title"]: picture for picture in view.facts["pictures"]}
    names = ("reference", REGULAR, pages.GUIDED_LABEL)
    worst = [f"worst region x4, {name}" for name in names]
    assert list(shown) == [*names, *worst, "error by time", f"error, {REGULAR}", f"error, {pages.GUIDED_LABEL}"]
    assert {tuple(array.shape) for array in view.arrays.values()} == {(16, 16, 3)}
    light = {name: view.arrays[name].float().permute(2, 0, 1)[None] for name in names}
    assert float(light["reference"].mean()) == pytest.approx(1, rel=1e-3)
    for line in shown["error by time"]["chart"]["lines"]:
        seconds, errors = zip(*line["points"], strict=True)
        assert sorted(seconds) == list(seconds)
        assert float(mape(light[line["label"]], light["reference"])) == pytest.approx(errors[-1], rel=0.01)
    assert view.facts["notes"][0].startswith("To a MAPE of ")
    again = pages.make_scene_view(flow, theta, task, effort)  # seconds would not be the same if it were traced again
    assert (again.facts, list(again.arrays)) == (view.facts, list(view.arrays))


def test_the_time_to_an_equal_error_is_between_measurements() -> None:
    """Times are interpolated on a log scale.

    Errors go with the root of time, so a guide of half the error needs a quarter of it.
    """
    seconds, one = torch.tensor([1.0, 4.0, 16.0]), torch.zeros(3, 4, 4)
    regular = pages.RenderingProgress(one, seconds, seconds**-0.5, torch.tensor(16))
    guided = pages.RenderingProgress(one, seconds, 0.75 * seconds**-0.5, torch.tensor(16))
    output, level = pages.compare_at_equal_error(regular, guided)
    assert level == 0.25
    assert output == "To a MAPE of 0.25: regular 16 s, guided by the fit 9 s, 0.56 of the time."
    output, _ = pages.compare_at_equal_error(guided, regular)
    assert output.endswith("1.8 times as long.")


def test_the_worst_region_is_where_errors_are_greatest() -> None:
    reference = torch.ones(3, 32, 32)
    picture = reference.clone()
    picture[:, 9:17, 20:28] = 1.5
    picture[0, 0, 0] = 1e6
    assert pages.find_worst_region(picture, reference) == [20, 9, 8, 8]


# What the page shows of them


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A texture by two fits, and lights by one."""
    views = [make_view(fit_of(SHOWN, theta_of(seed), exemplar_of())) for seed in (0, 1)]
    textures = [view._replace(label=f"seed {seed}", caption="error 0.1") for seed, view in enumerate(views)]
    file = write_view_page(tmp_path_factory.mktemp("page"), textures[:1], textures, lit(), in_rows())
    with open_browser() as browser:
        opened = Page(browser, file)
        yield opened
        assert opened.problems == []


FIRST = {"show": "all", "scale": 0.2, "exposure": 0, "tiles": 1, "seams": False, "zoom": -6, "x": 0, "y": 0}


def seen(page: Page, group: int, size: tuple[int, int], **settings: Any) -> np.ndarray:
    """A group at a size, width and height in px; what settings do not name is as at first."""
    page.page.evaluate(f"metapp.open({group})")
    page.resize(*size)
    page.set(**(FIRST | settings))
    page.settle()
    return page.screenshot()


def pixels_of(picture: Tensor) -> np.ndarray:
    """Return display values as a PNG of 8 bits stores them."""
    pixels: np.ndarray = (np.clip(picture.numpy(), 0, 1) * 255 + 0.5).astype(np.uint8) / 255
    return pixels


def assert_same_as_file(screen: np.ndarray, picture: Picture, folder: Path) -> None:
    write_pictures({"picture": picture}, folder)
    file = np.asarray(Image.open(folder / "picture.png").convert("RGB")) / 255
    assert_pictures_match(screen, file)


@pytest.mark.long
def test_radiance_is_as_metapp_writes_it(page: Page, tmp_path: Path) -> None:
    settings = {"show": "one", "one": "reference", "zoom": 0}
    screen = seen(page, 2, (64, 48), **settings)
    assert_same_as_file(screen, Picture(LIGHT["reference"], "radiance"), tmp_path)
    brighter = seen(page, 2, (64, 48), **settings, exposure=1)
    twice = 2 * LIGHT["reference"] / LIGHT["reference"].mean()
    assert np.abs(brighter - pixels_of(tone_map(twice))).max() <= 1.01 / 255


@pytest.mark.long
def test_tiles_repeat_and_seams_are_marked(page: Page) -> None:
    settings = {"show": "one", "tiles": 2, "zoom": 0}
    fit = pixels_of(make_view(fit_of(SHOWN, theta_of(), exemplar_of())).pictures["fit"])
    tiled = seen(page, 0, (2 * WHOLE, 2 * WHOLE), one="fit", **settings)
    assert np.array_equal(np.round(255 * tiled), np.round(255 * np.tile(fit, (2, 2, 1))))
    exemplar = seen(page, 0, (2 * WHOLE, 2 * WHOLE), one="exemplar", **settings)
    assert np.array_equal(exemplar[SIZE:], exemplar[:-SIZE])
    marked = seen(page, 0, (2 * WHOLE, 2 * WHOLE), one="exemplar", seams=True, **settings)
    columns = np.flatnonzero((marked != exemplar).any(2).all(0))
    assert columns.tolist() == [*range(0, 2 * WHOLE, SIZE), 2 * WHOLE - 1]


@pytest.mark.long
def test_wipe_and_difference_compare_the_chosen_pictures(page: Page) -> None:
    pictures = {
        name: pixels_of(picture)
        for name, picture in make_view(fit_of(SHOWN, theta_of(), exemplar_of())).pictures.items()
    }
    fit, exemplar = pictures["fit"], np.tile(pictures["exemplar"], (FILE_SIDE_TIMES, FILE_SIDE_TIMES, 1))
    pair = {"left": "fit", "right": "exemplar", "zoom": 0}
    screen = seen(page, 0, (WHOLE, WHOLE), show="wipe", wipe=0.25, **pair)
    cut = WHOLE // 4
    assert np.abs(screen - np.concatenate([fit[:, :cut], exemplar[:, cut:]], 1)).max() < 0.5 / 255
    differs = seen(page, 0, (SIZE, SIZE + LEGEND_PX), show="difference", scale=0.5, **pair)
    apart = np.abs(fit[:SIZE, :SIZE] - pictures["exemplar"]).mean(-1)
    assert np.abs(differs[:SIZE] - error_colours(apart, 0.5)).max() < 1.01 / 255
    label = page.page.locator(".scale:not([hidden])").get_attribute("aria-label")
    assert label.startswith("|left \u2212 right| of display values: colours from 0 to 50 %; mean ")
    assert f"mean {100 * apart.mean():.3g} %" in label


@pytest.mark.long
def test_texels_are_squares_that_stay_under_the_pointer(page: Page) -> None:
    fit = pixels_of(make_view(fit_of(SHOWN, theta_of(), exemplar_of())).pictures["fit"])
    screen = seen(page, 0, (WHOLE, WHOLE), show="one", one="fit", zoom=2, x=10, y=-7)
    middle = WHOLE // 2
    rows, columns = (slice(middle + shift - WHOLE // 8, middle + shift + WHOLE // 8) for shift in (-7, 10))
    assert np.abs(screen - fit[rows, columns].repeat(4, 0).repeat(4, 1)).max() < 0.5 / 255
    picked = "(({raster, x, y}) => [x, y])(metapp.viewer.pick([30, 90]))"
    before = page.page.evaluate(picked)
    page.page.mouse.move(30, 90)
    label = page.page.locator(".pointed").text_content()
    values = ", ".join(str(round(255 * value)) for value in fit[before[1], before[0]])
    assert label == f"fit, texel {before[0]}, {before[1]}: {values} of 255"
    page.page.mouse.wheel(0, -500)
    page.page.wait_for_function("metapp.settings.zoom === 3")
    assert page.page.evaluate(picked) == before
    page.page.mouse.down()
    page.page.mouse.move(30 + 16, 90)
    page.page.mouse.up()
    assert page.page.evaluate(picked) == [before[0] - 2, before[1]]


@pytest.mark.long
def test_errors_on_the_page_agree_with_metrics(page: Page) -> None:
    seen(page, 2, (200, 200), show="error")
    labels = page.page.locator(".label").all_text_contents()
    for name in ("noisy", "noisier"):
        expected = float(mape(*(LIGHT[title].permute(2, 0, 1)[None] for title in (name, "reference"))))
        assert f"{name}, MAPE {expected:.3g}" in labels


@pytest.mark.long
def test_errors_parts_and_curves_stand_in_rows(page: Page) -> None:
    """The error map has its scale; the enlarged part is what the region holds."""
    page.page.evaluate("metapp.open(3)")
    page.resize(400, 400 + 3 * LEGEND_PX)
    page.set(show="all", zoom=-6, most=1)
    page.settle()
    places = page.page.evaluate("metapp.viewer.panels.map(({ titles: [title], x, y }) => [title, x > 0, y > 0])")
    assert places == [
        ["reference", False, False],
        ["noisy", True, False],
        ["part", False, True],
        ["curve", True, True],
        ["error", True, True],  # in the middle of its row
    ]
    label = page.page.locator(".scale:not([hidden])").evaluate_all("all => all.map((each) => each.ariaLabel)")
    assert label == ["|picture \u2212 reference| / reference: colours from 0 to 100 %"]
    middle = "const { x, y, width, height } = metapp.viewer.panels[2], place = [x + width / 2, y + height / 2]"
    found = "const at = metapp.viewer.pick(place), i = 3 * (at.y * at.raster.width + at.x)"
    x, y, value = page.page.evaluate(f"(() => {{ {middle}; {found}; return [at.x, at.y, at.raster.radiance[i]]; }})()")
    assert x in (7, 8)  # the middle is between them
    assert y in (5, 6)
    assert value == pytest.approx(float(LIGHT["noisy"][12 + y, 8 + x, 0]), rel=1e-3)


@pytest.mark.long
def test_fits_side_by_side_share_the_exemplar_and_the_viewed_place(page: Page) -> None:
    seen(page, 1, (606, 406), zoom=1, x=5)
    labels = page.page.locator(".label:not(.pointed)").all_text_contents()
    assert labels == ["exemplar", "seed 0: fit", "image quilting", "seed 1: fit"]
    picked = "metapp.viewer.pick([p.x + p.width / 2, p.y + p.height / 2])"
    middles = page.page.evaluate(f"metapp.viewer.panels.map((p) => {picked}.x - p.rasters[0].width / 2)")
    assert middles == [5, 5, 5, 5]
    seen(page, 1, (600, 400), show="wipe")
    labels = page.page.locator(".label:not(.pointed)").all_text_contents()
    assert labels == [f"seed {seed}, error 0.1: exemplar, repeated | fit" for seed in (0, 1)]
