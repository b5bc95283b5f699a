"""The browser that tests of a module share, and a function that opens pages in it."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from metapp.extensions.viewer.view import View
from metapp.extensions.viewer.viewer_page import FitGroup, write_page
from tests.browser import Page, open_browser


def write_view_page(folder: Path, *fits: View | list[View]) -> Path:
    """Write a page of groups, each of one fit labelled `meta` or of several fits side by side; return its path."""
    views_of_groups = [
        group if isinstance(group, list) else [group._replace(label="meta", caption="error 0.1")] for group in fits
    ]
    groups = [FitGroup(f"fit {i}", "Fits", views) for i, views in enumerate(views_of_groups)]
    return write_page("metapp", groups, folder / "view.html")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless browser."""
    with open_browser() as opened:
        yield opened


@pytest.fixture
def open_page(browser: Any, tmp_path: Path) -> Iterator[Callable[..., Page]]:
    """Return a function that opens a page of fits. Afterwards pages must have reported no errors; they are closed."""
    pages: list[Page] = []

    def open_fits(*fits: View | list[View], **page_options: Any) -> Page:
        pages.append(Page(browser, write_view_page(tmp_path, *fits), **page_options))
        return pages[-1]

    yield open_fits
    for context in browser.contexts:
        context.close()
    assert not any(page.problems for page in pages)
