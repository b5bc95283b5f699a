"""Pages of fits: what stands in the file, whatever shows it."""

from __future__ import annotations

import base64
import io
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from metapp.extensions.viewer.page import KINDS, Group, array, document, html, picture, write_page
from metapp.extensions.viewer.view import View

LARGEST = 3_000_000  # bytes of a page beside the run's own data


def page_of(view: View, title: str = "gold") -> dict[str, Any]:
    return document("metapp", [Group(title, "BRDF", [view._replace(label="meta", caption="error 0.1")])])


def read_data(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.uint8])
def test_arrays_come_back(dtype: torch.dtype) -> None:
    values = (100 * torch.rand(3, 5, 2)).to(dtype)
    told = array(values.transpose(0, 1))
    read = np.frombuffer(zlib.decompress(base64.b64decode(told["data"])), told["type"]).reshape(told["shape"])
    assert np.array_equal(read, values.transpose(0, 1).numpy())


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pictures_come_back_to_half_a_step(channels: int) -> None:
    pixels = torch.rand(6, 7, channels)
    address = picture(pixels)
    image = Image.open(io.BytesIO(base64.b64decode(address.partition("base64,")[2])))
    read = np.asarray(image, dtype=np.float64).reshape(6, 7, channels) / 255
    assert np.abs(read - pixels.numpy()).max() <= 0.5 / 255 + 1e-6


def test_the_page_holds_everything_and_names_nothing_elsewhere() -> None:
    text = html(page_of(View("pictures")))
    for tag in re.findall(r"<(?:script|link|img|iframe)[^>]*>", text):
        assert "src=" not in tag
        assert "href=" not in tag.replace('href="data:,"', "")
    assert "THREE" in text
    assert len(text) < LARGEST
    assert {f"VIEWERS.{kind}" for kind in KINDS} <= set(re.findall(r"VIEWERS\.\w+", text))


def test_no_text_of_a_user_ends_or_starts_an_element() -> None:
    name = "</script><script>alert(1)</script><!--"
    data = page_of(View("pictures", facts={"note": name}), name)
    text = html(data)
    assert "alert(1)</script>" not in text
    read = read_data(text)["groups"][0]
    assert (read["title"], read["fits"][0]["facts"]["note"]) == (name, name)
    assert "<title>a &lt; b</title>" in html(document("a < b", []))
    with pytest.raises(ValueError, match="not JSON compliant"):
        html(page_of(View("pictures", facts={"error": float("nan")})))


def test_a_page_is_written_whatever_its_names_are(tmp_path: Path) -> None:
    text = write_page("\ud800", [], tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert "<title>\\ud800</title>" in text


def test_what_fits_share_stands_once() -> None:
    shared = {"light": torch.rand(64, 128, 3)}
    one = View("pictures", shared=shared)
    data = document("metapp", [Group(name, "BRDF", [one] * 3) for name in "ab"])
    assert len(json.dumps(data)) < 1.1 * len(json.dumps(page_of(one)))
