"""The browser that tests of pages share, and the page that each opens."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from metapp.extensions.viewer.view import View
from metapp.extensions.viewer.viewer_page import FitGroup, write_page
from tests.browser import Page, browsing


def written(folder: Path, *fits: View | list[View]) -> Path:
    """A page of groups: of one fit, `meta`, or of several side by side."""
    several = [each if isinstance(each, list) else [each._replace(label="meta", caption="error 0.1")] for each in fits]
    groups = [FitGroup(f"fit {i}", "Fits", each) for i, each in enumerate(several)]
    return write_page("metapp", groups, folder / "view.html")


@pytest.fixture(scope="module")
def opened() -> Iterator[Any]:
    with browsing() as browser:
        yield browser


@pytest.fixture
def open_page(opened: Any, tmp_path: Path) -> Iterator[Callable[..., Page]]:
    """Opens such a page, on which there are no errors; none goes on drawing after its test."""
    pages: list[Page] = []

    def call(*fits: View | list[View], **more: Any) -> Page:
        pages.append(Page(opened, written(tmp_path, *fits), **more))
        return pages[-1]

    yield call
    for context in opened.contexts:
        context.close()
    assert not any(page.problems for page in pages)
