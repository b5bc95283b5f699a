"""USD, a UsdPreviewSurface."""

from __future__ import annotations

from data_tools.formats import MATERIALS, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import usd

    return usd


EXPORT = Export("usd", MATERIALS, _writer, ("pxr", "usd-core"))
