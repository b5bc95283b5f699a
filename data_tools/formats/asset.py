"""Asset folders: PNG of 16 bits and a description."""

from __future__ import annotations

from data_tools.formats import MATERIALS, TEXTURES, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import folder

    return folder


EXPORT = Export("asset", MATERIALS + TEXTURES, _writer)
