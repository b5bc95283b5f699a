"""Fitted maps as PNG of 16 bits."""

from __future__ import annotations

from data_tools.formats import MATERIALS, TEXTURES, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import png16

    return png16


EXPORT = Export("png16", MATERIALS + TEXTURES, _writer)
