"""Hooks of mkdocs: pictures become figures with captions, and search lists guides before the API.

In docs/ a picture is a paragraph of its own and its caption the next one, in italics, so that both also show where
Markdown is read as it is.
"""

from __future__ import annotations

import re
from typing import Any

BOOST = 0.001  # of the API's entries in search, where a title counts 1000 times as much as text
PICTURE = re.compile(r'<p>(<img [^>]*?src="([^"]+)"[^>]*>)</p>(?:\s*<p><em>((?:(?!</?p>).)*)</em></p>)?', re.DOTALL)


def figure(match: re.Match[str]) -> str:
    """A picture that opens at its full size, and its caption, if there is one."""
    picture, source, caption = match.groups()
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    return f'<figure><a href="{source}">{picture}</a>{below}</figure>'


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """A page's text as it is; entries of the API, which are many, count less in search than other pages."""
    if page.file.src_uri.startswith("api/"):
        page.meta.setdefault("search", {"boost": BOOST})
    return markdown


def on_page_content(html: str, **_: Any) -> str:
    """A page's HTML, with figures."""
    return PICTURE.sub(figure, html)
