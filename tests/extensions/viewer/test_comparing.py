"""Pages compare at once: the same view in each pane, a wipe on request, keys for the list, lamp and wipe."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from metapp.appearance.surface import Surface
from metapp.extensions.viewer.surface import Lit, surface_view
from metapp.extensions.viewer.view import THUMBNAIL, View, thumbnail
from tests.surfaces import rock

PANES = "metapp.viewer.panes.map(({ part, width, height }) => [part, width, height])"
HANDLES = "[...document.querySelectorAll('.lamp')].map((lamp) => [lamp.style.left, lamp.style.top])"


def surface(*, photo: bool = False) -> View:
    """A rock, whose reference is itself, so that fit and reference are the same picture."""
    fit = rock(32, tiles=False)
    above = torch.tensor([0.0, 0.0, 3.0])
    lit = [Lit(above, above, photo=torch.rand(3, 32, 32))] if photo else []
    return surface_view(Surface(fit.base, False, fit.maps), lit, reference=fit.maps)


def pictures(name: str) -> View:
    shown = {each: torch.rand(8, 8, 3) for each in ("reference", "fit")}
    return View("pictures", pictures=shown, facts={"name": name}, thumbnail=thumbnail(shown["fit"]))


def test_thumbnails_are_small_squares() -> None:
    assert thumbnail(torch.rand(64, 300, 3)).shape == (64, 64, 3)
    gray = thumbnail(torch.full((200, 100, 1), 0.5))
    assert gray.shape == (THUMBNAIL, THUMBNAIL, 3)
    assert float((gray - 0.5).abs().max()) < 1e-6


@pytest.mark.long
def test_a_page_opens_on_reference_and_fit_in_the_same_view(open_page: Callable) -> None:
    """Equal materials are equal pictures in both panes, under a lamp that a key moved, too; no wipe until asked for."""
    page = open_page(surface(), width=900, height=500)
    page.sized(206, 100)
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
    for key, wanted in (("ArrowDown", 1), ("ArrowDown", 2), ("ArrowDown", 2), ("Home", 0), ("ArrowRight", 1)):
        keys.press(key)
        page.page.wait_for_function(f"{index} === {wanted}")
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
    """At once: also a photo and its fit."""
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
