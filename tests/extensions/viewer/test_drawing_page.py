"""How pictures come about: in pieces that can be stopped, and under light maps from blurred maps."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from tests.extensions.viewer.test_brdf_page import material, views

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
    """Of fit and reference, in each channel, relative to the brightest one."""
    page = open_page(views("nbrdf", task=material()))
    page.sized(96, 48)
    page.set(light="map", shape="sphere")
    page.page.evaluate("metapp.viewer.most = () => 96")
    page.settle()
    fit, reference, *last = (torch.tensor(each) for each in page.page.evaluate(MEANS))
    for first, final in zip((fit, reference), last, strict=True):
        assert float((first - final).abs().max() / final.max()) < 0.06


@pytest.mark.long
def test_a_long_picture_comes_in_pieces_and_can_be_stopped_and_goes_on(open_page: Callable) -> None:
    """Where a sample takes long the page is asked in between, many times."""
    page = open_page(views("nbrdf", "few"))
    page.sized(192, 96)
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
