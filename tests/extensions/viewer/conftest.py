"""The browser that tests of pages share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.browser import browsing


@pytest.fixture(scope="module")
def opened() -> Iterator[Any]:
    with browsing() as browser:
        yield browser


@pytest.fixture
def browser(opened: Any) -> Iterator[Any]:
    """Without the pages of earlier tests, which would go on drawing and slow what follows."""
    yield opened
    for context in opened.contexts:
        context.close()
