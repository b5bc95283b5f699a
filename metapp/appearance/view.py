"""What an interactive page shows of one fit: numbers and pictures, and which of the page's viewers shows them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from torch import Tensor

NOTHING: Mapping[str, Any] = MappingProxyType({})


class View(NamedTuple):
    """One fit, as a viewer of `metapp.viewer` reads it.

    Attributes:
        kind: the viewer, one of `metapp.viewer.page.KINDS`; the text at the head of its script says what it reads.
        arrays: numbers of float16, float32 or uint8, by name.
        pictures: display values [H, W, 1, 3 or 4] in [0, 1], by name, kept as PNG of 8 bits; the fourth is coverage.
        facts: what JSON holds.
        shared: arrays that are the same for all fits of a page that name them.
    """

    kind: str
    arrays: Mapping[str, Tensor] = NOTHING
    pictures: Mapping[str, Tensor] = NOTHING
    facts: Mapping[str, Any] = NOTHING
    shared: Mapping[str, Tensor] = NOTHING
