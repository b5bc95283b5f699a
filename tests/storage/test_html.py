"""Elements and documents of HTML: texts stay texts."""

from __future__ import annotations

from pathlib import Path

import pytest

from metapp.storage import html


def test_attributes_are_text_and_empty_ones_are_left_out() -> None:
    made = html.element("a", "b", class_="", data_of='1 < "2"', title="c")
    assert made == '<a data-of="1 &lt; &quot;2&quot;" title="c">b</a>'


def test_no_text_ends_a_script_and_no_number_is_nan() -> None:
    made = html.data_script("data", {"name": "</script><script>"})
    assert made.count("<") == 2
    with pytest.raises(ValueError, match="not JSON compliant"):
        html.data_script("data", {"error": float("nan")})


def test_a_page_is_written_whatever_its_names_are(tmp_path: Path) -> None:
    file = html.write_page(html.page("a < b", "p {}", html.element("p", "\ud800")), tmp_path / "page.html")
    text = file.read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert "<title>a &lt; b</title>" in text
    assert "<p>\\ud800</p>" in text
