"""Options that several applications have."""

from __future__ import annotations

import re

from metapp.door import Option


def size_of(text: str) -> tuple[int, int]:
    """Height and width in px of "HxW".

    Raises:
        ValueError: it is no such text.
    """
    sides = re.fullmatch(r"(\d{1,18})x(\d{1,18})", text)
    if not sides:
        raise ValueError("expected HEIGHTxWIDTH in px, such as 1024x1024")
    return int(sides[1]), int(sides[2])


def size(limits: str) -> Option:
    """The option --size of files that fits make; `limits` say how large they may be."""
    return Option("size", "", f"Output size in pixels: {limits}.", "HxW", panel="Output", convert=size_of)


DETAIL = Option(
    "detail",
    0,
    "Resolution at which photos are read and fitted: 256 (the default) or 512, which is four times as slow.",
    "PX",
    low=256,
    adapt="metapp.networks.exemplar:with_detail",
)
