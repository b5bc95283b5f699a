"""How pages of `metapp view` are used: views side by side, keys, handles, fingers, and views that cannot be drawn."""

import base64
import io
import json
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from metapp.appearance.assets import Photograph, Surface
from metapp.extensions.viewer.pages.flat import make_surface_view
from metapp.extensions.viewer.view import MAX_THUMBNAIL_PX, View, crop_thumbnail
from metapp.extensions.viewer.viewer_page import (
    VIEWER_KINDS,
    FitGroup,
    encode_array,
    encode_picture,
    page_document,
    viewer_html,
    write_page,
)
from tests.browser import Page, assert_pictures_match
from tests.surfaces import rock_surface

PANES = "metapp.viewer.panes.map(({ part, width, height }) => [part, width, height])"
HANDLES = "[...document.querySelectorAll('.lamp')].map((lamp) => [lamp.style.left, lamp.style.top])"


def surface(*, photo: bool = False) -> View:
    """A rock, whose reference is itself, so that fit and reference are the same picture."""
    fit = rock_surface(32, tiles=False)
    above = torch.tensor([0.0, 0.0, 3.0])
    lit = {"photo_1": Photograph(above, above, pixels=torch.rand(3, 32, 32))} if photo else {}
    return make_surface_view(Surface(fit.maps, False), lit, reference=fit.maps)


def pictures(name: str) -> View:
    shown = {title: torch.rand(8, 8, 3) for title in ("reference", "fit")}
    return View("pictures", pictures=shown, facts={"name": name}, thumbnail=crop_thumbnail(shown["fit"]))


def test_thumbnails_are_small_squares() -> None:
    assert crop_thumbnail(torch.rand(64, 300, 3)).shape == (64, 64, 3)
    gray = crop_thumbnail(torch.full((200, 100, 1), 0.5))
    assert gray.shape == (MAX_THUMBNAIL_PX, MAX_THUMBNAIL_PX, 3)
    assert float((gray - 0.5).abs().max()) < 1e-6


@pytest.mark.long
def test_a_page_opens_on_reference_and_fit_in_the_same_view(open_page: Callable) -> None:
    """Equal materials are equal pictures in both panes, under a lamp that a key moved, too; no wipe until asked for."""
    page = open_page(surface(), width=900, height=500)
    page.resize(206, 100)
    page.set(relief=0)
    page.settle()
    assert page.page.evaluate(PANES) == [["reference", 100, 100], ["fit", 100, 100]]
    assert page.page.locator(".wipe:visible").count() == 0
    before = page.screenshot()
    page.page.locator(".lamp").first.evaluate("lamp => lamp.style.visibility = 'visible'")
    page.page.locator(".lamp").first.press("ArrowRight")
    (first, second) = page.page.evaluate(HANDLES)
    assert first[1] == second[1]
    assert float(second[0][:-2]) - float(first[0][:-2]) == pytest.approx(106, abs=0.01)
    page.page.locator(".lamp").first.evaluate("lamp => lamp.style.visibility = 'hidden'")
    page.settle()
    after = page.screenshot()
    assert np.abs(after - before).max() > 0.05
    assert np.array_equal(after[:, :100], after[:, 106:])
    (numbers,) = page.page.evaluate("metapp.viewer.numbers")
    assert numbers == {"mean": 0, "rms": 0, "high": 0}
    page.set(show="wipe")
    assert page.page.evaluate(PANES) == [["wipe", 206, 100]]
    page.page.locator(".wipe").first.evaluate("wipe => wipe.style.visibility = 'visible'")
    page.page.locator(".wipe").first.press("ArrowLeft")
    page.page.locator(".wipe").first.press("Shift+ArrowLeft")
    assert page.page.evaluate("metapp.settings.wipe") == pytest.approx(0.39)


