"""MaterialX, an OpenPBR Surface."""

from __future__ import annotations

from data_tools.formats import MATERIALS, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import materialx

    return materialx


EXPORT = Export("materialx", MATERIALS, _writer)