@pytest.mark.long
def test_keys_go_through_the_list_and_choose_what_is_compared(open_page: Callable) -> None:
    page = open_page(pictures("a"), pictures("b"), surface(), width=900, height=500, adapts=True)
    keys, index = page.page.keyboard, "metapp.index"
    assert page.page.locator("nav img").count() == 3
    for key, expected in (("ArrowDown", 1), ("ArrowDown", 2), ("ArrowDown", 2), ("Home", 0), ("ArrowRight", 1)):
        keys.press(key)
        page.page.wait_for_function(f"{index} === {expected}")
    assert page.page.inner_text("h1") == "fit 1"
    keys.press("d")
    assert page.page.evaluate("metapp.settings.show") == "difference"
    keys.press("d")
    assert page.page.evaluate("metapp.settings.show") == "all"
    keys.press("?")
    assert page.page.locator("dialog.help").is_visible()
    assert "move it by 5\u00b0" in page.page.inner_text("dialog.help")
    keys.press("Escape")
    page.page.wait_for_selector("dialog.help", state="hidden")
    keys.press("End")
    page.page.wait_for_function(f"{index} === 2 && metapp.viewer?.kind === 'surface'")
    keys.press("]")
    keys.press("w")
    assert page.page.evaluate("[metapp.settings.exposure, metapp.settings.show]") == [0.5, "wipe"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("view", "names"),
    [(pictures("a"), ["reference", "fit"]), (surface(photo=True), ["Photo", "Fit: meta"])],
    ids=["pictures", "surface"],
)
def test_narrow_pages_stack_panes_under_their_labels(open_page: Callable, view: View, names: list[str]) -> None:
    """They do so at once, also for a photo and its fit."""
    page = open_page(view, width=390, height=844, adapts=True)
    labels = page.page.locator(".label:not(.pointed):visible")
    assert labels.all_text_contents() == names
    boxes = [label.bounding_box() for label in labels.all()]
    assert [round(box["x"]) for box in boxes] == [4, 4]
    assert boxes[1]["y"] - boxes[0]["y"] > 250
    panes = page.page.evaluate("(metapp.viewer.panes ?? metapp.viewer.panels).map(({ y }) => y)")
    top = page.page.locator("#stage").bounding_box()["y"]
    for box, y in zip(boxes, panes, strict=True):
        assert box["y"] + box["height"] <= top + y + 1
    assert page.page.locator("#controls").is_hidden()
    page.page.click("#options")
    assert page.page.locator("#controls").is_visible()


# Views: which one is open, what handles change, what is left of one that cannot be drawn


PICTURES, LIGHT = 0, 1  # groups of the page
SPHERES = {"metal": 0.9, "albedo": 0.5, "specular": 0.04, "silver": {"roughness": 0.5}, "diffuse": {"roughness": 0.6}}


@pytest.fixture
def page(open_page: Callable) -> Page:
    """Two pictures, and a light with its reference."""
    pictures = View("pictures", pictures={name: torch.rand(8, 8, 3) for name in ("reference", "fit")})
    maps = {name: torch.rand(8, 16, 3).half() for name in ("map", "reference")}
    light = View("light", maps, facts={"scale": 1.0, "note": "", **SPHERES}, shared={"lobes": torch.ones(2, 32).half()})
    opened: Page = open_page(pictures, light, width=320, height=240)
    opened.resize(64, 64)
    return opened


def decode_in_browser(address: str) -> np.ndarray:
    """The pixels of a picture's address, [H, W, 3], of 255."""
    content = base64.b64decode(address.partition("base64,")[2])
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), np.float64)


def kinds(page: Page) -> tuple[str, int]:
    """The kind of the view that is open, and how many views the page holds."""
    shown = "[metapp.viewer?.kind ?? '', document.querySelectorAll('#stage > .view').length]"
    kind, count = page.page.evaluate(shown)
    return kind, count


@pytest.mark.long
@pytest.mark.parametrize("last", [PICTURES, LIGHT])
def test_of_two_views_that_open_at_once_the_last_one_stays(page: Page, last: int) -> None:
    page.page.evaluate(f"Promise.all([metapp.open({1 - last}), metapp.open({last})])")
    page.settle()
    assert kinds(page) == (["pictures", "light"][last], 1)
    assert page.page.evaluate("document.querySelectorAll('#stage canvas:not(.plot)').length") == 1


@pytest.mark.long
def test_a_wipe_follows_its_handle(page: Page) -> None:
    for index, view in ((LIGHT, {"view": "flat"}), (PICTURES, {})):
        page.page.evaluate(f"metapp.open({index})")
        page.set(**view, show="wipe")
        page.settle()
        page.page.mouse.move(32, 50)
        page.page.mouse.down()
        page.page.mouse.move(16, 50)
        page.page.mouse.up()
        assert page.page.evaluate("metapp.settings.wipe") == pytest.approx(0.25, abs=0.02)
        assert not page.page.evaluate("metapp.viewer.moves")


@pytest.mark.long
@pytest.mark.parametrize("index", [PICTURES, LIGHT])
def test_a_saved_picture_has_the_labels_and_lines_of_the_screen(page: Page, index: int) -> None:
    page.page.evaluate(f"metapp.open({index})")
    page.resize(300, 160)
    page.set(**({"view": "flat"} if index == LIGHT else {}), show="wipe", wipe=0.5)
    page.settle()
    label = page.page.locator(".view .label:visible").first
    assert label.inner_text() in ("reference | fit", "Reference | fit")
    seen = np.asarray(Image.open(io.BytesIO(page.page.locator("#stage").screenshot())).convert("RGB"), np.float64)
    plain, saved = (decode_in_browser(page.page.evaluate(f"metapp.{name}()")) for name in ("png", "labelled"))
    box = label.bounding_box()
    assert box
    x, y, width, height = (round(box[key]) for key in ("x", "y", "width", "height"))
    within = np.s_[y : y + height, x : x + width]
    assert np.abs(saved[within] - plain[within]).mean() > 30
    assert np.abs(saved[within] - seen[within]).mean() < 12  # letters are smoothed otherwise
    assert np.abs(saved - seen).mean() < 2


@pytest.mark.long
def test_two_fingers_zoom_a_panorama(page: Page) -> None:
    page.page.evaluate(f"metapp.open({LIGHT})")
    page.set(view="around")
    page.settle()
    fingers = """(places) => places.forEach(([type, pointerId, clientX]) => {
        const canvas = document.querySelector("#stage canvas");
        canvas.setPointerCapture = () => {};
        canvas.dispatchEvent(new PointerEvent(type, { pointerId, clientX, clientY: 30, buttons: 1 }));
    })"""
    down = [["pointerdown", 1, 10], ["pointerdown", 2, 30]]
    page.page.evaluate(fingers, [*down, ["pointermove", 2, 50], ["pointerup", 2, 50], ["pointerup", 1, 10]])
    assert page.page.evaluate("[metapp.settings.field, metapp.settings.heading]") == [37.5, 0]
    page.page.evaluate(fingers, [["pointermove", 2, 20]])
    assert page.page.evaluate("[metapp.settings.field, metapp.settings.heading]") == [37.5, 0]


@pytest.mark.long
def test_views_that_cannot_be_drawn_show_the_reason_instead(page: Page) -> None:
    page.page.evaluate("metapp.viewer.draw = () => { throw new Error('no memory'); }; metapp.set('show', 'one')")
    page.page.wait_for_selector(".problem:not([hidden])")
    assert page.page.inner_text(".problem") == "This view cannot be drawn: no memory"
    assert kinds(page) == ("", 0)
    page.page.evaluate(f"metapp.open({LIGHT})")
    assert kinds(page) == ("light", 1)
    assert page.page.locator(".problem").is_hidden()
    page.problems.clear()


@pytest.mark.long
def test_a_view_comes_back_after_the_browser_stopped_webgl(page: Page) -> None:
    page.page.evaluate(f"metapp.open({LIGHT})")
    page.set(exposure=1.5)
    page.settle()
    before = page.screenshot()
    page.page.evaluate("window.ended = metapp.viewer.renderer.getContext().getExtension('WEBGL_lose_context')")
    page.page.evaluate("ended.loseContext()")
    page.page.wait_for_selector(".problem:not([hidden])")
    assert "The view comes back when WebGL does" in page.page.inner_text(".problem")
    page.set(exposure=1)
    page.set(exposure=1.5)
    page.page.wait_for_timeout(200)
    page.page.evaluate("ended.restoreContext()")
    page.page.wait_for_selector(".problem", state="hidden")
    page.settle()
    assert kinds(page) == ("light", 1)
    assert page.page.evaluate("metapp.settings.exposure") == 1.5
    assert_pictures_match(page.screenshot(), before)


@pytest.mark.long
def test_another_light_map_is_read_or_refused(page: Page) -> None:
    page.page.evaluate(f"metapp.open({LIGHT})")
    head, rows = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n", [128, 128, 128, 129] * 32
    read = """async (bytes) => {
        await metapp.viewer.readLight(new File([Uint8Array.from(bytes)], "a.hdr"));
        return [metapp.viewer.light.size.x, document.querySelector(".said").textContent];
    }"""
    width, output = page.page.evaluate(read, [*head.encode()][:20])
    assert width == 16
    assert output.startswith("a.hdr is no light map of Radiance (.hdr): ")
    assert page.page.evaluate(read, [*head.encode(), *rows]) == [8, "Light map: a.hdr"]
    page.settle()


# Pages of fits


LARGEST = 3_000_000  # bytes of a page beside the run's own data


def page_of(view: View, title: str = "gold") -> dict[str, Any]:
    return page_document("metapp", [FitGroup(title, "BRDF", [view._replace(label="meta", caption="error 0.1")])])


def read_data(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.uint8])
def test_arrays_survive_encoding_in_the_page(dtype: torch.dtype) -> None:
    values = (100 * torch.rand(3, 5, 2)).to(dtype)
    encoded = encode_array(values.transpose(0, 1))
    read = np.frombuffer(zlib.decompress(base64.b64decode(encoded["data"])), encoded["type"]).reshape(encoded["shape"])
    assert np.array_equal(read, values.transpose(0, 1).numpy())


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pictures_survive_encoding_within_half_a_level(channels: int) -> None:
    pixels = torch.rand(6, 7, channels)
    address = encode_picture(pixels)
    image = Image.open(io.BytesIO(base64.b64decode(address.partition("base64,")[2])))
    read = np.asarray(image, dtype=np.float64).reshape(6, 7, channels) / 255
    assert np.abs(read - pixels.numpy()).max() <= 0.5 / 255 + 1e-6


def test_page_is_self_contained_and_names_no_other_address() -> None:
    text = viewer_html(page_of(View("pictures")))
    for tag in re.findall(r"<(?:script|link|img|iframe)[^>]*>", text):
        assert "src=" not in tag
        assert "href=" not in tag.replace('href="data:,"', "")
    assert "THREE" in text
    assert len(text) < LARGEST
    assert {f"VIEWERS.{kind}" for kind in VIEWER_KINDS} <= set(re.findall(r"VIEWERS\.\w+", text))


def test_texts_of_users_are_escaped_in_the_page() -> None:
    name = "</script><script>alert(1)</script><!--"
    data = page_of(View("pictures", facts={"note": name}), name)
    text = viewer_html(data)
    assert "alert(1)</script>" not in text
    read = read_data(text)["groups"][0]
    assert (read["title"], read["fits"][0]["facts"]["note"]) == (name, name)
    assert "<title>a &lt; b</title>" in viewer_html(page_document("a < b", []))
    with pytest.raises(ValueError, match="not JSON compliant"):
        viewer_html(page_of(View("pictures", facts={"error": float("nan")})))


def test_a_page_is_written_whatever_its_names_are(tmp_path: Path) -> None:
    text = write_page("\ud800", [], tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert "<title>\\ud800</title>" in text


def test_data_that_fits_share_are_stored_once() -> None:
    shared = {"light": torch.rand(64, 128, 3)}
    one = View("pictures", shared=shared)
    data = page_document("metapp", [FitGroup(name, "BRDF", [one] * 3) for name in "ab"])
    assert len(json.dumps(data)) < 1.1 * len(json.dumps(page_of(one)))
